"""Vehicles and people of a scenario in the words of OpenSCENARIO."""

from collections.abc import Mapping

from scenariogeneration import xosc

from gsrain_engine.scene.coco_classes import coco_class

from ...vehicle.vehicle import Vehicle
from .names import PROPERTY
from .words import words

_CATEGORIES = {"car": "car", "truck": "truck", "bus": "bus", "motorcycle": "motorbike", "bicycle": "bicycle"}
_WHEEL_M = 0.65


def ego_entity(vehicle: Vehicle) -> xosc.Vehicle:
    """Return the ego vehicle: its point of reference is below the rear axle, here as there."""
    track = round(0.85 * vehicle.width_m, 6)
    return xosc.Vehicle(
        "ego vehicle",
        words.VehicleCategory.car,
        _box((vehicle.length_m, vehicle.width_m, vehicle.height_m), vehicle.middle_m),
        xosc.Axle(vehicle.most_steer_rad, _WHEEL_M, track, vehicle.wheelbase_m, _WHEEL_M / 2),
        xosc.Axle(0.0, _WHEEL_M, track, 0.0, _WHEEL_M / 2),
        vehicle.top_speed_m_s,
        vehicle.most_acceleration_m_s2,
        vehicle.most_braking_m_s2,
    )


def user_entity(
    class_name: str, size_lwh_m: tuple[float, float, float], properties: Mapping[str, str]
) -> xosc.Vehicle | xosc.Pedestrian:
    """Return a road user; its point of reference is below its middle."""
    kind, box = coco_class(class_name), _box(size_lwh_m, 0.0)
    if kind == "person":
        entity = xosc.Pedestrian(class_name, 75.0, words.PedestrianCategory.pedestrian, box)
    else:
        length, width, _ = size_lwh_m
        front, rear = (xosc.Axle(steer, _WHEEL_M, round(0.85 * width, 6), round(side * 0.3 * length, 6), _WHEEL_M / 2)
                       for steer, side in ((0.6, 1), (0.0, -1)))  # fmt: skip
        category = getattr(words.VehicleCategory, _CATEGORIES.get(kind, "car"))
        entity = xosc.Vehicle(class_name, category, box, front, rear, 50.0, 5.0, 10.0)
    for name, value in properties.items():
        entity.add_property(PROPERTY + name, value)
    return entity


def _box(size_lwh_m: tuple[float, float, float], ahead_m: float) -> xosc.BoundingBox:
    length, width, height = size_lwh_m
    return xosc.BoundingBox(width, length, height, round(ahead_m, 6), 0.0, round(height / 2, 6))

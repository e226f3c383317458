"""Where cars and trucks stand that are parked in the built-in street: its scene has one layer of each."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .cars import CAR_FORMS
from .layout import plan_street
from .parameters import StreetParameters
from .quads import rotation_about_z
from .truck_form import TRUCK_FORM

PARKED_CARS, PARKED_TRUCKS = "parked cars", "parked trucks"
"""Names of the layers that show them."""


class ParkedBox(NamedTuple):
    """A parked vehicle as a box."""

    id: str
    class_name: str
    """Car or truck."""
    layer: str
    """Name of the layer that shows it."""
    size_lwh: tuple[float, float, float]
    """Metres."""
    to_street: Float64[np.ndarray, "4 4"]
    """From the vehicle's frame (x forward, y left, z up, origin at the bottom centre) to the street's."""


def parked_boxes(parameters: StreetParameters | None = None) -> list[ParkedBox]:
    """Return the parked vehicles of a street, in the order of its plan: cars, then trucks."""
    layout = plan_street(parameters or StreetParameters())
    boxes: list[ParkedBox] = []
    for number, car in enumerate(layout.cars):
        form = CAR_FORMS[car.shape]
        size = form.length, form.width, form.height
        boxes.append(ParkedBox(f"parked-{number:02d}", "car", PARKED_CARS, size, _pose(car.x, car.y, car.turn_deg)))
    for number, truck in enumerate(layout.trucks):
        size = TRUCK_FORM.length, TRUCK_FORM.width, TRUCK_FORM.height
        boxes.append(
            ParkedBox(f"truck-{number:02d}", "truck", PARKED_TRUCKS, size, _pose(truck.x, truck.y, truck.turn_deg))
        )
    return boxes


def _pose(x: float, y: float, turn_deg: float) -> Float64[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = rotation_about_z(turn_deg)
    pose[:2, 3] = x, y
    return pose

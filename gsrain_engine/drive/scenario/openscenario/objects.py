"""Vehicles and people of an OpenSCENARIO file, as we have them."""

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import msgspec

from gsrain_engine.untrusted.explained_errors import converted

from ...vehicle.vehicle import Vehicle
from .names import PROPERTY
from .xml_file import number, properties

_MODELS = {"car": "saloon", "van": "van", "truck": "truck", "bus": "truck", "semitrailer": "truck"}
_CLASSES = {"van": "car", "semitrailer": "truck", "motorbike": "motorcycle"}


def look_of(path: Path, name: str, entity: Element) -> dict[str, str]:
    """Return model and class of an entity; raises ValueError where nothing here looks like it."""
    vehicle = entity.find("Vehicle")
    if vehicle is not None:
        category = vehicle.get("vehicleCategory", "car")
    elif entity.find("CatalogReference") is not None:
        category = "car"
    else:
        category = "thing" if entity.find("Pedestrian") is None else "person"
    model = own_properties(entity).get(f"{PROPERTY}model", _MODELS.get(category))
    if model is None:
        raise ValueError(
            f'{path}: {name} is a {category}, of which there is no model: name one in its property "{PROPERTY}model"'
        )
    return {"model": model, "class_name": _CLASSES.get(category, category)}


def own_properties(entity: Element) -> dict[str, str]:
    return {name: value for each in entity for name, value in properties(each).items()}


def controlled_behaviour(entity: Element) -> dict[str, Any] | None:
    """Return the behaviour that stands in a controller's properties; None where there is none."""
    found = entity.find("ObjectController/Controller")
    values = {} if found is None else properties(found)
    return dict(values) if "kind" in values else None


def box_of(path: Path, entity: Element) -> tuple[tuple[float, float, float], float] | None:
    """Return length, width and height of an entity, and how far its middle is ahead of its point of reference."""
    size, middle = entity.find("*/BoundingBox/Dimensions"), entity.find("*/BoundingBox/Center")
    if size is None or middle is None:
        return None
    length, width, height = (number(path, size, each) for each in ("length", "width", "height"))
    return (length, width, height), number(path, middle, "x")


def ego_vehicle(path: Path, entity: Element) -> Vehicle:
    """Return the ego vehicle; what it does not say, or says beyond all bounds, is a middle-class car's."""
    box, performance = box_of(path, entity), entity.find("Vehicle/Performance")
    plain: dict[str, Any] = {}
    if box is not None:
        (length, width, height), middle = box
        plain |= {"length_m": length, "width_m": width, "height_m": height}
        plain["rear_overhang_m"] = round(length / 2 - middle, 6)
    axles = [entity.find(f"Vehicle/Axles/{name}") for name in ("FrontAxle", "RearAxle")]
    if axles[0] is not None and axles[1] is not None:
        plain["wheelbase_m"] = number(path, axles[0], "positionX") - number(path, axles[1], "positionX")
        plain["most_steer_rad"] = min(number(path, axles[0], "maxSteering"), 1.5)
    if performance is not None:
        plain["most_acceleration_m_s2"] = min(number(path, performance, "maxAcceleration"), 20.0)
        plain["most_braking_m_s2"] = min(number(path, performance, "maxDeceleration"), 20.0)
        plain["top_speed_m_s"] = min(number(path, performance, "maxSpeed"), 100.0)
    try:
        return converted(plain, Vehicle)
    except msgspec.ValidationError as error:
        raise ValueError(f"{path}: the ego vehicle: {error}") from None

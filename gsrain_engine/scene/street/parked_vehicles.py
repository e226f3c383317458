"""Where the cars stand that are parked in the built-in street: its scene has them all in one layer."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .cars import CAR_FORMS
from .layout import plan_street
from .parameters import StreetParameters
from .quads import rotation_about_z

PARKED_LAYER = "parked cars"


class ParkedCarBox(NamedTuple):
    """A parked car as a box."""

    id: str
    size_lwh: tuple[float, float, float]
    """Metres."""
    to_street: Float64[np.ndarray, "4 4"]
    """From the car's frame (x forward, y left, z up, origin at the bottom centre) to the street's."""


def parked_car_boxes(parameters: StreetParameters | None = None) -> list[ParkedCarBox]:
    """Return the parked cars of a street, in the order of its plan."""
    boxes: list[ParkedCarBox] = []
    for number, car in enumerate(plan_street(parameters or StreetParameters()).cars):
        form, pose = CAR_FORMS[car.shape], np.eye(4)
        pose[:3, :3] = rotation_about_z(car.turn_deg)
        pose[:2, 3] = car.x, car.y
        boxes.append(ParkedCarBox(f"parked-{number:02d}", (form.length, form.width, form.height), pose))
    return boxes

"""Vehicles that the program brings along: the street's cars and its lorry, in paints of one's choice."""

from functools import lru_cache

from gsrain_engine.scene.street.cars import CAR_FORMS, build_car, vehicle_shadow
from gsrain_engine.scene.street.daylight import Daylight
from gsrain_engine.scene.street.parameters import StreetParameters
from gsrain_engine.scene.street.parking import CarShape, Color, ParkedTruck
from gsrain_engine.scene.street.quads import Quads
from gsrain_engine.scene.street.splatting import gaussians_of
from gsrain_engine.scene.street.truck_form import TRUCK_FORM
from gsrain_engine.scene.street.trucks import build_truck

from .look import UserLook

TRUCK = "truck"
PAINTS: dict[str, Color] = {
    "blue": (0.014, 0.034, 0.075),
    "black": (0.012, 0.012, 0.014),
    "graphite": (0.05, 0.053, 0.058),
    "green": (0.016, 0.05, 0.028),
    "red": (0.19, 0.012, 0.011),
    "sand": (0.24, 0.20, 0.15),
    "silver": (0.19, 0.195, 0.20),
    "white": (0.62, 0.62, 0.61),
    "yellow": (0.42, 0.24, 0.02),
}
"""Linear albedo by name; the first is that of a car which names none."""
_BOX, _SIGN = (0.62, 0.62, 0.60), (0.03, 0.10, 0.30)
_SHAPES: dict[str, CarShape] = {shape: shape for shape in CAR_FORMS}


def vehicle_names() -> tuple[str, ...]:
    """Names of the built-in vehicles; "/" and the name of a paint may follow."""
    return (*_SHAPES, TRUCK)


@lru_cache(maxsize=64)
def built_in_vehicle(name: str) -> UserLook | None:
    """Make a built-in vehicle with its shadow on the ground, lit by the street's sun; None where there is none.

    Raises ValueError for a paint that there is not. The last 64 are kept: a sweep makes each of them once.
    """
    kind, _, paint = name.partition("/")
    if kind not in vehicle_names():
        return None
    if paint and paint not in PAINTS:
        raise ValueError(f"model {name}: no paint is called {paint!r}, only {', '.join(PAINTS)}")
    color = PAINTS[paint] if paint else PAINTS["white" if kind == TRUCK else "blue"]
    if kind == TRUCK:
        form = TRUCK_FORM
        body = build_truck(ParkedTruck(0.0, 0.0, 0.0, color, _BOX, color if paint else _SIGN))
    else:
        form = CAR_FORMS[_SHAPES[kind]]
        body = build_car(_SHAPES[kind], color)
    quads = Quads.joined([vehicle_shadow(form.length, form.width), body])
    gaussians = gaussians_of(quads, Daylight.over(StreetParameters()))
    return UserLook(gaussians, (form.length, form.width, form.height))

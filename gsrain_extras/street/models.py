"""The street's road users and lanterns as models for any scene: an entry point `gsrain.models`."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.models import ModelLibrary, VehicleModel
from gsrain_engine.scene.skies import LIGHTINGS, NIGHT, TimeOfDay

from .bicycles import CYCLIST_SIZE_M, build_cyclist
from .build import quads_to_gaussians, wet_colors
from .buses import BUS_SIZE_M, build_bus
from .cars import CAR_FORMS, TRUCK_FORM, build_car, vehicle_shadow
from .layout import CarShape, Color, ParkedTruck, StreetParameters
from .lighting import LIGHT_OF, Illumination
from .mesh import Quads
from .night import lantern_at_origin
from .people import FIGURES, build_person, person_size
from .refinement import refined_vehicle
from .trucks import build_truck

TRUCK, BUS, CYCLIST, PEDESTRIAN = "truck", "bus", "cyclist", "pedestrian"
PAINTS: dict[str, Color] = {
    "blue": (0.014, 0.034, 0.075), "black": (0.012, 0.012, 0.014), "graphite": (0.05, 0.053, 0.058),
    "green": (0.016, 0.05, 0.028), "red": (0.19, 0.012, 0.011), "sand": (0.24, 0.20, 0.15),
    "silver": (0.19, 0.195, 0.20), "white": (0.62, 0.62, 0.61), "yellow": (0.42, 0.24, 0.02),
}  # fmt: skip
"""Linear albedo by paint name; the first is the default."""

_BOX, _SIGN = (0.62, 0.62, 0.60), (0.03, 0.10, 0.30)


@lru_cache(maxsize=64)
def _road_user(name: str, paint: str, time_of_day: TimeOfDay) -> VehicleModel:
    """Create a road user with its shadow on the ground, in the light of the street. Caches 64 of them."""
    body, size = _built(name, PAINTS[paint] if paint else None)
    quads = Quads.joined([vehicle_shadow(size[0], size[1]), refined_vehicle(body)])
    clear, rainy = (Illumination.over(StreetParameters(), lighting=LIGHTINGS[each]) for each in LIGHT_OF[time_of_day])
    gaussians, wet_sh = quads_to_gaussians(quads, clear), wet_colors(quads, rainy)
    return VehicleModel(gaussians, size, wet_sh)


def _shadow(length_m: float, width_m: float) -> Gaussians:
    return quads_to_gaussians(vehicle_shadow(length_m, width_m), Illumination.over(StreetParameters()))


def _lanterns(places: Float64[np.ndarray, "n 3"], turns_deg: Float64[np.ndarray, " n"]) -> Gaussians:
    one = lantern_at_origin()
    quads = Quads.joined([one.placed(place, turn) for place, turn in zip(places, turns_deg, strict=True)])
    return quads_to_gaussians(quads, Illumination.over(StreetParameters(), None, NIGHT))


def _built(kind: str, color: Color | None) -> tuple[Quads, tuple[float, float, float]]:
    """Surfaces of a built-in road user in its own frame, and its length, width and height."""
    match kind:
        case "truck":
            truck = ParkedTruck(0.0, 0.0, 0.0, color or PAINTS["white"], _BOX, color or _SIGN)
            return build_truck(truck), (TRUCK_FORM.length, TRUCK_FORM.width, TRUCK_FORM.height)
        case "bus":
            return build_bus(color or PAINTS["yellow"]), BUS_SIZE_M
        case "cyclist":
            middle = (_BICYCLE_MIDDLE_M, 0.0, 0.0)
            return build_cyclist(color or PAINTS["green"]).placed(np.negative(middle)), CYCLIST_SIZE_M
        case "pedestrian":
            figure = FIGURES[0]
            clothes = replace(figure.clothes, top=color or figure.clothes.top)
            return build_person(replace(figure, clothes=clothes)), person_size(figure)
        case _:
            shape: CarShape = next(each for each in CAR_FORMS if each == kind)
            form = CAR_FORMS[shape]
            return build_car(shape, color or PAINTS["blue"]), (form.length, form.width, form.height)


_BICYCLE_MIDDLE_M = 0.07  # from the bottom bracket to the middle of both wheels


LIBRARY = ModelLibrary(
    names=(*CAR_FORMS, TRUCK, BUS, CYCLIST, PEDESTRIAN),
    paints=tuple(PAINTS),
    build=_road_user,
    shadow=_shadow,
    lanterns=_lanterns,
)

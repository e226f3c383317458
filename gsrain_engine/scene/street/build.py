"""Builds the street: surfaces first, then the scene of Gaussians that shows them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..members import Actor, Layer
from ..scene import Scene
from ..track import Track
from .cars import CAR_FORMS, build_car, build_parked_cars, car_shadow
from .daylight import Daylight
from .furniture import build_furniture
from .houses import build_houses
from .layout import StreetLayout, plan_street
from .parameters import StreetParameters
from .parked_vehicles import PARKED_CARS, PARKED_TRUCKS
from .parking import CarShape
from .pavements import build_pavements
from .quads import Quads
from .rigs import SENSOR_HEIGHT_M, street_rigs
from .road import build_road
from .sky import build_sky
from .splatting import gaussians_of
from .surroundings import build_surroundings
from .trees import build_trees
from .trucks import build_parked_trucks

LEAD_ID = "lead"
_LEAD_SHAPE: CarShape = "saloon"
_LEAD_PAINT = (0.014, 0.034, 0.075)
_TRACK_STEP_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class StreetSurfaces:
    """Every surface of the street: the one description behind its Gaussians and its mesh, quad by quad."""

    layout: StreetLayout
    layers: Mapping[str, Quads]
    """By layer name, in world axes; Gaussian i of a layer is quad i here."""
    lead: Quads
    """The lead car and its shadow, in the object frame."""

    @property
    def light(self) -> Daylight:
        return Daylight.over(self.layout.parameters, self.layout)

    @property
    def lead_light(self) -> Daylight:
        """Light on the lead car: the same sun, nothing in its way (it drives in and out of shadows unlit by them)."""
        return Daylight.over(self.layout.parameters)


def street_surfaces(parameters: StreetParameters | None = None) -> StreetSurfaces:
    layout = plan_street(parameters or StreetParameters())
    sun = Daylight.over(layout.parameters).sun
    layers = {
        "road": build_road(layout),
        "pavements": build_pavements(layout),
        "houses": build_houses(layout),
        "trees": build_trees(layout, sun),
        PARKED_CARS: build_parked_cars(layout),
        PARKED_TRUCKS: build_parked_trucks(layout),
        "furniture": build_furniture(layout),
        "surroundings": build_surroundings(layout),
        "sky": build_sky(layout),
    }
    return StreetSurfaces(layout, layers, Quads.joined([car_shadow(_LEAD_SHAPE), build_car(_LEAD_SHAPE, _LEAD_PAINT)]))


def build_street(parameters: StreetParameters | None = None) -> Scene:
    """Build the street as a scene: layers by noun, the lead car as an actor, rigs and the ego's way."""
    return scene_of(street_surfaces(parameters))


def scene_of(surfaces: StreetSurfaces) -> Scene:
    """Turn surfaces into the scene of Gaussians that shows them."""
    light = surfaces.light
    layers = tuple(
        Layer(name, gaussians_of(quads, light), kind="sky" if name == "sky" else "background")
        for name, quads in surfaces.layers.items()
    )
    form = CAR_FORMS[_LEAD_SHAPE]
    p = surfaces.layout.parameters
    lead = Actor(
        LEAD_ID,
        "car",
        (form.length, form.width, form.height),
        gaussians_of(surfaces.lead, surfaces.lead_light),
        lead_track(p),
    )
    return Scene(name="street", layers=layers, actors=(lead,), ground_m=0.0, rigs=street_rigs(), ego=ego_track(p))


def ego_track(p: StreetParameters) -> Track:
    """Return the ego's way: down the right-hand lane at constant speed, from x = 0."""
    times = _times(p)
    return _straight(times, p.ego_speed_m_s * times, -0.5 * p.lane_width_m, SENSOR_HEIGHT_M)


def lead_track(p: StreetParameters) -> Track:
    """Return the lead car's way: the ego's speed on average, 6 % faster and slower with a period of 8 s."""
    times = _times(p)
    swing = 2 * np.pi / 8.0
    x = p.lead_gap_m + p.ego_speed_m_s * (times + 0.06 / swing * np.sin(swing * times))
    return _straight(times, x, -0.5 * p.lane_width_m, 0.0)


def _times(p: StreetParameters) -> np.ndarray:
    return np.arange(round(p.drive_seconds / _TRACK_STEP_S) + 1) * _TRACK_STEP_S


def _straight(times: np.ndarray, x: np.ndarray, y: float, z: float) -> Track:
    n = len(times)
    positions = np.stack([x, np.full(n, y), np.full(n, z)], axis=1)
    return Track(times, positions, np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.ones(n, bool))

"""What road users of a scenario look like: Gaussians in the object frame, in metres."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsrain_engine.scene.formats.gaussian_files import read_gaussians
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street.cars import CAR_FORMS, build_car, car_shadow
from gsrain_engine.scene.street.daylight import Daylight
from gsrain_engine.scene.street.parameters import StreetParameters
from gsrain_engine.scene.street.quads import Quads
from gsrain_engine.scene.street.splatting import gaussians_of

_ACTOR = "actor:"
_PAINT = (0.014, 0.034, 0.075)


class UserLook(NamedTuple):
    """A model, and the size of what it shows."""

    gaussians: Gaussians
    """In the object frame (x forward, y left, z up, origin at the bottom centre), metres."""
    size_lwh_m: tuple[float, float, float]


def user_look(model: str, scene: Scene) -> UserLook:
    """Make a model: hatchback, saloon, estate or van; actor:ID of the scene; or a file.

    Raises ValueError, with the model's name, for what there is not.
    """
    for shape, form in CAR_FORMS.items():
        if shape == model:
            quads = Quads.joined([car_shadow(shape), build_car(shape, _PAINT)])
            gaussians = gaussians_of(quads, Daylight.over(StreetParameters()))
            return UserLook(gaussians, (form.length, form.width, form.height))
    if model.startswith(_ACTOR):
        return _actor_look(model.removeprefix(_ACTOR), scene)
    path = Path(model)
    if not path.is_file():
        known = ", ".join([*CAR_FORMS, *(f"{_ACTOR}{each.id}" for each in scene.actors)])
        raise ValueError(f"model {model}: no such file, and none of {known}")
    gaussians = read_gaussians(path)
    low, high = gaussians.means.min(axis=0), gaussians.means.max(axis=0)
    return UserLook(gaussians, (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2])))


def _actor_look(id: str, scene: Scene) -> UserLook:
    for actor in scene.actors:
        if actor.id == id:
            unit = scene.metres_per_unit
            length, width, height = (unit * side for side in actor.size_lwh)
            return UserLook(scaled(actor.gaussians, unit), (length, width, height))
    raise ValueError(f"model {_ACTOR}{id}: scene {scene.name!r} has no such actor")


def scaled(gaussians: Gaussians, times: float) -> Gaussians:
    """Return Gaussians so many times larger, around the origin of their frame."""
    if times == 1:
        return gaussians
    by = np.float32(times)
    return replace(gaussians, means=gaussians.means * by, scales=gaussians.scales * by)

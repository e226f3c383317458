"""Appearance of road users: built-in vehicles, actors of the scene, and files of Gaussians."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...scene.built_in import built_in_scene
from ...scene.formats.hugsim import hugsim_files, is_vehicle_folder, read_hugsim
from ...scene.formats.registry import read_gaussians
from ...scene.gaussians import Gaussians
from ...scene.models import VehicleModel, ground_shadow, library_model, model_names, paint_names
from ...scene.scene import Scene, robust_bounds


def scale_gaussians(gaussians: Gaussians, times: float) -> Gaussians:
    """Return Gaussians scaled around the origin of their frame."""
    by = np.float32(times)
    return gaussians if times == 1 else replace(gaussians, means=gaussians.means * by, scales=gaussians.scales * by)


ACTOR = "actor:"  # prefix of models that are actors of the scene; the actor id follows


def vehicle_model(model: str, scene: Scene) -> VehicleModel:
    """Create a model: a built-in road user, an actor of the scene, a file, or a folder.

    Built-in ones may have a paint: saloon, van/red, bus, pedestrian. An actor is actor:ID.

    A folder is one of a 3DRealCar vehicle, as HUGSIM releases them.

    Raises ValueError, with the model's name, if it does not exist.
    """
    place = built_in_scene(scene.name)
    of_library = library_model(model, "day" if place is None else place.time_of_day)
    if of_library is not None:
        return of_library
    if model.startswith(ACTOR):
        actor = next((each for each in scene.actors if each.id == model.removeprefix(ACTOR)), None)
        if actor is None:
            raise ValueError(f"model {model}: scene {scene.name!r} has no such actor")
        length, width, height = (scene.metres_per_unit * side for side in actor.size_lwh)
        gaussians = scale_gaussians(actor.gaussians, scene.metres_per_unit)
        return VehicleModel(gaussians, (length, width, height), actor.wet_sh)
    path = Path(model)
    if is_vehicle_folder(path):
        return model_of_folder(path)
    if not path.is_file():
        known = ", ".join([*model_names(), *(f"{ACTOR}{each.id}" for each in scene.actors)])
        paints = f" (a paint may follow: /{', '.join(paint_names())})" if paint_names() else ""
        raise ValueError(f"model {model}: no such file" + (f", and none of {known}{paints}" if known else ""))
    return model_of_file(path)


_SHARE = 0.995  # share of the opacity inside a model's box along each axis; excludes stray Gaussians of captures
_OPAQUE = 0.2  # minimum opacity of Gaussians that count for a model's size
_MIN_M, _MAX_M = 0.1, 30.0


def model_of_file(path: Path) -> VehicleModel:
    """Read a model in meters (x forward, y left, z up), stand it on the ground, and give it a soft shadow there.

    Its box contains nearly all opaque Gaussians; the center of its bottom becomes the origin. The last few files are
    cached until they change. Raises ValueError for unsuitable files.
    """
    known = path.stat()
    return _read(path, known.st_mtime_ns, known.st_size)


@lru_cache(maxsize=16)
def _read(path: Path, changed_ns: int, size: int) -> VehicleModel:
    gaussians = read_gaussians(path)
    opaque = gaussians.take(np.flatnonzero(gaussians.opacities >= _OPAQUE))
    if not len(opaque):
        raise ValueError(f"{path}: nothing in it can be seen, so it can't be a road user")
    low, high = robust_bounds(opaque, share=_SHARE)
    length, width, height = (float(side) for side in high - low)
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], np.float32)
    return _in_shadow(path, replace(gaussians, means=gaussians.means - foot), (length, width, height))


def model_of_folder(folder: Path) -> VehicleModel:
    """Read a 3DRealCar vehicle, whose box is that of its wlh.json, and give it a soft shadow on the ground.

    The last few folders are cached until their files change. Raises ValueError for unsuitable files, which include
    checkpoints that hold anything but tensors.
    """
    return _read_folder(folder, tuple((each.stat().st_mtime_ns, each.stat().st_size) for each in hugsim_files(folder)))


@lru_cache(maxsize=16)
def _read_folder(folder: Path, versions: tuple[tuple[int, int], ...]) -> VehicleModel:
    (vehicle,) = read_hugsim(folder).actors
    length, width, height = vehicle.size_lwh
    return _in_shadow(folder, vehicle.gaussians, (length, width, height))


def _in_shadow(path: Path, standing: Gaussians, size_lwh_m: tuple[float, float, float]) -> VehicleModel:
    """Add a shadow to a model in its object frame; raises ValueError, which names `path`, for an odd size."""
    length, width, height = size_lwh_m
    if not all(_MIN_M <= side <= _MAX_M for side in size_lwh_m):
        raise ValueError(
            f"{path}: {length:.3g} x {width:.3g} x {height:.3g} m is no road user's size; a model is in meters, each "
            f"side {_MIN_M:g} to {_MAX_M:g} m"
        )
    shadow = ground_shadow(length, width)
    parts = [standing] if shadow is None else [shadow, standing]
    return VehicleModel(Gaussians.concatenate(parts), size_lwh_m)

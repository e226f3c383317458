"""Appearance of road users: built-in vehicles, actors of the scene, and files of Gaussians."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from ...scene.formats.hugsim import hugsim_files, is_vehicle_folder, read_hugsim
from ...scene.formats.registry import read_gaussians
from ...scene.gaussians import Gaussians
from ...scene.scene import Scene, robust_bounds
from ...scene.street.bicycles import CYCLIST_SIZE_M, build_cyclist
from ...scene.street.build import quads_to_gaussians, wet_colors
from ...scene.street.buses import BUS_SIZE_M, build_bus
from ...scene.street.cars import CAR_FORMS, TRUCK_FORM, build_car, vehicle_shadow
from ...scene.street.layout import STREETS, CarShape, Color, ParkedTruck, StreetParameters, TimeOfDay
from ...scene.street.lighting import LIGHT_OF, LIGHTINGS, Illumination
from ...scene.street.mesh import Quads
from ...scene.street.people import FIGURES, build_person, person_size
from ...scene.street.refinement import refined_vehicle
from ...scene.street.trucks import build_truck


class VehicleModel(NamedTuple):
    """Gaussians of a road user with their size."""

    gaussians: Gaussians
    """Object frame (x forward, y left, z up, origin at the bottom center), meters."""
    size_lwh_m: tuple[float, float, float]
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of its Gaussians when wet under clouds; None for models without wet colors."""


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
    built_in = built_in_vehicle(model, _time_of_day(scene))
    if built_in is not None:
        return built_in
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
        known = ", ".join([*vehicle_names(), *(f"{ACTOR}{each.id}" for each in scene.actors)])
        raise ValueError(f"model {model}: no such file, and none of {known} (a paint may follow: /{', '.join(PAINTS)})")
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
    shadow = quads_to_gaussians(vehicle_shadow(length, width), Illumination.over(StreetParameters()))
    return VehicleModel(Gaussians.concatenate([shadow, standing]), size_lwh_m)


# Built-in vehicles

TRUCK, BUS, CYCLIST, PEDESTRIAN = "truck", "bus", "cyclist", "pedestrian"
PAINTS: dict[str, Color] = {
    "blue": (0.014, 0.034, 0.075), "black": (0.012, 0.012, 0.014), "graphite": (0.05, 0.053, 0.058),
    "green": (0.016, 0.05, 0.028), "red": (0.19, 0.012, 0.011), "sand": (0.24, 0.20, 0.15),
    "silver": (0.19, 0.195, 0.20), "white": (0.62, 0.62, 0.61), "yellow": (0.42, 0.24, 0.02),
}  # fmt: skip
"""Linear albedo by paint name; the first is the default."""

_BOX, _SIGN = (0.62, 0.62, 0.60), (0.03, 0.10, 0.30)


def vehicle_names() -> tuple[str, ...]:
    """Return names of the built-in road users; "/" and a paint name may follow: of a body, a frame or a jacket."""
    return (*CAR_FORMS, TRUCK, BUS, CYCLIST, PEDESTRIAN)


def _time_of_day(scene: Scene) -> TimeOfDay:
    street = STREETS.get(scene.name)
    return "day" if street is None else street.time_of_day


@lru_cache(maxsize=64)
def built_in_vehicle(name: str, time_of_day: TimeOfDay = "day") -> VehicleModel | None:
    """Create a built-in road user with its shadow on the ground, in the light of the street; None for an unknown name.

    Raises ValueError for an unknown paint. Caches 64 of them.
    """
    kind, _, paint = name.partition("/")
    if kind not in vehicle_names():
        return None
    if paint and paint not in PAINTS:
        raise ValueError(f"model {name}: no paint is called {paint!r}, only {', '.join(PAINTS)}")
    body, size = _built(kind, PAINTS[paint] if paint else None)
    quads = Quads.joined([vehicle_shadow(size[0], size[1]), refined_vehicle(body)])
    clear, rainy = (Illumination.over(StreetParameters(), lighting=LIGHTINGS[each]) for each in LIGHT_OF[time_of_day])
    gaussians, wet_sh = quads_to_gaussians(quads, clear), wet_colors(quads, rainy)
    return VehicleModel(gaussians, size, wet_sh)


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

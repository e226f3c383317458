"""Models of road users and lanterns by name: entry points `gsrain.models` of this program and of other packages."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from ..plugins import MODELS, load_extensions
from .gaussians import Gaussians
from .skies import TimeOfDay


class VehicleModel(NamedTuple):
    """Gaussians of a road user with their size."""

    gaussians: Gaussians
    """Object frame (x forward, y left, z up, origin at the bottom center), meters."""
    size_lwh_m: tuple[float, float, float]
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of its Gaussians when wet under clouds; None for models without wet colors."""


@dataclass(frozen=True, kw_only=True)
class ModelLibrary:
    """Models of one package."""

    names: tuple[str, ...]
    """Of road users: saloon, bus."""
    paints: tuple[str, ...]
    """Names of colors of a body, a frame or a jacket."""
    build: Callable[[str, str, TimeOfDay], VehicleModel]
    """A road user by its name and paint ("" is its usual one), with its shadow on the ground."""
    shadow: Callable[[float, float], Gaussians] | None = None
    """Soft dark patch on the ground around a vehicle of a length and width in meters, in its object frame."""
    lanterns: Callable[[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]], Gaussians] | None = None
    """Street lanterns by night, over places on the ground; x along the road is turned by degrees."""


def model_libraries() -> list[ModelLibrary]:
    """All libraries of models that can be used."""
    return [library for _, library in load_extensions(MODELS, ModelLibrary)]


def model_names() -> tuple[str, ...]:
    """Return names of the road users of all libraries; "/" and a name of `paint_names` may follow."""
    return tuple(name for library in model_libraries() for name in library.names)


def paint_names() -> tuple[str, ...]:
    return tuple(dict.fromkeys(paint for library in model_libraries() for paint in library.paints))


def library_model(model: str, time_of_day: TimeOfDay) -> VehicleModel | None:
    """Return a road user by name or name/paint; None for an unknown name. Raises ValueError for an unknown paint."""
    name, _, paint = model.partition("/")
    library = next((each for each in model_libraries() if name in each.names), None)
    if library is None:
        return None
    if paint and paint not in library.paints:
        raise ValueError(f"model {model}: no paint is called {paint!r}, only {', '.join(library.paints)}")
    return library.build(name, paint, time_of_day)


def ground_shadow(length_m: float, width_m: float) -> Gaussians | None:
    """Soft shadow of a vehicle, in its object frame; None if no library has one."""
    drawn = next((each.shadow for each in model_libraries() if each.shadow is not None), None)
    return None if drawn is None else drawn(length_m, width_m)


def lantern_bodies(places: Float64[np.ndarray, "n 3"], turns_deg: Float64[np.ndarray, " n"]) -> Gaussians | None:
    """Bodies of lanterns whose lamps hang `LANTERN_HEIGHT_M` above places; None if no library has them."""
    built = next((each.lanterns for each in model_libraries() if each.lanterns is not None), None)
    return None if built is None else built(places, turns_deg)

"""Scenes that have a name instead of a file: entry points `gsrain.scenes` of this program and of other packages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..plugins import SCENES, find_extension, find_extensions
from .scene import Scene
from .skies import TimeOfDay

DEFAULT_SCENE = "street"
"""Name of the scene that opens without another name."""


class SceneBox(NamedTuple):
    """A vehicle, a person or a traffic light of a scene as a box."""

    id: str
    class_name: str
    """Class of COCO."""
    layer: str
    """Name of its layer."""
    size_lwh: tuple[float, float, float]
    """Meters."""
    to_layer: Float64[np.ndarray, "4 4"]
    """From its frame (x forward, y left, z up, origin at the bottom center) to the layer's."""


@dataclass(frozen=True, kw_only=True)
class BuiltInScene:
    """A scene that is made when it is first opened, and then read from the cache folder."""

    build: Callable[[], Scene]
    fingerprint: Callable[[], str]
    """Hash of all that `build` depends on: a cached scene with another one is not used."""
    boxes: Callable[[], Sequence[SceneBox]] = tuple
    """Objects with a class in it, besides its actors."""
    overcast_twin: str | None = None
    """Name of the scene that has this one's dry colors under clouds."""
    time_of_day: TimeOfDay = "day"
    """Light on models that are added to it."""


def built_in_names() -> tuple[str, ...]:
    """Names of all built-in scenes, the default one first."""
    names = (each.name for each in find_extensions(SCENES))
    return tuple(sorted(names, key=lambda name: (name != DEFAULT_SCENE, name)))


def built_in_scene(name: str) -> BuiltInScene | None:
    """Return a built-in scene by its name; None if there is none. Raises `ExtensionError` if it is unusable."""
    extension = find_extension(SCENES, name)
    return None if extension is None else extension.load(BuiltInScene)

"""What Gaussians can be told apart by: numbers of each, with their units."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Part
from gsrain_engine.scene.scene import Scene

from .candidates import candidates, editable
from .colors import base_colors
from .in_picture import camera_depths


class Read(NamedTuple):
    """What attributes are read from."""

    part: Part
    number: int
    """Place of the member among all of the scene, from 1."""
    ground_m: float
    camera: Camera


@dataclass(frozen=True)
class Attribute:
    """One number of each Gaussian."""

    unit: str
    help: str
    values: Callable[[Read], Float32[np.ndarray, " n"]]
    logarithmic: bool = False
    by_camera: bool = False
    """Whether it changes as the camera moves."""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    """What it can't go beyond."""


def read_attribute(name: str, read: Read) -> Float32[np.ndarray, " n"]:
    return np.asarray(ATTRIBUTES[name].values(read), np.float32)


def readings(scene: Scene, time_s: float, camera: Camera) -> dict[str, Read]:
    """Return what attributes of the candidates are read from, by their keys."""
    numbers = {member.key: number for number, member in enumerate(scene.members, 1)}
    ground = scene.ground_m or 0.0
    return {each.key: Read(each.part, numbers[each.key], ground, camera) for each in candidates(scene, time_s)}


def in_range(scene: Scene, time_s: float, camera: Camera, name: str, low: float, high: float) -> dict[str, Mask]:
    """Find Gaussians of which an attribute lies within [low, high]."""
    found: dict[str, Mask] = {}
    for key, read in readings(scene, time_s, camera).items():
        values = read_attribute(name, read)
        found[key] = Mask.of((values >= low) & (values <= high))
    return found


def layer_names(scene: Scene) -> dict[int, str]:
    """Names of the members that can be selected from, by their numbers."""
    keys = {member.key for member in editable(scene)}
    return {number: each.name for number, each in enumerate(scene.members, 1) if each.key in keys}


def _size(read: Read) -> np.ndarray:
    a, b, c = read.part.gaussians.scales.T
    return np.maximum(np.maximum(a, b), c) * np.float32(_scale(read.part))


def _scale(part: Part) -> float:
    return float(np.cbrt(abs(np.linalg.det(part.to_world[:3, :3]))))


def _elongation(read: Read) -> np.ndarray:
    a, b, c = read.part.gaussians.scales.T
    largest = np.maximum(np.maximum(a, b), c)
    middle = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return largest / np.maximum(middle, np.float32(1e-12))


def _height(read: Read) -> np.ndarray:
    row = read.part.to_world[2]
    return read.part.gaussians.means @ row[:3].astype(np.float32) + np.float32(row[3] - read.ground_m)


def _distance(read: Read) -> np.ndarray:
    way = (read.camera.world_to_camera @ read.part.to_world).astype(np.float32)
    x, y, z = (read.part.gaussians.means @ row[:3] + row[3] for row in way[:3])
    return np.sqrt(x * x + y * y + z * z)


def _hue(read: Read) -> np.ndarray:
    return _hues(base_colors(read.part))


@numba.njit(cache=True)
@no_type_check
def _hues(colors):
    """Angle of each colour on the wheel in degrees, 0 <= hue < 360; 0 for greys."""
    hues = np.zeros(len(colors), np.float32)
    for i in range(len(colors)):
        red, green, blue = colors[i, 0], colors[i, 1], colors[i, 2]
        high, low = max(red, green, blue), min(red, green, blue)
        if high > low:
            if high == red:
                sixths = (green - blue) / (high - low)
            elif high == green:
                sixths = (blue - red) / (high - low) + 2
            else:
                sixths = (red - green) / (high - low) + 4
            hues[i] = 60 * (sixths if sixths >= 0 else sixths + 6)
    return hues


def _saturation(read: Read) -> np.ndarray:
    colors = base_colors(read.part)
    high = np.maximum(np.maximum(colors[:, 0], colors[:, 1]), colors[:, 2])
    low = np.minimum(np.minimum(colors[:, 0], colors[:, 1]), colors[:, 2])
    return (high - low) / np.maximum(high, np.float32(1e-6))


def _value(read: Read) -> np.ndarray:
    colors = base_colors(read.part)
    return np.maximum(np.maximum(colors[:, 0], colors[:, 1]), colors[:, 2])


def _channel(channel: int) -> Callable[[Read], np.ndarray]:
    return lambda read: base_colors(read.part)[:, channel]


ATTRIBUTES: Mapping[str, Attribute] = {
    "opacity": Attribute("", "Largest alpha of a Gaussian, 0..1.", lambda read: read.part.gaussians.opacities,
                         bounds=(0.0, 1.0)),
    "size": Attribute("m", "Standard deviation along a Gaussian's longest axis.", _size, logarithmic=True),
    "elongation": Attribute("", "Longest axis over the second longest; needles are far to the right.", _elongation,
                            logarithmic=True),
    "height": Attribute("m", "Above the ground where it is known, else above 0 of the world.", _height),
    "depth": Attribute("m", "Along the view axis of the camera; below 0 behind it.",
                       lambda read: camera_depths(read.part, read.camera), by_camera=True),
    "distance": Attribute("m", "From the camera.", _distance, logarithmic=True, by_camera=True),
    "red": Attribute("", "Of the base colour as it is displayed, 0..1.", _channel(0)),
    "green": Attribute("", "Of the base colour as it is displayed, 0..1.", _channel(1)),
    "blue": Attribute("", "Of the base colour as it is displayed, 0..1.", _channel(2)),
    "hue": Attribute("°", "0 red, 120 green, 240 blue.", _hue, bounds=(0.0, 360.0)),
    "saturation": Attribute("", "0 grey, 1 a pure colour.", _saturation, bounds=(0.0, 1.0)),
    "value": Attribute("", "The largest of red, green and blue, 0..1.", _value),
    "layer": Attribute("", "Number of the layer or actor, in the order of the scene, from 1.",
                       lambda read: np.full(len(read.part.gaussians), read.number, np.float32)),
}  # fmt: skip
"""The one table of attributes, by name."""

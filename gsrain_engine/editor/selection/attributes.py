"""Attributes of Gaussians for selection, with units, and their histograms."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int64

from ...kernels import kernel
from ...render.view import RenderView
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem, Scene
from ..edits.members import is_editable
from .candidates import base_colors, candidates, selected, visible_gaussians
from .screen import camera_depths


class AttributeInputs(NamedTuple):
    """Inputs of the attribute functions."""

    part: DrawItem
    number: int
    """Index of the member among all of the scene, from 1."""
    ground_m: float
    camera: Camera


@dataclass(frozen=True)
class Attribute:
    """One number of each Gaussian."""

    unit: str
    help: str
    values: Callable[[AttributeInputs], Float32[np.ndarray, " n"]]
    logarithmic: bool = False
    by_camera: bool = False
    """True if it depends on the camera."""
    by_pose: bool = False
    """True if it depends on the place of a member in the world."""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    """Limits of possible values."""


def read_attribute(name: str, read: AttributeInputs) -> Float32[np.ndarray, " n"]:
    return np.asarray(ATTRIBUTES[name].values(read), np.float32)


def attribute_inputs(scene: Scene, time_s: float, camera: Camera) -> dict[str, AttributeInputs]:
    """Return the attribute inputs of the candidates, by their keys."""
    numbers = {member.key: number for number, member in enumerate(scene.members, 1)}
    ground = scene.ground_m or 0.0
    own = candidates(scene, time_s)
    return {key: AttributeInputs(part, numbers[key], ground, camera) for key, part in own.items()}


def select_attribute_range(
    scene: Scene, time_s: float, camera: Camera, name: str, low: float, high: float
) -> dict[str, BitMask]:
    """Find Gaussians with an attribute within [low, high]."""
    inputs = attribute_inputs(scene, time_s, camera)
    values = {key: read_attribute(name, read) for key, read in inputs.items()}
    return {key: BitMask.of((own >= low) & (own <= high)) for key, own in values.items()}


def layer_names(scene: Scene) -> dict[int, str]:
    """Names of the selectable members, by their numbers."""
    return {number: each.name for number, each in enumerate(scene.members, 1) if is_editable(each)}


def _largest(columns: np.ndarray) -> np.ndarray:
    """Largest of three columns; much faster than `max` along an axis this short."""
    return np.maximum(np.maximum(columns[:, 0], columns[:, 1]), columns[:, 2])


def _size(read: AttributeInputs) -> np.ndarray:
    scale = float(np.cbrt(abs(np.linalg.det(read.part.to_world[:3, :3]))))
    return _largest(read.part.gaussians.scales) * np.float32(scale)


def _elongation(read: AttributeInputs) -> np.ndarray:
    a, b, c = read.part.gaussians.scales.T
    middle = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return _largest(read.part.gaussians.scales) / np.maximum(middle, np.float32(1e-12))


def _height(read: AttributeInputs) -> np.ndarray:
    row = read.part.to_world[2]
    return read.part.gaussians.means @ row[:3].astype(np.float32) + np.float32(row[3] - read.ground_m)


def _distance(read: AttributeInputs) -> np.ndarray:
    to_camera = (read.camera.world_to_camera @ read.part.to_world).astype(np.float32)
    x, y, z = (read.part.gaussians.means @ row[:3] + row[3] for row in to_camera[:3])
    return np.sqrt(x * x + y * y + z * z)


@kernel()
@no_type_check
def _hues(colors):
    """Hue of each color in degrees, 0 <= hue < 360; 0 for grays."""
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


def _saturation(read: AttributeInputs) -> np.ndarray:
    colors = base_colors(read.part)
    high, low = _largest(colors), np.minimum(np.minimum(colors[:, 0], colors[:, 1]), colors[:, 2])
    return (high - low) / np.maximum(high, np.float32(1e-6))


ATTRIBUTES: Mapping[str, Attribute] = {
    "opacity": Attribute("", "Largest alpha of a Gaussian, 0..1.", lambda read: read.part.gaussians.opacities,
                         bounds=(0.0, 1.0)),
    "size": Attribute("m", "Standard deviation along a Gaussian's longest axis.", _size, logarithmic=True),
    "elongation": Attribute("", "Longest axis over the second longest; needles are far to the right.", _elongation,
                            logarithmic=True),
    "height": Attribute("m", "Above the ground where it is known, else above 0 of the world.", _height,
                        by_pose=True),
    "depth": Attribute("m", "Along the view axis of the camera; below 0 behind it.",
                       lambda read: camera_depths(read.part, read.camera), by_camera=True, by_pose=True),
    "distance": Attribute("m", "From the camera.", _distance, logarithmic=True, by_camera=True,
                          by_pose=True),
    "red": Attribute("", "Of the base color as it is displayed, 0..1.", lambda read: base_colors(read.part)[:, 0]),
    "green": Attribute("", "Of the base color as it is displayed, 0..1.", lambda read: base_colors(read.part)[:, 1]),
    "blue": Attribute("", "Of the base color as it is displayed, 0..1.", lambda read: base_colors(read.part)[:, 2]),
    "hue": Attribute("°", "0 red, 120 green, 240 blue.", lambda read: _hues(base_colors(read.part)),
                     bounds=(0.0, 360.0)),
    "saturation": Attribute("", "0 gray, 1 a pure color.", _saturation, bounds=(0.0, 1.0)),
    "value": Attribute("", "The largest of red, green and blue, 0..1.", lambda read: _largest(base_colors(read.part))),
    "layer": Attribute("", "Number of the layer or actor, in the order of the scene, from 1.",
                       lambda read: np.full(len(read.part.gaussians), read.number, np.float32)),
}  # fmt: skip

# Histograms, recomputed only on changes

BINS = 128
_SAMPLE = 50_000  # number of Gaussians from which the range is taken, without the outermost in a thousand


class Histogram(NamedTuple):
    """Counts in bins of equal width; for a logarithmic attribute, of its decimal logarithm."""

    edges: Float64[np.ndarray, " bins_and_one"]
    """In the attribute's own unit."""
    shown: Int64[np.ndarray, " bins"]
    selected: Int64[np.ndarray, " bins"]
    """Values beyond the edges count in the outermost bins."""

    def opened(self, low: float, high: float) -> tuple[float, float]:
        """Return the range, extended to infinity where it touches an outer edge."""
        slack = 1e-6 * abs(float(self.edges[-1] - self.edges[0]))
        return (low if low > self.edges[0] + slack else -np.inf, high if high < self.edges[-1] - slack else np.inf)

    def count_within(self, low: float, high: float) -> int:
        """Number of shown Gaussians within a range, by whole bins whose middle lies in it."""
        middles = (self.edges[1:] + self.edges[:-1]) / 2
        return int(self.shown[(middles >= low) & (middles <= high)].sum())


class AttributeHistogram:
    """Histograms of one attribute at a time."""

    _inputs: object = None
    _histogram: Histogram | None = None

    def __init__(self) -> None:
        self._values: dict[str, tuple[object, Float32[np.ndarray, " n"]]] = {}

    def of(self, scene: Scene, shot: RenderView, name: str) -> Histogram:
        """Return the histogram of an attribute over selectable Gaussians, for the camera of `shot`."""
        poses = (each.pose_at(shot.time_s) for each in scene.actors)
        depends_on_pose = ATTRIBUTES[name].by_pose
        places = tuple(pose is not None and (not depends_on_pose or pose.tobytes()) for pose in poses)
        key = (scene, name, places, *_view(shot, name))
        if self._histogram is None or key != self._inputs:
            self._histogram, self._inputs = self._make(scene, shot, name), key
        return self._histogram

    def _make(self, scene: Scene, shot: RenderView, name: str) -> Histogram:
        reads = attribute_inputs(scene, shot.time_s, shot.camera)
        self._values = {key: self._read(key, name, read, shot) for key, read in reads.items()}
        values = {key: values for key, (_, values) in self._values.items()}
        masks = {key: visible_gaussians(scene.member(key)) for key in values}
        low, high = _range(values, masks, ATTRIBUTES[name], step=name == "layer")
        both = np.zeros((2, BINS), np.int64)
        for key, own in values.items():
            places = np.clip((own - np.float32(low)) * np.float32(BINS / (high - low)), 0, BINS - 1).astype(np.int16)
            for row, mask in zip(both, (masks[key], selected(scene.member(key)) & masks[key]), strict=True):
                if mask:
                    row += np.bincount(places if mask.size == mask.count else places[mask.flags], minlength=BINS)
        edges = np.linspace(low, high, BINS + 1)
        return Histogram(10**edges if ATTRIBUTES[name].logarithmic else edges, both[0], both[1])

    def _read(
        self, key: str, name: str, read: AttributeInputs, shot: RenderView
    ) -> tuple[object, Float32[np.ndarray, " n"]]:
        """Compute an attribute, or its logarithm, unless none of its inputs have changed."""
        part = read.part
        colors = None if part.colors is None else part.colors.tobytes()
        transform, view = part.to_world.tobytes(), _view(shot, name)
        depends_on = (part.gaussians, transform, colors, read.ground_m, name, read.number, *view)
        if key in self._values and self._values[key][0] == depends_on:
            return self._values[key]
        values = read_attribute(name, read)
        if ATTRIBUTES[name].logarithmic:
            values = np.log10(np.maximum(values, np.float32(1e-12)))
        return depends_on, values


def _view(shot: RenderView, name: str) -> tuple[bytes, ...]:
    return (shot.camera.world_to_camera.tobytes(),) if ATTRIBUTES[name].by_camera else ()


def _range(
    values: dict[str, Float32[np.ndarray, " n"]], masks: dict[str, BitMask], attribute: Attribute, *, step: bool
) -> tuple[float, float]:
    visible = [own[masks[key].flags] for key, own in values.items() if masks[key]]
    every = np.concatenate([np.zeros(0, np.float32), *(own[:: max(1, len(own) // _SAMPLE)] for own in visible)])
    every = every[np.isfinite(every)]
    if not len(every):
        return (-1.0, 0.0) if attribute.logarithmic else (0.0, 1.0)
    low, high = (float(each) for each in np.quantile(every, (0.001, 0.999)))
    if step:
        return low - 0.5, high + 0.5
    margin = max(0.02 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
    return max(low - margin, attribute.bounds[0]), min(high + margin, attribute.bounds[1])

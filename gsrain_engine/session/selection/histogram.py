"""How an attribute is spread over what is shown and over what is selected; worked out again only when it changes."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int64

from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.scene import Scene

from .attributes import ATTRIBUTES, Attribute, Read, read_attribute, readings
from .candidates import shown
from .combine import selected

BINS = 128
_SAMPLE = 50_000
"""Gaussians from which the range is taken: all but the outermost in a thousand."""


class Histogram(NamedTuple):
    """Counts by bins of equal width; of a logarithmic attribute the bins are of its decimal logarithm."""

    edges: Float64[np.ndarray, " bins_and_one"]
    """In the attribute's own unit."""
    shown: Int64[np.ndarray, " bins"]
    selected: Int64[np.ndarray, " bins"]
    """What is beyond the edges counts in the outermost bins."""

    def opened(self, low: float, high: float) -> tuple[float, float]:
        """Return a range that reaches on without end where it reaches an outer edge."""
        slack = 1e-6 * abs(float(self.edges[-1] - self.edges[0]))
        return (low if low > self.edges[0] + slack else -np.inf, high if high < self.edges[-1] - slack else np.inf)

    def count_within(self, low: float, high: float) -> int:
        """How many are shown within a range, by whole bins whose middle lies in it."""
        middles = (self.edges[1:] + self.edges[:-1]) / 2
        return int(self.shown[(middles >= low) & (middles <= high)].sum())


@dataclass(slots=True)
class AttributeHistogram:
    """Histograms of one attribute at a time."""

    _values: dict[str, tuple[object, Float32[np.ndarray, " n"]]] = field(
        default_factory=dict[str, "tuple[object, Float32[np.ndarray, ' n']]"]
    )
    _made_of: object = None
    _made: Histogram | None = None

    def of(self, scene: Scene, shot: Shot, name: str) -> Histogram:
        """Return the histogram of an attribute over what can be selected, as `shot` sees it."""
        key = (scene, name, shot.time_s if scene.actors else 0.0, *_view(shot, name))
        if self._made is None or key != self._made_of:
            self._made, self._made_of = self._make(scene, shot, name), key
        return self._made

    def _make(self, scene: Scene, shot: Shot, name: str) -> Histogram:
        reads = readings(scene, shot.time_s, shot.camera)
        self._values = {key: self._read(key, name, read, shot) for key, read in reads.items()}
        values = {key: values for key, (_, values) in self._values.items()}
        masks = {key: shown(scene.member(key)) for key in values}
        low, high = _range(values, masks, ATTRIBUTES[name], step=name == "layer")
        both = np.zeros((2, BINS), np.int64)
        for key, own in values.items():
            places = np.clip((own - np.float32(low)) * np.float32(BINS / (high - low)), 0, BINS - 1).astype(np.int16)
            for row, mask in zip(both, (masks[key], selected(scene.member(key)) & masks[key]), strict=True):
                if mask:
                    row += np.bincount(places if mask.size == mask.count else places[mask.flags], minlength=BINS)
        edges = np.linspace(low, high, BINS + 1)
        return Histogram(10**edges if ATTRIBUTES[name].logarithmic else edges, both[0], both[1])

    def _read(self, key: str, name: str, read: Read, shot: Shot) -> tuple[object, Float32[np.ndarray, " n"]]:
        """Read an attribute, or its logarithm, unless nothing that it depends on has changed."""
        part = read.part
        colors = None if part.colors is None else part.colors.tobytes()
        depends_on = (part.gaussians, part.to_world.tobytes(), colors, read.ground_m, name, read.number)
        depends_on = (*depends_on, *_view(shot, name))
        if key in self._values and self._values[key][0] == depends_on:
            return self._values[key]
        values = read_attribute(name, read)
        if ATTRIBUTES[name].logarithmic:
            values = np.log10(np.maximum(values, np.float32(1e-12)))
        return depends_on, values


def _view(shot: Shot, name: str) -> tuple[bytes, ...]:
    return (shot.camera.world_to_camera.tobytes(),) if ATTRIBUTES[name].by_camera else ()


def _range(
    values: dict[str, Float32[np.ndarray, " n"]], masks: dict[str, Mask], attribute: Attribute, *, step: bool
) -> tuple[float, float]:
    sample = [_sampled(own[masks[key].flags]) for key, own in values.items() if masks[key]]
    every = np.concatenate([np.zeros(0, np.float32), *sample])
    every = every[np.isfinite(every)]
    if not len(every):
        return (-1.0, 0.0) if attribute.logarithmic else (0.0, 1.0)
    low, high = (float(each) for each in np.quantile(every, (0.001, 0.999)))
    if step:
        return low - 0.5, high + 0.5
    margin = max(0.02 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
    least, most = attribute.bounds
    return max(low - margin, least), min(high + margin, most)


def _sampled(values: Float32[np.ndarray, " m"]) -> Float32[np.ndarray, " k"]:
    return values[:: max(1, len(values) // _SAMPLE)]

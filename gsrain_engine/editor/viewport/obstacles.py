"""Obstacles of the viewport camera: cells of space that a scene's surfaces occupy, so that an orbit stops at a wall."""

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from ...scene.geometry import matrices_from_quaternions
from ...scene.scene import DrawItem, Scene
from ..background import Background

_OPAQUE = 0.5  # opacity from which a Gaussian is a surface; floaters are fainter
_SOLID_SAMPLES = 3  # samples of Gaussians from which a cell is occupied: a single floater is none
_STEPS = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])  # standard deviations at which a Gaussian's two long axes are sampled
_CLOSED_SHARE = 0.75  # share of the Gaussians whose neighboring samples are at most a cell apart
_MAX_GAUSSIANS = 1_000_000
_CELLS_ACROSS = 400.0  # of the scene's core, at the most
_BITS = 21  # of a cell's coordinate, in a key of 63 bits
CLEARANCE_M = 0.25
"""Distance to a surface at which the camera stops, and smallest size of a cell."""


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Occupied cells of a grid in the world (meters)."""

    keys: Int64[np.ndarray, " n"]
    """Sorted."""
    cell_m: float

    @classmethod
    def of(cls, items: Sequence[DrawItem], radius_m: float) -> "Obstacles":
        """Fill the cells of opaque Gaussians; `radius_m` is that of the scene's core."""
        found = [_samples(item) for item in items]
        steps_m = np.concatenate([np.zeros(1), *(each.steps_m for each in found)])
        cell_m = max(CLEARANCE_M, 2 * radius_m / _CELLS_ACROSS, float(np.quantile(steps_m, _CLOSED_SHARE)))
        keys = [_cells(each.points_m, cell_m) for each in found]
        cells, counts = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]), return_counts=True)
        return cls(cells[counts >= _SOLID_SAMPLES], cell_m)

    def is_free(self, points_m: Float64[np.ndarray, "n 3"]) -> bool:
        """Return whether no point is in an occupied cell."""
        if not len(self.keys):
            return True
        keys = _cells(points_m, self.cell_m)
        return not bool((self.keys[np.searchsorted(self.keys, keys).clip(max=len(self.keys) - 1)] == keys).any())

    def stops(self, start_m: Float64[np.ndarray, "3"], end_m: Float64[np.ndarray, "3"]) -> bool:
        """Return whether a way meets a surface, or ends close to one. A way that starts in a surface may leave it."""
        way = end_m - start_m
        length = float(np.linalg.norm(way))
        if length == 0 or not self.is_free(start_m[None]):
            return False
        reach = 1 + CLEARANCE_M / length
        shares = np.linspace(0, reach, 2 + int(2 * length * reach / self.cell_m))[1:]
        return not self.is_free(start_m + shares[:, None] * way)


class ObstacleFinder:
    """The obstacles of the present scene, found in a thread at the first use. Main thread only."""

    def __init__(self, background: Background) -> None:
        self._background = background
        self._key: object = None
        self._found: Future[Obstacles] | None = None

    def of(self, scene: Scene, radius_m: float, *, wait: bool = False) -> Obstacles | None:
        """Return the obstacles of the visible layers; None while they are looked for, unless `wait`."""
        if scene.geometry_key != self._key or self._found is None:
            self._key = scene.geometry_key
            solid = [each for each in scene.layers if each.visible and each.kind != "sky"]
            items = [part for each in solid if (part := scene.part(each)) is not None]
            self._found = self._background.submit(Obstacles.of, items, radius_m, lane="obstacles")
        return self._found.result() if wait or self._found.done() else None


class _Samples(NamedTuple):
    points_m: Float64[np.ndarray, "n 3"]
    steps_m: Float64[np.ndarray, " g"]
    """Largest distance between neighboring samples of each Gaussian."""


def _samples(item: DrawItem) -> _Samples:
    """Points of the opaque Gaussians, over their two longest axes; in the world."""
    gaussians = item.gaussians
    is_there = gaussians.opacities * item.opacity >= _OPAQUE
    if item.left_out:
        is_there &= ~item.left_out.flags
    there = np.flatnonzero(is_there)
    there = there[:: -(-len(there) // _MAX_GAUSSIANS) or 1]
    scales = gaussians.scales[there].astype(np.float64)
    axes = matrices_from_quaternions(gaussians.quaternions[there].astype(np.float64)) * scales[:, None, :]
    longest = np.argsort(scales, axis=1)[:, 1:]
    first, second = (np.take_along_axis(axes, longest[:, None, k : k + 1], axis=2)[..., 0] for k in (1, 0))
    u, v = (each.ravel() for each in np.meshgrid(_STEPS, _STEPS))
    means = gaussians.means[there].astype(np.float64)
    points = means[:, None] + u[None, :, None] * first[:, None] + v[None, :, None] * second[:, None]
    scale = float(np.cbrt(np.linalg.det(item.to_world[:3, :3])))
    steps_m = scale * (_STEPS[1] - _STEPS[0]) * scales.max(axis=1, initial=0.0)
    return _Samples(points.reshape(-1, 3) @ item.to_world[:3, :3].T + item.to_world[:3, 3], steps_m)


def _cells(points_m: Float64[np.ndarray, "n 3"], cell_m: float) -> Int64[np.ndarray, " n"]:
    """Keys of the cells of points; those outside of the grid are in its outermost cells."""
    half = 1 << (_BITS - 1)
    cells = np.clip(np.floor(points_m / cell_m), -half, half - 1).astype(np.int64) + half
    return (cells[:, 0] << (2 * _BITS)) | (cells[:, 1] << _BITS) | cells[:, 2]

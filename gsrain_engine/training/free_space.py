"""The room between cameras and what they see: it is empty, so no Gaussian of the static scene may stand in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Float64, Shaped
from numba import njit, prange
from scipy.ndimage import minimum_filter
from scipy.spatial import KDTree

from ..scene.camera import Camera
from .parameters import SplatParameters, Tensor
from .strategy import Strategy
from .surfels import LONGEST

torch: Any = import_module("torch")

_ROWS, _COLUMNS = 48, 80
"""Cells that each picture is divided into."""

_WINDOW = 5
"""The nearest point in so many cells, each way, limits the free room; where there is none, none is known to be free."""

_NEAR_SHARE = 0.03
"""Free all around the way of the cameras, over the median depth: less than they are above the road."""

_LEEWAY = 3.0
"""So many times longer than at first Gaussians may become: what is far away and even is drawn well by large ones."""

_EVERY = 25
"""Steps between two clearances; shorter than any density control's own rhythm, and a part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpaceCarving:
    """How far each camera sees freely, by cells of its picture."""

    poses: Float32[np.ndarray, "v 3 4"]
    """World to camera."""
    lenses: Float32[np.ndarray, "v 4"]
    """Focal lengths and centre in cells: across, down, column, row."""
    limits: Float32[np.ndarray, "v rows columns"]
    """Depth along the view axis up to which there is nothing; 0 where nothing is known."""
    way: Float32[np.ndarray, "p 3"]
    """Where the cameras went."""
    near: float
    """Distance to that way within which there is nothing."""

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        depths: Sequence[Float32[np.ndarray, "_ _"]],
        way: Float64[np.ndarray, "p 3"],
        share: float,
    ) -> "FreeSpaceCarving | None":
        """Take a share of the depth of each picture for free; None where no picture has any depth.

        Args:
            cameras: Without distortion.
            depths: What was measured of the static scene in each picture, 0 where nothing was.
            way: Where the cameras went, in the capture's world.
            share: Part of the depth, 0 to 1: between measured points there may be nearer things.
        """
        known = np.concatenate([np.zeros(0, np.float32), *(depth[depth > 0] for depth in depths)])
        if not len(known):
            return None
        near = _NEAR_SHARE * float(np.median(known))
        lenses = [
            [c.fx * _COLUMNS / c.width, c.fy * _ROWS / c.height, c.cx * _COLUMNS / c.width, c.cy * _ROWS / c.height]
            for c in cameras
        ]
        return cls(
            np.stack([camera.world_to_camera[:3] for camera in cameras]).astype(np.float32),
            np.array(lenses, np.float32),
            np.stack([share * _nearest_surfaces(depth) for depth in depths]).astype(np.float32),
            way.astype(np.float32),
            near,
        )

    def holds(self, means: Float32[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which points stand in it."""
        found = self.distances(means) < self.near
        _look(np.ascontiguousarray(means), self.poses, self.lenses, self.limits, found)
        return found

    def distances(self, means: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        """How far points are from the way of the cameras."""
        return KDTree(self.way).query(means)[0].astype(np.float32)


class FreeSpaceStrategy:
    """A density control that takes everything out of the free space too, as long as the training goes on."""

    def __init__(self, control: Strategy, free: FreeSpaceCarving, steps: int) -> None:
        self._control, self._free, self._last = control, free, steps - 1

    def observe(self, step: int, rendered: Any, rows: slice | Tensor = slice(None)) -> None:
        self._control.observe(step, rendered, rows)

    def adapt(self, step: int, parameters: SplatParameters, generator: Tensor) -> str | None:
        """Change what the control inside would; then, now and then and at the end, clear what cameras look through."""
        done = self._control.adapt(step, parameters, generator)
        if step % _EVERY and step != self._last:
            return done
        count = prune_free_space(parameters, self._free)
        clip_long_gaussians(parameters, self._free)
        return ", ".join([*([done] if done else []), f"{count} cleared away"]) if count else done

    def regularization(self, parameters: SplatParameters) -> Tensor | None:
        return self._control.regularization(parameters)

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return self._control.state()

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        self._control.restore(state)


def prune_free_space(parameters: SplatParameters, free: FreeSpaceCarving) -> int:
    """Remove the Gaussians whose middle stands in free space; returns how many."""
    means = _means(parameters)
    standing = free.holds(means)
    count = int(standing.sum())
    if count:
        parameters.keep(torch.as_tensor(~standing, device=parameters.device))
    return count


def clip_long_gaussians(parameters: SplatParameters, free: FreeSpaceCarving) -> None:
    """Let no Gaussian be longer than a part of its distance to the way of the cameras, see `LONGEST`."""
    limits = torch.as_tensor(np.log(np.maximum(_LEEWAY * LONGEST * free.distances(_means(parameters)), 1e-9)))
    with torch.no_grad():
        sizes = parameters.tensors["log_scales"]
        sizes.copy_(torch.minimum(sizes, limits.to(sizes)[:, None]))


def _means(parameters: SplatParameters) -> Float32[np.ndarray, "n 3"]:
    return parameters.tensors["means"].detach().cpu().to(torch.float32).numpy()


def _nearest_surfaces(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "rows columns"]:
    """The least depth that was measured in the window around each cell; 0 where nothing was."""
    rows, columns = np.nonzero(depth > 0)
    cells = np.full((_ROWS, _COLUMNS), np.inf, np.float32)
    np.minimum.at(cells, (rows * _ROWS // depth.shape[0], columns * _COLUMNS // depth.shape[1]), depth[rows, columns])
    least = minimum_filter(cells, _WINDOW)
    return np.where(np.isfinite(least), least, 0).astype(np.float32)


@njit(cache=True, parallel=True, error_model="numpy")
@no_type_check
def _look(means, poses, lenses, limits, found):
    """Mark each of `means` (n, 3) that is nearer to a camera than the limit of the cell that it falls into."""
    views, rows, columns = limits.shape
    for i in prange(len(means)):
        for v in range(views):
            pose, lens = poses[v], lenses[v]
            x = pose[0, 0] * means[i, 0] + pose[0, 1] * means[i, 1] + pose[0, 2] * means[i, 2] + pose[0, 3]
            y = pose[1, 0] * means[i, 0] + pose[1, 1] * means[i, 1] + pose[1, 2] * means[i, 2] + pose[1, 3]
            z = pose[2, 0] * means[i, 0] + pose[2, 1] * means[i, 1] + pose[2, 2] * means[i, 2] + pose[2, 3]
            if z > 0:
                column, row = np.floor(x / z * lens[0] + lens[2]), np.floor(y / z * lens[1] + lens[3])
                if 0 <= column < columns and 0 <= row < rows and z < limits[v, int(row), int(column)]:
                    found[i] = True
                    break

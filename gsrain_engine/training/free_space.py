"""Free-space carving: removes Gaussians of the static scene between the cameras and the surfaces they observe."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.ndimage import minimum_filter
from scipy.spatial import KDTree

from ..kernels import kernel, range_of
from ..render.gsplat_input import uploaded
from ..scene.camera import Camera
from .parameters import SplatParameters, Tensor, indices_of
from .surfels import LONGEST, Depths

torch: Any = import_module("torch")
_ROWS, _COLUMNS = 48, 80
_WINDOW = 5
"""Side in cells of the window whose nearest point limits the free space; without points nothing is known to be free."""

_NEAR_SHARE = 0.03
"""Radius of free space around the camera trajectory over the median depth; below the cameras' height above the road."""

_LEEWAY = 3.0
"""Factor by which Gaussians may exceed the initial length limit: large Gaussians suit distant uniform areas."""

_CHUNK = 1 << 24
"""Pairs of point and camera, or of point and position, that a GPU handles at once, in some 500 MB of memory."""

_EVERY = 25  # steps between two clearances; shorter than the interval of any density control, and a divisor of it


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpaceCarving:
    """Free depth in front of each camera, by image cell."""

    poses: Float32[np.ndarray, "v 3 4"]
    """World to camera."""
    lenses: Float32[np.ndarray, "v 4"]
    """Focal lengths and principal point in cells: fx, fy, cx, cy."""
    limits: Float32[np.ndarray, "v rows columns"]
    """Depth along the view axis up to which space is empty; 0 where unknown."""
    trajectory: Float32[np.ndarray, "p 3"]
    near: float
    """Distance to the trajectory within which space is empty."""

    @classmethod
    def of(
        cls, cameras: Sequence[Camera], depths: Depths, trajectory: Float64[np.ndarray, "p 3"], share: float
    ) -> "FreeSpaceCarving | None":
        """Treat a share of each image's depth as free space; None if no image has any depth.

        `depths` are measured ones of the static scene, 0 where unmeasured, in front of undistorted `cameras`;
        `trajectory` has positions along that of the cameras, in the capture's world; `share` of the depth is 0 to 1,
        since there may be nearer objects between measured points.
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
            trajectory.astype(np.float32),
            near,
        )

    def holds(self, means: Float32[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Mask of the points in free space."""
        found = self.distances(means) < self.near
        _mark_free(np.ascontiguousarray(means), self.poses, self.lenses, self.limits, found)
        return found

    def distances(self, means: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        """Distance of each point to the camera trajectory."""
        return KDTree(self.trajectory).query(means)[0].astype(np.float32)


class DeviceFreeSpace:
    """The same free space on a GPU, by torch; agrees with `FreeSpaceCarving` to float32 rounding."""

    def __init__(self, free: FreeSpaceCarving, device: str) -> None:
        self.near = free.near
        self._trajectory = uploaded(free.trajectory, device)
        self._rotations, self._shifts = uploaded(free.poses[:, :, :3], device), uploaded(free.poses[:, :, 3:], device)
        self._lenses, self._limits = uploaded(free.lenses, device), uploaded(free.limits, device)

    def holds(self, means: Tensor) -> Tensor:
        """Mask (n,) of the points (n, 3) in free space."""
        found = self.distances(means) < self.near
        views, rows, columns = self._limits.shape
        chunk = max(_CHUNK // max(len(means), 1), 1)
        for first in range(0, views, chunk):
            own = slice(first, first + chunk)
            x, y, z = (self._rotations[own] @ means.T + self._shifts[own]).unbind(1)
            fx, fy, cx, cy = self._lenses[own, :, None].unbind(1)
            column, row = torch.floor(x / z * fx + cx), torch.floor(y / z * fy + cy)
            inside = (z > 0) & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            cell = torch.where(inside, row * columns + column, 0).long()
            found |= (inside & (z < self._limits[own].reshape(len(cell), -1).gather(1, cell))).any(dim=0)
        return found

    def distances(self, means: Tensor) -> Tensor:
        """Distance (n,) of each point (n, 3) to the camera trajectory."""
        pieces = means.split(max(_CHUNK // len(self._trajectory), 1))
        return torch.cat([self._nearest(each) for each in pieces])

    def _nearest(self, means: Tensor) -> Tensor:
        """The same at once. `torch.cdist` runs a block of threads per pair, or is off by 1e-3 of the coordinates."""
        squares = means.new_zeros((len(means), len(self._trajectory)))
        for axis in range(3):
            offsets = means[:, axis, None] - self._trajectory[:, axis]
            squares.addcmul_(offsets, offsets)
        return squares.amin(dim=1).sqrt()


def clear_free_space(
    step: int, steps: int, parameters: SplatParameters, free: FreeSpaceCarving | DeviceFreeSpace
) -> str | None:
    """Clear free space periodically and at the last of `steps`; returns a short summary, or None."""
    if step % _EVERY and step != steps - 1:
        return None
    count = prune_free_space(parameters, free)
    clip_long_gaussians(parameters, free)
    return f"{count} cleared away" if count else None


def prune_free_space(parameters: SplatParameters, free: FreeSpaceCarving | DeviceFreeSpace) -> int:
    """Remove the Gaussians whose mean is in free space; returns their number."""
    if isinstance(free, DeviceFreeSpace):
        count = len(parameters)
        (outside,) = indices_of(~free.holds(parameters.tensors["means"].detach()))
        if len(outside) < count:
            parameters.keep(outside)
        return count - len(outside)
    is_inside = free.holds(parameters.to_means())
    if is_inside.any():
        parameters.keep(torch.as_tensor(~is_inside, device=parameters.device))
    return int(is_inside.sum())


def clip_long_gaussians(parameters: SplatParameters, free: FreeSpaceCarving | DeviceFreeSpace) -> None:
    """Limit each Gaussian's length to a share of its distance to the camera trajectory, see `LONGEST`."""
    if isinstance(free, DeviceFreeSpace):
        distances = free.distances(parameters.tensors["means"].detach())
        limits = (_LEEWAY * LONGEST * distances).clamp_min(1e-9).log()
    else:
        limits = torch.as_tensor(np.log(np.maximum(_LEEWAY * LONGEST * free.distances(parameters.to_means()), 1e-9)))
    with torch.no_grad():
        sizes = parameters.tensors["log_scales"]
        sizes.copy_(torch.minimum(sizes, limits.to(sizes)[:, None]))


def _nearest_surfaces(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "rows columns"]:
    """Smallest depth measured in the window around each cell; 0 where unmeasured."""
    rows, columns = np.nonzero(depth > 0)
    cells = np.full((_ROWS, _COLUMNS), np.inf, np.float32)
    np.minimum.at(cells, (rows * _ROWS // depth.shape[0], columns * _COLUMNS // depth.shape[1]), depth[rows, columns])
    nearest = minimum_filter(cells, _WINDOW)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _mark_free(portion, means, poses, lenses, limits, found):
    """Mark each of `means` (n, 3) that is nearer to a camera than the limit of its cell."""
    views, rows, columns = limits.shape
    for i in range_of(portion, len(means)):
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

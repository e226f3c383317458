"""Flat Gaussians that cover what one view sees: a disc a cell of pixels, along the surface that its depth shows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.datasets.capture import View
from gsrain_engine.datasets.pixels.view_rays import pixel_rays
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.rotations import quaternions_from_matrices

SPREAD = 0.6
"""Standard deviation of a disc over the spacing of discs: they overlap without blurring much."""
_THICKNESS = 0.1
"""Standard deviation across the surface over the smaller one along it."""
_STEEPEST = 16.0
"""How much longer a disc may be than wide: surfaces seen at a grazing angle are not told precisely."""
_SLIGHT, _STEEP, _STRAIGHT = 0.05, 0.5, 0.3
"""Relative change of depth from pixel to pixel: a slight one is no edge. A larger one, up to a steep one, as of a road
far away, is none where the changes before and after differ by no more than this part."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfels:
    """Discs on surfaces, in the world of the capture."""

    means: Float32[np.ndarray, "n 3"]
    axes: Float32[np.ndarray, "n 2 3"]
    """What a step to the next disc is, across and down the picture, along the surface."""
    colors: Float32[np.ndarray, "n 3"]
    """Display colours, 0..1."""

    def __len__(self) -> int:
        return len(self.means)

    @classmethod
    def joined(cls, parts: "list[Surfels]") -> "Surfels":
        """Put sets together, in order."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("means", "axes", "colors")))

    def gaussians(self, opacity: float) -> Gaussians:
        """Return discs of Gaussians whose sigma is `SPREAD` of a step, thin across the surface."""
        first, second = self.axes[:, 0], self.axes[:, 1]
        covariances = np.einsum("ni,nj->nij", first, first) + np.einsum("ni,nj->nij", second, second)
        squares, vectors = np.linalg.eigh(covariances.astype(np.float64))  # rising: the surface's normal comes first
        sizes = SPREAD * np.sqrt(np.maximum(squares, 0))
        sizes[:, 2] = np.minimum(sizes[:, 2], _STEEPEST * sizes[:, 1])
        sizes[:, 0] = _THICKNESS * sizes[:, 1]
        vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
        return Gaussians(
            self.means,
            sizes.astype(np.float32),
            quaternions_from_matrices(vectors).astype(np.float32),
            np.full(len(self), opacity, np.float32),
            sh_from_color(self.colors),
        )


def surfels_of_view(
    view: View, depth: Float32[np.ndarray, "h w"], stride: int, wanted: Bool[np.ndarray, "rows columns"]
) -> Surfels:
    """Make one disc for each wanted cell of stride x stride pixels that has a depth, in the cell's middle.

    Args:
        view: Without distortion.
        depth: Along the view axis, 0 where nothing is.
        stride: Pixels a cell is wide and high.
        wanted: Cells to be covered, see `cells`.
    """
    rows, columns = np.nonzero(wanted)
    v = np.minimum(rows * stride + stride // 2, view.camera.height - 1)
    u = np.minimum(columns * stride + stride // 2, view.camera.width - 1)
    there = depth[v, u] > 0
    rows, columns, v, u = rows[there], columns[there], v[there], u[there]
    rays = pixel_rays(view.camera)[v, u]
    z = depth[v, u][:, None]
    across, down = slopes(depth)
    step = np.array([1 / view.camera.fx, 1 / view.camera.fy], np.float32)
    rotation = view.camera.world_to_camera[:3, :3].astype(np.float32)
    # One pixel further the place is (z + dz) (ray + dray) - z ray; the slope is relative: dz = z * slope.
    first = z * (step[0] * rotation[0] + across[v, u][:, None] * rays)
    second = z * (step[1] * rotation[1] + down[v, u][:, None] * rays)
    eye = view.camera.position.astype(np.float32)
    colors = cell_means(view.image, stride)[rows, columns]
    return Surfels(eye + z * rays, np.stack([first, second], axis=1) * np.float32(stride), colors)


def slopes(depth: Float32[np.ndarray, "h w"]) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Relative change of depth a pixel, across and down; 0 at edges and where nothing is.

    Of both neighbours the one counts whose inverse depth, which is linear on planes, is nearer.
    """
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), 0)
    found: list[Float32[np.ndarray, "h w"]] = []
    for axis in (1, 0):
        steps = np.diff(inverse, axis=axis)
        nothing = np.full_like(inverse[:, :1] if axis else inverse[:1], np.inf)
        before = np.concatenate([nothing, steps], axis=axis)
        after = np.concatenate([steps, nothing], axis=axis)
        smaller = np.where(np.abs(before) < np.abs(after), before, after)
        change = np.where(depth > 0, smaller * depth, 0)
        with np.errstate(invalid="ignore"):
            bend = np.abs(before - after) / np.maximum(np.maximum(np.abs(before), np.abs(after)), 1e-12)
        is_surface = (np.abs(change) < _SLIGHT) | ((bend < _STRAIGHT) & (np.abs(change) < _STEEP))
        found.append(np.where(is_surface, -change, 0).astype(np.float32))
    return found[0], found[1]


def cells(camera: Camera, stride: int) -> tuple[int, int]:
    """How many rows and columns of cells a picture has."""
    return -(-camera.height // stride), -(-camera.width // stride)


def cell_means(pixels: np.ndarray, stride: int) -> Float32[np.ndarray, "rows columns c"]:
    """Mean of the pixels of each cell, of 8-bit colours as 0..1."""
    height, width = pixels.shape[:2]
    rows, columns = np.arange(0, height, stride), np.arange(0, width, stride)
    sums = np.asarray(np.add.reduceat(np.add.reduceat(pixels.astype(np.float32), rows, axis=0), columns, axis=1))
    tall = np.asarray(np.diff(np.append(rows, height)), np.float32)
    wide = np.asarray(np.diff(np.append(columns, width)), np.float32)
    scale = 255.0 if pixels.dtype == np.uint8 else 1.0
    return np.asarray(sums / (tall[:, None, None] * wide[None, :, None] * scale), np.float32)

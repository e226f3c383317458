"""Gaussians to begin a training with: surfaces that lidar, depth or points tell of, in the colours of the views."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.ndimage import uniform_filter
from scipy.spatial import KDTree

from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.datasets.pixels.known_depth import KnownDepth, known_depth
from gsrain_engine.datasets.pixels.moving_masks import moving_boxes, static_mask
from gsrain_engine.datasets.pixels.view_rays import pixel_rays
from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.members import Part

from .camera_way import camera_way
from .hidden_ground import hidden_ground
from .point_colors import point_colors, projected
from .shortened import shortened
from .surfels import Surfels, cell_means, cells, surfels_of_view

SURFACE_OPACITY = 0.85
"""Of Gaussians whose place is known: together they cover it, and gradients still pass."""
RANDOM_OPACITY = 0.1
"""Of Gaussians whose place was guessed, as in 3DGS (Kerbl et al. 2023)."""
_COVERED = 6 / 9
"""So many Gaussians a cell, in a window of 3x3 cells, are enough."""
_COARSER = 1.7
"""Where those that are there are so many times larger than a cell, the nearer view adds its own."""
_FOR_HOLES = 0.1
"""Part of the budget that is kept for holes."""
_FOR_GROUND, _FOR_PIECES = 0.05, 0.2
"""Parts of the budget that are kept for the road under the ego, and with it for cutting what is too long."""
_HOLE = 0.5
"""Alpha below which a pixel with a surface counts as one."""
_PAINTED_FROM = 4
"""Pixels around a hole that its colours come from."""
_LEAST_MEASURED = 12
"""Measured pixels that a view must have, or it adds nothing."""


def initial_gaussians(
    capture: Capture, views: Sequence[View], budget: int, seed: int = 0, known: KnownDepth | None = None
) -> Gaussians:
    """Cover what the views see of the static scene with at most `budget` Gaussians, in the capture's world.

    Where depth, lidar or points are known, each view is completed to dense depth and its cells of some pixels become
    discs along the surface, unless earlier views have covered them; the cells are as small as the budget allows.
    Where nothing is known, Gaussians are spread at random over what the cameras see. The sky is left out.

    Args:
        capture: Whose sweeps, points and boxes tell of the scene.
        views: Those that are trained on, without distortion, in the size of the training (`prepared`).
        budget: Most Gaussians; leave room for those that density control adds.
        seed: Of what is random.
        known: Depth and sky of the views; found here where not given.
    """
    known = known_depth(capture, views) if known is None else known
    moving = moving_boxes(capture)
    unmasked = [view.held() for view in views]
    views = [replace(view, mask_source=static_mask(view, moving)) for view in unmasked]
    if sum(int((depth > 0).sum()) >= _LEAST_MEASURED for depth in known.measured) == 0:
        return _random_gaussians(views, known.skies, budget, seed)
    depths = known.completed
    hidden = [_hidden_by_movers(view, own) for view, own in zip(views, unmasked, strict=True)]
    pixels = sum(view.camera.width * view.camera.height for view in views if view.time_s == views[0].time_s)
    stride = max(int(np.sqrt(pixels / max(budget, 1)) / 2), 1)
    while (surfels := _covering(views, depths, hidden, stride, round((1 - _FOR_HOLES - _FOR_PIECES) * budget))) is None:
        stride += 1
        if stride > max(view.camera.width for view in views):  # not even one for each view
            raise ValueError(f"a budget of {budget} Gaussians is too small for {len(views)} views")
    gaussians = _without_holes(surfels, views, depths, stride, round((1 - _FOR_PIECES) * budget))
    way = camera_way(views, known.usual)
    ground = hidden_ground(gaussians, views, way, capture.up, round(_FOR_GROUND * budget), SURFACE_OPACITY)
    return shortened(Gaussians.concatenate([gaussians, ground]), way, budget)


def _hidden_by_movers(view: View, unmasked: View) -> View | None:
    """The view with what is behind the movers painted in from around them, to be seen there alone; None without any."""
    mask, own = view.mask, unmasked.mask
    assert mask is not None  # it was set to what is static
    hidden = ~mask if own is None else own & ~mask
    if not hidden.any():
        return None
    painted = cv2.inpaint(view.image, hidden.astype(np.uint8), _PAINTED_FROM, cv2.INPAINT_TELEA)
    return replace(view, image_source=np.asarray(painted, np.uint8), mask_source=hidden)


def _covering(
    views: Sequence[View],
    depths: Sequence[Float32[np.ndarray, "_ _"]],
    hidden: Sequence[View | None],
    stride: int,
    budget: int,
) -> Surfels | None:
    """Cover one view after another, in the end what no view shows for movers; None where that exceeds the budget."""
    nothing = np.zeros((0, 3), np.float32)
    all_of_them = Surfels(nothing, np.zeros((0, 2, 3), np.float32), nothing)
    last = [(view, depth) for view, depth in zip(hidden, depths, strict=True) if view is not None]
    for view, depth in [*zip(views, depths, strict=True), *last]:
        mask = view.mask
        free = np.ones(depth.shape, np.bool_) if mask is None else mask
        wanted = (cell_means(free[..., None], stride)[..., 0] > 0.5) & ~_covered(all_of_them, view, depth, stride)
        all_of_them = Surfels.joined([all_of_them, surfels_of_view(view, depth, stride, wanted)])
        if len(all_of_them) > budget:
            return None
    return all_of_them


def _without_holes(
    surfels: Surfels, views: Sequence[View], depths: Sequence[Float32[np.ndarray, "_ _"]], stride: int, budget: int
) -> Gaussians:
    """Draw the discs as each view sees them, and add more where too little is drawn: seams between views, mostly."""
    gaussians, renderer = surfels.gaussians(SURFACE_OPACITY), CpuRenderer()
    for view, depth in zip(views, depths, strict=True):
        mask = view.mask
        renderer.draw([Part(gaussians, np.eye(4))], view.camera)
        empty = (renderer.read().rgba[..., 3] < _HOLE) & (depth > 0)
        empty = empty if mask is None else empty & mask
        more = surfels_of_view(view, depth, stride, cell_means(empty[..., None], stride)[..., 0] > 0.5)
        room = budget - len(gaussians)
        gaussians = Gaussians.concatenate([gaussians, more.gaussians(SURFACE_OPACITY).take(slice(0, max(room, 0)))])
    return gaussians


def _covered(
    surfels: Surfels, view: View, depth: Float32[np.ndarray, "h w"], stride: int
) -> Bool[np.ndarray, "rows columns"]:
    """Which cells of a view have enough Gaussians that are fine enough and not behind its own surface."""
    rows, columns = cells(view.camera, stride)
    index, row, column, z = projected(surfels.means, view.camera)
    size = np.linalg.norm(surfels.axes[index], axis=2).min(axis=1)
    surface = depth[row, column]
    counts = (size * view.camera.fx / z < _COARSER * stride) & ((surface <= 0) | (z < 1.3 * surface))
    flat = (row[counts] // stride) * columns + column[counts] // stride
    density = np.bincount(flat, minlength=rows * columns).reshape(rows, columns).astype(np.float32)
    return uniform_filter(np.minimum(density, 2.0), 3, mode="nearest") >= np.float32(_COVERED - 1e-3)


def _random_gaussians(
    views: Sequence[View], skies: Sequence[Bool[np.ndarray, "_ _"]], budget: int, seed: int
) -> Gaussians:
    """Spread Gaussians over what the cameras see, evenly in inverse distance from a length that their spread tells."""
    random = np.random.default_rng(seed)
    eyes = np.array([view.camera.position for view in views])
    spread = float(np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max())
    near = 0.5 * spread if spread > 0 else 1.0
    share = -(-budget // len(views))
    places: list[Float64[np.ndarray, "m 3"]] = []
    for view, sky in zip(views, skies, strict=True):
        choice = np.flatnonzero(~sky if view.mask is None else ~sky & view.mask)
        if len(choice):
            at = random.choice(choice, share)
            distance = near / random.uniform(1 / 50, 1, share)
            rays = pixel_rays(view.camera).reshape(-1, 3)[at]
            places.append(view.camera.position + rays * distance[:, None])
    if not places:
        return Gaussians.empty()
    points = np.concatenate(places)[:budget]
    colors, _ = point_colors(points, views, [np.zeros_like(sky, np.float32) for sky in skies])
    return round_gaussians(points, colors, RANDOM_OPACITY)


def round_gaussians(
    points: Float64[np.ndarray, "n 3"], colors: Float32[np.ndarray, "n 3"], opacity: float
) -> Gaussians:
    """Spheres as large as the mean distance to the three nearest others (Kerbl et al. 2023), outliers clipped."""
    n = len(points)
    sizes = np.ones(n)
    if n > 1:
        distances = KDTree(points).query(points, min(4, n))[0][:, 1:]
        sizes = np.sqrt((distances**2).mean(axis=1))
        sizes = np.clip(sizes, max(float(np.quantile(sizes, 0.02)), 1e-6), max(float(np.quantile(sizes, 0.98)), 1e-6))
    return Gaussians(
        points.astype(np.float32),
        np.repeat(sizes[:, None], 3, axis=1).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.full(n, opacity, np.float32),
        sh_from_color(colors),
    )

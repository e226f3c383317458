"""Initialization of Gaussians from lidar, depth or points: static surfaces, road, sky dome and actors."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.ndimage import uniform_filter
from scipy.spatial import KDTree

from ..datasets.capture import Capture, CaptureFrame, TrackedBox
from ..datasets.depth_maps import DepthPriors, camera_height_above_road, completed_depth, depth_priors
from ..datasets.geometry import lidar_depth
from ..datasets.masks import box_outline, can_move, is_moving, moving_boxes, pixel_rays, points_in_box, static_mask
from ..render.cpu.renderer import CpuRenderer
from ..scene.gaussians import Gaussians, sh_from_color
from ..scene.geometry import quaternions_from_matrices
from ..scene.scene import Actor, DrawItem
from ..scene.sky_dome import dome_directions, dome_gaussians, dome_radius
from .surfels import Surfels, camera_trajectory, cell_means, point_colors, projected, split_long_gaussians, view_surfels

Depths = Sequence[Float32[np.ndarray, "_ _"]]
Points = Float64[np.ndarray, "n 3"]
Skies = Sequence[Bool[np.ndarray, "_ _"]]
Trajectory = Float64[np.ndarray, "p 3"]

SURFACE_OPACITY = 0.85  # of Gaussians with known positions: together they are opaque, and gradients still pass
RANDOM_OPACITY = 0.1  # of Gaussians with random positions, as in 3DGS (Kerbl et al. 2023)
_COVERED = 6 / 9  # gaussians per cell, averaged over 3x3 cells, that count as full coverage
_COARSER = 1.7  # size of the existing Gaussians over the cell size from which a nearer view adds its own
_FOR_HOLES = 0.1  # share of the budget reserved for holes
_FOR_GROUND, _FOR_PIECES = 0.05, 0.2
"""Shares of the budget reserved for the road under the ego, and for it together with splitting long Gaussians."""

_HOLE = 0.5  # alpha below which a pixel with a surface counts as a hole
_PAINTED_FROM = 4  # inpainting radius in pixels
_MIN_MEASURED = 12  # measured pixels required in at least one view; otherwise initialization is random


def initial_gaussians(
    capture: Capture, views: Sequence[CaptureFrame], budget: int, seed: int = 0, known: DepthPriors | None = None
) -> Gaussians:
    """Cover the static scene in the views with at most `budget` Gaussians, in the capture's world.

    With depth, lidar or points, each view (undistorted and at training size, `training_views`) is completed to dense
    depth, and its cells of some pixels become discs along the surface unless earlier views cover them; cells are as
    small as the budget allows. Otherwise Gaussians are spread at random in the view frustums, by `seed`. The sky is
    excluded. The budget leaves room for density control; `known` depth and sky are computed if None.
    """
    known = depth_priors(capture, views) if known is None else known
    moving = moving_boxes(capture)
    unmasked = [view.held() for view in views]
    views = [replace(view, mask_source=static_mask(view, moving)) for view in unmasked]
    if not any(np.count_nonzero(depth > 0) >= _MIN_MEASURED for depth in known.measured):
        return _random_gaussians(views, known.skies, budget, seed)
    depths = known.completed
    hidden: list[CaptureFrame] = []  # behind movers, inpainted from around them
    hidden_depths: list[Float32[np.ndarray, "_ _"]] = []
    for view, own, depth in zip(views, (each.mask for each in unmasked), depths, strict=True):
        assert view.mask is not None  # the static mask
        behind = ~view.mask if own is None else own & ~view.mask
        if behind.any():
            painted = cv2.inpaint(view.image, behind.astype(np.uint8), _PAINTED_FROM, cv2.INPAINT_TELEA)
            hidden.append(replace(view, image_source=np.asarray(painted, np.uint8), mask_source=behind))
            hidden_depths.append(depth)
    every, every_depth = [*views, *hidden], [*depths, *hidden_depths]
    pixels = sum(view.camera.width * view.camera.height for view in views if view.time_s == views[0].time_s)
    stride = max(int(np.sqrt(pixels / max(budget, 1)) / 2), 1)
    while (surfels := _covering(every, every_depth, stride, round((1 - _FOR_HOLES - _FOR_PIECES) * budget))) is None:
        stride += 1
        if stride > max(view.camera.width for view in views):  # not even one per view
            raise ValueError(f"a budget of {budget} Gaussians is too small for {len(views)} views")
    gaussians = _without_holes(surfels, views, depths, stride, round((1 - _FOR_PIECES) * budget))
    trajectory = camera_trajectory(views, known.median_depth)
    ground = inpaint_road(gaussians, views, trajectory, capture.up, round(_FOR_GROUND * budget), SURFACE_OPACITY)
    return split_long_gaussians(Gaussians.concatenate([gaussians, ground]), trajectory, budget)


def _covering(views: Sequence[CaptureFrame], depths: Depths, stride: int, budget: int) -> Surfels | None:
    """Cover one view after another; None if that exceeds the budget."""
    nothing = np.zeros((0, 3), np.float32)
    surfels = Surfels(nothing, np.zeros((0, 2, 3), np.float32), nothing)
    for view, depth in zip(views, depths, strict=True):
        free = np.ones(depth.shape, np.bool_) if view.mask is None else view.mask
        cells = (cell_means(free[..., None], stride)[..., 0] > 0.5) & ~_covered(surfels, view, depth, stride)
        surfels = Surfels.joined([surfels, view_surfels(view, depth, stride, cells)])
        if len(surfels) > budget:
            return None
    return surfels


def _without_holes(
    surfels: Surfels, views: Sequence[CaptureFrame], depths: Depths, stride: int, budget: int
) -> Gaussians:
    """Render the discs in each view and add more where alpha is too low, mostly at seams between views."""
    gaussians, renderer = surfels.gaussians(SURFACE_OPACITY), CpuRenderer()
    for view, depth in zip(views, depths, strict=True):
        renderer.draw([DrawItem(gaussians, np.eye(4))], view.camera)
        empty = (renderer.read().rgba[..., 3] < _HOLE) & (depth > 0)
        empty = empty if view.mask is None else empty & view.mask
        more = view_surfels(view, depth, stride, cell_means(empty[..., None], stride)[..., 0] > 0.5)
        room = budget - len(gaussians)
        gaussians = Gaussians.concatenate([gaussians, more.gaussians(SURFACE_OPACITY).take(slice(0, max(room, 0)))])
    return gaussians


def _covered(
    surfels: Surfels, view: CaptureFrame, depth: Float32[np.ndarray, "h w"], stride: int
) -> Bool[np.ndarray, "rows columns"]:
    """Mask of a view's cells with enough Gaussians that are fine enough and not behind the view's surface."""
    rows, columns = -(-view.camera.height // stride), -(-view.camera.width // stride)
    index, row, column, z = projected(surfels.means, view.camera)
    size = np.linalg.norm(surfels.axes[index], axis=2).min(axis=1)
    surface = depth[row, column]
    counts = (size * view.camera.fx / z < _COARSER * stride) & ((surface <= 0) | (z < 1.3 * surface))
    flat = (row[counts] // stride) * columns + column[counts] // stride
    density = np.bincount(flat, minlength=rows * columns).reshape(rows, columns).astype(np.float32)
    return uniform_filter(np.minimum(density, 2.0), 3, mode="nearest") >= np.float32(_COVERED - 1e-3)


def _random_gaussians(views: Sequence[CaptureFrame], skies: Skies, budget: int, seed: int) -> Gaussians:
    """Spread Gaussians over the frustums, uniformly in inverse distance from a distance set by the camera spread."""
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


def round_gaussians(points: Points, colors: Float32[np.ndarray, "n 3"], opacity: float) -> Gaussians:
    """Spheres sized by the mean distance to the three nearest neighbors (Kerbl et al. 2023), outliers clipped."""
    n = len(points)
    sizes = np.ones(n)
    if n > 1:
        distances = KDTree(points).query(points, min(4, n))[0][:, 1:]
        sizes = np.sqrt((distances**2).mean(axis=1))
        sizes = np.clip(sizes, max(float(np.quantile(sizes, 0.02)), 1e-6), max(float(np.quantile(sizes, 0.98)), 1e-6))
    scales = np.repeat(sizes[:, None], 3, axis=1).astype(np.float32)
    upright = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    opacities = np.full(n, opacity, np.float32)
    return Gaussians(points.astype(np.float32), scales, upright, opacities, sh_from_color(colors))


# Road under the ego
# The ego's own body occludes this road in every image.

_REACH = 3.5  # radius around the cameras over their height above the road: about a car's length
_FLAT = 0.25  # largest height difference from the road over the cameras' height
_SPACING, _COARSEST = 0.06, 0.25  # spacing of new discs over the cameras' height: about 9 cm, at most 40 cm
_SIGMA, _THICKNESS = 0.7, 0.05  # sigma of a disc along and across the road, over the spacing
_COVERS = 2.0  # radius in standard deviations that a disc covers
_NEIGHBORS = 12
_MIN_ROAD = 100


def inpaint_road(
    surface: Gaussians,
    views: Sequence[CaptureFrame],
    trajectory: Trajectory,
    up: tuple[float, float, float],
    max_count: int,
    opacity: float,
) -> Gaussians:
    """Discs that fill holes in the road under and around the cameras, with the height and color of nearby road.

    The low, flat part of `surface`, in the capture's world, is the road; the cameras of the views drove on it, along
    `trajectory` (`camera_trajectory`). Spacing grows to at most `max_count` discs, up to a limit beyond which none are
    added. Empty if no road is found under the cameras.
    """
    frame = _frame(up)
    drop = camera_height_above_road(surface.means.astype(np.float64), views, up) if len(surface) else None
    if drop is None:
        return surface.take(slice(0, 0))
    trajectory = trajectory @ frame.T
    places = surface.means.astype(np.float64) @ frame.T
    distance, nearest = KDTree(trajectory[:, :2]).query(places[:, :2])
    is_road = (distance < 3 * _REACH * drop) & (np.abs(trajectory[nearest, 2] - drop - places[:, 2]) < _FLAT * drop)
    road = surface.take(np.flatnonzero(is_road))
    if len(road) < _MIN_ROAD:
        return surface.take(slice(0, 0))
    known = places[is_road]
    tree = KDTree(known[:, :2])
    covered = np.sqrt(np.sort(road.scales, axis=1)[:, 1:].prod(axis=1)) * _COVERS
    spacing, coarsest = _SPACING * drop, _COARSEST * drop
    path = trajectory[:, :2]
    while len(holes := _holes(path, spacing, _REACH * drop, tree, covered)) > max_count and spacing < coarsest:
        spacing *= 1.3
    if not 0 < len(holes) <= max_count:
        return surface.take(slice(0, 0))
    apart, neighbours = tree.query(holes, _NEIGHBORS)
    weight = 1 / np.maximum(apart, spacing) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    heights = (weight * known[neighbours, 2]).sum(axis=1)
    turn = quaternions_from_matrices(frame.T * [1, 1, np.sign(np.linalg.det(frame))])
    return Gaussians(
        (np.column_stack([holes, heights]) @ frame).astype(np.float32),
        np.tile((np.array([_SIGMA, _SIGMA, _THICKNESS]) * spacing).astype(np.float32), (len(holes), 1)),
        np.tile(turn.astype(np.float32), (len(holes), 1)),
        np.full(len(holes), opacity, np.float32),
        np.einsum("nm,nmkc->nkc", weight, road.sh[neighbours]).astype(np.float32),
    )


def _frame(up: tuple[float, float, float]) -> Float64[np.ndarray, "3 3"]:
    """Rows: two horizontal directions and the upward one."""
    axis = np.array(up, np.float64) / np.linalg.norm(up)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis])


def _holes(
    trajectory: Float64[np.ndarray, "p 2"],
    spacing: float,
    reach: float,
    road: KDTree,
    covered: Float32[np.ndarray, " r"],
) -> Float64[np.ndarray, "h 2"]:
    """Grid positions near the trajectory that no road Gaussian covers."""
    low, high = trajectory.min(axis=0) - reach, trajectory.max(axis=0) + reach
    axes = [np.arange(low[k], high[k], spacing) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    grid = grid[np.isfinite(KDTree(trajectory).query(grid, distance_upper_bound=reach)[0])]
    apart, nearest = road.query(grid)
    return grid[apart > np.maximum(covered[nearest], spacing)]


# Sky dome

SKY_GAUSSIANS = 8000  # on the upper half of the dome they are 1.6 degrees apart: fine enough for clouds, not for leaves
_LOWEST = float(np.sin(np.radians(-3.0)))  # the dome reaches slightly below the horizon, since streets end before it
_SAMPLES = 3  # side in pixels of the window averaged for one direction's color in one view


def initial_sky(
    capture: Capture, views: Sequence[CaptureFrame], surface: Gaussians, skies: Skies, count: int = SKY_GAUSSIANS
) -> Gaussians:
    """Make a dome of about `count` Gaussians around the scene; empty if no view shows sky.

    A direction visible as sky has the median color of its views; others interpolate the known ones, more smoothly with
    distance, so that views upward or backward also show sky. `surface` is the scene under the dome, in the capture's
    world; `skies` are the sky pixels of the undistorted views.
    """
    if not any(sky.any() for sky in skies):
        return Gaussians.empty()
    center = np.mean([view.camera.position for view in views], axis=0)
    radius = dome_radius(surface, center, capture.is_metric)
    directions = dome_directions(count, _LOWEST) @ _frame(capture.up)
    colors = _colors(directions, center + radius * directions, views, skies)
    return dome_gaussians(directions, colors, center, radius, _LOWEST)


def _colors(
    directions: Points, places: Points, views: Sequence[CaptureFrame], skies: Skies
) -> Float32[np.ndarray, "n 3"]:
    """Median over the views that show a direction's sky; elsewhere an inverse-distance-weighted mean of known ones."""
    samples: list[list[np.ndarray]] = [[] for _ in directions]
    reach = range(-(_SAMPLES // 2), _SAMPLES // 2 + 1)
    for view, sky in zip(views, skies, strict=True):
        index, row, column, _ = projected(places, view.camera)
        image, weight, total = view.image, np.zeros(len(index)), np.zeros((len(index), 3))
        for down in reach:
            for right in reach:
                r = np.clip(row + down, 0, sky.shape[0] - 1)
                c = np.clip(column + right, 0, sky.shape[1] - 1)
                weight += sky[r, c]
                total += sky[r, c, None] * image[r, c]
        for k in np.flatnonzero(weight >= _SAMPLES**2 / 2):
            samples[index[k]].append(total[k] / weight[k])
    known = np.array([bool(each) for each in samples])
    colors = np.zeros((len(directions), 3), np.float32)
    if not known.any():  # only specks of sky between the sampled directions
        all_sky = np.concatenate([view.image[sky] for view, sky in zip(views, skies, strict=True)])
        return np.broadcast_to(np.median(all_sky, axis=0).astype(np.float32) / 255, colors.shape).copy()
    colors[known] = [np.median(each, axis=0) / 255 for each in samples if each]
    if not known.all():
        found = KDTree(directions[known]).query(directions[~known], min(64, int(known.sum())))
        distance, index = (each.reshape(int((~known).sum()), -1) for each in found)
        weight = 1 / np.maximum(distance, 1e-6) ** 2
        colors[~known] = (weight[..., None] * colors[known][index]).sum(axis=1) / weight.sum(axis=1)[:, None]
    return colors


# Actors from lidar

MIN_POINTS = 60  # lidar points that an actor needs; fewer do not define a shape
_MARGIN_M = 0.1
_LIFT_M = 0.12  # points lower than this in the box may belong to the road
_MIN_SPACING_M = 0.04
_MAX_VIEWS = 24


def actor_layers(capture: Capture, views: Sequence[CaptureFrame]) -> tuple[Actor, ...]:
    """Make an actor of each moving vehicle or person with enough lidar points, on the track of its box.

    Points of all sweeps are accumulated in the actor's frame and mirrored at its plane of symmetry, since one side is
    seldom visible. Colors come from the views (undistorted) that show it, at their times. Without sweeps or boxes there
    are no actors.
    """
    actors: list[Actor] = []
    for box in capture.boxes:
        if not (can_move(box) and is_moving(box)):
            continue
        points = points_of_box(capture, box)
        if len(points) < MIN_POINTS:
            continue
        partner = np.arange(2 * len(points)) - len(points)  # below 0 for the points that are not mirror images
        points = np.concatenate([points, points * [1, -1, 1]])
        colors, visible = _actor_colors(capture, box, points, views)
        if not visible.any():
            continue
        borrowed = ~visible & (partner >= 0)  # hidden points take the color of their mirror image
        colors[borrowed] = colors[partner[borrowed]]
        known = visible | (borrowed & visible[partner])
        colors[~known] = np.median(colors[known], axis=0)
        gaussians = round_gaussians(points, colors, SURFACE_OPACITY)
        actors.append(
            Actor(id=box.id, class_name=box.class_name, size_lwh=box.size_lwh, gaussians=gaussians, track=box.track)
        )
    return tuple(actors)


def points_of_box(capture: Capture, box: TrackedBox) -> Float64[np.ndarray, "p 3"]:
    """Thinned lidar points in a box's frame (x forward, y left, z up, origin at the bottom center)."""
    found = [np.zeros((0, 3))]
    for sweep in capture.sweeps:
        pose = box.track.pose(sweep.time_s)
        if pose is not None:
            points = sweep.points_m.astype(np.float64)
            local = (points[points_in_box(points, box, sweep.time_s, _MARGIN_M)] - pose[:3, 3]) @ pose[:3, :3]
            found.append(local[local[:, 2] > _LIFT_M])
    points = np.concatenate(found)
    _, first = np.unique(np.floor(points / _MIN_SPACING_M).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def _actor_colors(
    capture: Capture, box: TrackedBox, points: Float64[np.ndarray, "p 3"], views: Sequence[CaptureFrame]
) -> tuple[Float32[np.ndarray, "p 3"], Bool[np.ndarray, " p"]]:
    """Colors from the views that show the box, each transformed to the box's frame at its time."""
    own: list[CaptureFrame] = []
    depths: list[Float32[np.ndarray, "_ _"]] = []
    showing = [view for view in views if len(box_outline(view, box))]
    showing.sort(key=lambda view: float(np.linalg.norm(_pose(box, view)[:3, 3] - view.camera.position)))
    for view in showing[:_MAX_VIEWS]:
        nearest = min(capture.sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s))
        own.append(replace(view, camera=view.camera.moved(np.linalg.inv(_pose(box, view))), mask_source=None))
        depths.append(completed_depth(lidar_depth(view, [nearest])))
    if not own:
        return np.full((len(points), 3), 0.5, np.float32), np.zeros(len(points), np.bool_)
    return point_colors(points, own, depths)


def _pose(box: TrackedBox, view: CaptureFrame) -> Float64[np.ndarray, "4 4"]:
    pose = box.track.pose(view.time_s)
    assert pose is not None  # callers pass only views that show the box
    return pose

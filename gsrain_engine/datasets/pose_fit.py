"""Fit of poses to feature matches between two views, and to edges in lidar depth."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from ..scene.camera import Camera
from .capture import CaptureFrame, LidarSweep
from .geometry import Pose, intrinsics, pixels_inside, project_points
from .undistort import undistort_frame

MATCH_WIDTH_PX = 800
"""Image width for features; errors are in pixels of it."""

WITHIN_PX = 2.0
"""Maximum epipolar distance of matches explained by the poses."""

_FEATURES = 3000
_RATIO = 0.75
_AGREE_PX = 1.0
_STILL_PX = 2.0
_FEWEST = 40
_PARALLAX_RAD = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMatches:
    """Features shared by two images of a moving camera and consistent with some two-view geometry."""

    first: Float64[np.ndarray, "m 2"]
    """Pixels of the prepared images, first center at (0.5, 0.5)."""
    second: Float64[np.ndarray, "m 2"]
    cameras: tuple[Camera, Camera]
    """Cameras without distortion, `MATCH_WIDTH_PX` wide, with the given poses."""


@dataclass(frozen=True, slots=True)
class EpipolarFit:
    """Fit of two poses to matches."""

    median_px: float
    """Median distance to the epipolar lines."""
    explained: float
    """Share of matches within `WITHIN_PX` of their lines and in front of both cameras."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageFeatures:
    """SIFT features of an image."""

    view: CaptureFrame
    """View without distortion, `MATCH_WIDTH_PX` wide."""
    pixels: Float64[np.ndarray, "f 2"]
    """First center at (0.5, 0.5)."""
    described: Float32[np.ndarray, "f 128"]


def find_features(view: CaptureFrame) -> ImageFeatures:
    """Prepare a view and find its SIFT features. Raises `CaptureError` if its image can't be read."""
    straight = undistort_frame(view, min(MATCH_WIDTH_PX, view.camera.width))
    mask = straight.mask
    grey = cv2.cvtColor(straight.image, cv2.COLOR_RGB2GRAY)
    usable = None if mask is None else mask.astype(np.uint8)
    described: Any
    points, described = cv2.SIFT.create(nfeatures=_FEATURES).detectAndCompute(grey, usable)
    pixels = np.array([point.pt for point in points], np.float64).reshape(-1, 2) + 0.5
    return ImageFeatures(straight, pixels, np.zeros((0, 128), np.float32) if described is None else described)


def match_features(first: ImageFeatures, second: ImageFeatures) -> FeatureMatches | None:
    """Match two views' features; None if too few agree, or none moved.

    Excludes features that are static in the image, such as the car's own hood.
    """
    pairs = _pairs(first.described, second.described)
    a, b = first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]]
    moved = np.linalg.norm(a - b, axis=1) > _STILL_PX
    a, b = a[moved], b[moved]
    if len(a) < _FEWEST:
        return None
    agree: Any = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, _AGREE_PX, 0.999, 5000)[1]
    kept = np.zeros(len(a), np.bool_) if agree is None else agree.ravel() > 0
    if np.count_nonzero(kept) < _FEWEST:
        return None
    return FeatureMatches(a[kept], b[kept], (first.view.camera, second.view.camera))


def epipolar_fit(found: FeatureMatches, poses: tuple[Pose, Pose]) -> EpipolarFit:
    """Fit of world-to-camera poses to the matches (symmetric epipolar distance; Hartley and Zisserman, 11.4)."""
    relative = poses[1] @ np.linalg.inv(poses[0])
    turn, shift = relative[:3, :3], relative[:3, 3]
    rays = [_rays(pixels, camera) for pixels, camera in zip((found.first, found.second), found.cameras, strict=True)]
    essential = np.cross(np.eye(3), shift) @ turn
    k1, k2 = (np.linalg.inv(intrinsics(camera)) for camera in found.cameras)
    fundamental = k2.T @ essential @ k1
    a, b = (np.column_stack([pixels, np.ones(len(pixels))]) for pixels in (found.first, found.second))
    line_b, line_a = a @ fundamental.T, b @ fundamental
    off = np.abs(np.sum(b * line_b, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = off * (1 / np.linalg.norm(line_b[:, :2], axis=1) + 1 / np.linalg.norm(line_a[:, :2], axis=1)) / 2
    distances = np.where(np.isfinite(distances), distances, np.inf)
    in_front = _in_front(rays[0], rays[1], turn, shift)
    explained = float(np.mean((distances < WITHIN_PX) & in_front))
    return EpipolarFit(float(np.median(distances)), explained)


def _in_front(
    first: Float64[np.ndarray, "m 3"],
    second: Float64[np.ndarray, "m 3"],
    turn: Float64[np.ndarray, "3 3"],
    shift: Float64[np.ndarray, "3"],
) -> Bool[np.ndarray, " m"]:
    """Mask of rays whose nearest points are in front of both cameras; True if the rays are nearly parallel."""
    turned = first @ turn.T
    cosine = np.sum(turned * second, axis=1)
    along_first, along_second = turned @ shift, second @ shift
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    depth_first = (cosine * along_second - along_first) / sine2
    depth_second = (along_second - cosine * along_first) / sine2
    return ((depth_first > 0) & (depth_second > 0)) | (sine2 < _PARALLAX_RAD**2)


def _rays(pixels: Float64[np.ndarray, "m 2"], camera: Camera) -> Float64[np.ndarray, "m 3"]:
    rays = np.column_stack([(pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixels))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _pairs(first: Float32[np.ndarray, "f 128"], second: Float32[np.ndarray, "g 128"]) -> Int64[np.ndarray, "m 2"]:
    """Rows of mutual nearest features, clearly nearer than the second best (Lowe, 2004)."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.int64)
    forth = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
    back = {match.queryIdx: match.trainIdx for match in cv2.BFMatcher(cv2.NORM_L2).match(second, first)}
    kept = [
        (best.queryIdx, best.trainIdx)
        for best, next_best in forth
        if best.distance < _RATIO * next_best.distance and back.get(best.trainIdx) == best.queryIdx
    ]
    return np.array(kept, np.int64).reshape(-1, 2)


# Lidar edges against image edges (after Levinson and Thrun 2013)

EDGE_WIDTH_PX = 640
"""Image width: far edges of a lidar with 32 beams are no finer."""

_CELL_DEG = (0.4, 1.4)
_JUMP_PART, _JUMP_M = 0.1, 0.5
_OWN_CAR_M = 2.0
_BLUR_PX, _AROUND_PX, _CLEAREST = 1.5, 81, 6.0
_TURNS_DEG = (-6.0, -4.0, -2.5, 2.5, 4.0, 6.0)
_FEWEST_POINTS = 40


@dataclass(frozen=True, slots=True, eq=False)
class EdgeImage:
    """Edges of an image."""

    view: CaptureFrame
    """View without distortion, `EDGE_WIDTH_PX` wide."""
    clearness: Float32[np.ndarray, "h w"]
    """Color gradient relative to its surroundings, so that steep textures such as leaves don't count as edges."""


def edge_image(view: CaptureFrame) -> EdgeImage:
    """Find a view's vertical edges. Raises `CaptureError` if its image can't be read."""
    straight = undistort_frame(view, min(EDGE_WIDTH_PX, view.camera.width)).held()
    lab = cv2.cvtColor(straight.image, cv2.COLOR_RGB2LAB).astype(np.float32)
    steep = cv2.Sobel(cv2.GaussianBlur(lab, (0, 0), _BLUR_PX), cv2.CV_32F, 1, 0, ksize=3)
    steep = cv2.dilate(np.linalg.norm(steep, axis=2), np.ones((3, 5)))
    around = cv2.blur(steep, (_AROUND_PX, _AROUND_PX)) + 2.0
    return EdgeImage(straight, np.minimum(steep / around, _CLEAREST).astype(np.float32))


def depth_edges(sweep: LidarSweep) -> Float64[np.ndarray, "e 3"]:
    """Points of a sweep (world) at depth edges: next to a much farther surface or the sky, seen from the lidar."""
    rays = sweep.points_m.astype(np.float64) - sweep.origin_m
    ranges = np.linalg.norm(rays, axis=1)
    kept = ranges > _OWN_CAR_M
    points, rays, ranges = sweep.points_m[kept], rays[kept], ranges[kept]
    across = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    up = np.degrees(np.arcsin(np.clip(rays[:, 2] / ranges, -1, 1)))
    columns, rows = round(360 / _CELL_DEG[0]), round(180 / _CELL_DEG[1])
    column = ((across + 180) / 360 * columns).astype(np.int64) % columns
    row = np.clip(((up + 90) / 180 * rows).astype(np.int64), 0, rows - 1)
    order = np.argsort(-ranges)  # the nearest point of a cell is written last
    cells = np.full((rows, columns), -1, np.int64)
    cells[row[order], column[order]] = order
    image = np.full(cells.shape, np.nan)
    image[cells >= 0] = ranges[cells[cells >= 0]]
    edge = np.zeros(image.shape, np.bool_)
    for side in (-1, 1):
        beside = [np.roll(image, side * step, axis=1) for step in (1, 2, 3, 4)]
        farther = image * (1 + _JUMP_PART) + _JUMP_M
        edge |= (beside[0] > farther) & ~(beside[1] < farther)  # a single far point is not an edge
        edge |= np.isnan(beside).all(axis=0)
    return points[cells[edge & (cells >= 0)]].astype(np.float64)


def _met(edges: EdgeImage, points: Float64[np.ndarray, "e 3"], camera: Camera) -> tuple[float, int]:
    """Mean edge strength of the image at the points projected by a camera, and the number of points inside."""
    pixels, _ = project_points(points, camera)
    rows, columns, inside = pixels_inside(pixels, edges.clearness.shape)
    count = int(np.count_nonzero(inside))
    return (float(edges.clearness[rows[inside], columns[inside]].mean()) if count else 0.0), count


def lidar_edge_fit(edges: EdgeImage, points: Float64[np.ndarray, "e 3"], camera: Camera) -> float:
    """Fit of a pose above those of rotated poses, in standard deviations; NaN with too few points in the image.

    A correct pose reaches 2 to 8, a wrong one 0 on average and rarely more than 2.
    """
    own, count = _met(edges, points, camera)
    if count < _FEWEST_POINTS:
        return float("nan")
    others = [_met(edges, points, each)[0] for each in _turned(camera)]
    spread = float(np.std(others))
    return (own - float(np.mean(others))) / spread if spread > 0 else 0.0


def _turned(camera: Camera) -> list[Camera]:
    """The camera rotated left and right, each also combined with up and down."""
    cameras: list[Camera] = []
    for yaw in _TURNS_DEG:
        for pitch in (0.0, -yaw / 2, yaw / 2):
            turn, _ = cv2.Rodrigues(np.radians([pitch, yaw, 0.0]))
            matrix = np.eye(4)
            matrix[:3, :3] = turn
            cameras.append(replace(camera, world_to_camera=matrix @ camera.world_to_camera))
    return cameras

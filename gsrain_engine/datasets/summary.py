"""Statistics of a capture, computed without reading its images, and overlays of points and boxes."""

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..scene.camera import Camera
from .capture import Capture, CaptureFrame, TrackedBox
from .geometry import lidar_depth, nearest_sweep, point_depth
from .undistort import undistort_frame


@dataclass(frozen=True, slots=True)
class SensorSummary:
    """One camera of a capture, from its first view."""

    name: str
    views: int
    width: int
    height: int
    focal_px: tuple[float, float]
    horizontal_fov_deg: float
    """Angle from the left edge to the right one, without distortion."""
    lens: str
    """OpenCV's model and its coefficients; empty without distortion."""
    exposure_ms: float
    largest_px: tuple[int, int]
    """Width and height of its largest image; `width` and `height` are those of its first."""
    smallest_px: tuple[int, int]
    """Width and height of its smallest image."""
    sizes: int
    """Number of different image sizes."""


@dataclass(frozen=True, slots=True)
class CaptureSummary:
    """Contents of a capture."""

    name: str
    sensors: tuple[SensorSummary, ...]
    views: int
    seconds: float
    """Time from the first view to the last."""
    minimum: tuple[float, float, float]
    """Corner of the box around all camera positions, in the world (meters if metric)."""
    maximum: tuple[float, float, float]
    course: float
    """Path length of the ego, otherwise of the camera with the longest path, in meters if metric."""
    points: int
    sweeps: int
    lidar_points: int
    boxes: dict[str, int]
    """Number of annotated objects of each class."""
    has: tuple[str, ...]
    """Optional arrays of every view."""
    attributes: dict[str, dict[str, int]]
    """Number of views with each value of each attribute, such as the weather."""
    is_metric: bool
    has_poses: bool
    up: tuple[float, float, float]
    problems: tuple[str, ...]


def summarized(capture: Capture) -> CaptureSummary:
    """Compute the statistics of a capture."""
    places = np.stack([view.camera.position for view in capture]) if len(capture) else np.zeros((1, 3))
    low, high = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    times = [view.time_s for view in capture]
    own = [[view for view in capture if view.sensor == sensor] for sensor in capture.sensors]
    courses = [_length(np.stack([view.camera.position for view in views])) for views in own]
    attributes: dict[str, Counter[str]] = {}
    for view in capture:
        for key, value in view.attributes.items():
            attributes.setdefault(key, Counter())[value] += 1
    return CaptureSummary(
        capture.name,
        tuple(_sensor(views) for views in own),
        len(capture),
        max(times) - min(times) if times else 0.0,
        (low[0], low[1], low[2]),
        (high[0], high[1], high[2]),
        _length(capture.ego.positions) if capture.ego is not None else max(courses, default=0.0),
        0 if capture.points_m is None else len(capture.points_m),
        len(capture.sweeps),
        sum(len(sweep.points_m) for sweep in capture.sweeps),
        dict(Counter(box.class_name for box in capture.boxes).most_common()),
        tuple(sorted(capture.has)),
        {key: dict(counted.most_common()) for key, counted in attributes.items()},
        capture.is_metric,
        capture.has_poses,
        capture.up,
        capture.problems,
    )


def _sensor(views: list[CaptureFrame]) -> SensorSummary:
    view = views[0]
    camera = view.camera
    edges = np.arctan([camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx])
    shown = "" if view.lens is None else ", ".join(f"{value:.3g}" for value in view.lens.coefficients)
    sizes = sorted(
        {(each.camera.width, each.camera.height) for each in views}, key=lambda size: (size[0] * size[1], size)
    )
    return SensorSummary(
        view.sensor,
        len(views),
        camera.width,
        camera.height,
        (camera.fx, camera.fy),
        float(np.degrees(edges.sum())),
        "" if view.lens is None else f"{view.lens.model} ({shown})",
        camera.exposure_s * 1e3,
        sizes[-1],
        sizes[0],
        len(sizes),
    )


def _length(places: Float64[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


# Overlays

_NEAREST_PART, _FARTHEST_PART = 0.02, 0.98
_BLUE = 28  # start of the color scale, for the farthest points: lower values are nearly black
_NEAR_PLANE = 0.05
_BOX_COLOR, _FRONT_COLOR = (255, 255, 255), (255, 60, 60)
_CAPTION_PX, _GAP_PX = 22, 4


def overlay(capture: Capture, view: CaptureFrame, width: int = 960) -> UInt8[np.ndarray, "h w 3"]:
    """One undistorted view with the points visible in it (near red, far blue) and the boxes of its time.

    Points are those of the lidar sweep nearest in time, otherwise the capture's own.
    """
    straight = undistort_frame(view, width)
    picture = np.ascontiguousarray(straight.image)
    sweep = nearest_sweep(view, capture.sweeps)
    if sweep is None:
        depth = point_depth(straight, np.zeros((0, 3)) if capture.points_m is None else capture.points_m)
    else:
        depth = lidar_depth(straight, [sweep])
    _draw_points(picture, depth)
    for box in capture.boxes:
        _draw_box(picture, straight.camera, box, view.time_s)
    return picture


def contact_sheet(capture: Capture, at_most: int = 12, tile_width: int = 640) -> UInt8[np.ndarray, "h w 3"]:
    """Grid of overlays with their names: with several cameras, one moment of each."""
    views = chosen_views(capture, at_most)
    columns = min(3, len(views)) if len(views) != 4 else 2
    tiles = [_captioned(overlay(capture, view, tile_width), view.name) for view in views]
    height = max(tile.shape[0] for tile in tiles)
    tiles = [cv2.copyMakeBorder(t, 0, height - t.shape[0], 0, 0, cv2.BORDER_CONSTANT) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    gap = np.zeros((height, _GAP_PX, 3), np.uint8)
    rows = [
        np.concatenate([part for tile in tiles[start : start + columns] for part in (tile, gap)][:-1], axis=1)
        for start in range(0, len(tiles), columns)
    ]
    return np.asarray(np.concatenate(rows), np.uint8)


def chosen_views(capture: Capture, at_most: int) -> list[CaptureFrame]:
    """Representative views: equally many of each camera, spread evenly over the drive."""
    each = max(at_most // len(capture.sensors), 1)
    chosen: list[CaptureFrame] = []
    for sensor in capture.sensors:
        taken = [view for view in capture if view.sensor == sensor]
        places = np.linspace(0, len(taken) - 1, min(each, len(taken))) if each > 1 else np.array([len(taken) // 2])
        chosen += [taken[round(k)] for k in np.unique(np.round(places))]
    return chosen[:at_most]


def _draw_points(picture: UInt8[np.ndarray, "h w 3"], depth: Float32[np.ndarray, "h w"]) -> None:
    rows, columns = np.nonzero(depth)
    if not len(rows):
        return
    logs = np.log(depth[rows, columns])
    low, high = np.quantile(logs, [_NEAREST_PART, _FARTHEST_PART])
    shade = np.clip(_BLUE + (255 - _BLUE) * (1 - (logs - low) / max(high - low, 1e-9)), _BLUE, 255).astype(np.uint8)
    colors = cv2.applyColorMap(shade[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    radius = max(round(depth.shape[1] / 900), 1)
    for k in np.argsort(-logs):  # the nearest last, over the others
        color = tuple(int(part) for part in colors[k])
        cv2.circle(picture, (int(columns[k]), int(rows[k])), radius, color, cv2.FILLED)


def _draw_box(picture: UInt8[np.ndarray, "h w 3"], camera: Camera, box: TrackedBox, time_s: float) -> None:
    pose = box.track.pose(time_s)
    if pose is None:
        return
    length, width, height = box.size_lwh
    round_bottom = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    corners = np.array([[*corner, z] for z in (0.0, height) for corner in round_bottom])
    local = corners @ pose[:3, :3].T + pose[:3, 3]
    local = local @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    front = [(0, 1), (1, 5), (5, 4), (4, 0)]
    others = [(k, (k + 1) % 4) for k in (1, 2, 3)] + [(4 + k, 4 + (k + 1) % 4) for k in (1, 2, 3)] + [(2, 6), (3, 7)]
    for edges, color in ((others, _BOX_COLOR), (front, _FRONT_COLOR)):
        for start, end in edges:
            _draw_line(picture, camera, local[start], local[end], color)


def _draw_line(
    picture: UInt8[np.ndarray, "h w 3"],
    camera: Camera,
    start: Float64[np.ndarray, "3"],
    end: Float64[np.ndarray, "3"],
    color: tuple[int, int, int],
) -> None:
    """Draw the part of a line, in the camera's frame, that is in front of the camera."""
    if start[2] > end[2]:
        start, end = end, start
    if end[2] <= _NEAR_PLANE:
        return
    if start[2] < _NEAR_PLANE:
        start = start + (end - start) * (_NEAR_PLANE - start[2]) / (end[2] - start[2])
    ends = [
        (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy) for x, y, z in (start.tolist(), end.tolist())
    ]
    first, second = (tuple(round(float(np.clip(each, -1e6, 1e6))) for each in point) for point in ends)
    visible, first, second = cv2.clipLine((0, 0, camera.width, camera.height), first, second)
    if visible:
        cv2.line(picture, first, second, color, max(round(camera.width / 960), 1), cv2.LINE_AA)


def _captioned(picture: UInt8[np.ndarray, "h w 3"], text: str) -> UInt8[np.ndarray, "h2 w 3"]:
    bar = np.zeros((_CAPTION_PX, picture.shape[1], 3), np.uint8)
    cv2.putText(bar, text, (6, _CAPTION_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (230, 230, 230), 1, cv2.LINE_AA)
    return np.concatenate([bar, picture])

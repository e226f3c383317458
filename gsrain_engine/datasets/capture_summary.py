"""What is in a capture, in numbers: for a page about it, without reading its pictures."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from .capture import Capture, View


@dataclass(frozen=True, slots=True)
class SensorSummary:
    """One camera of a capture, as its first view has it."""

    name: str
    views: int
    width: int
    height: int
    focal_px: tuple[float, float]
    horizontal_fov_deg: float
    """From the left edge to the right one, without what the lens bends."""
    lens: str
    """OpenCV's model and its coefficients; empty where lines are straight."""
    exposure_ms: float
    largest_px: tuple[int, int]
    """Width and height of its largest picture; `width` and `height` are those of its first."""
    smallest_px: tuple[int, int]
    """Width and height of its smallest picture."""
    sizes: int
    """How many different sizes its pictures have."""


@dataclass(frozen=True, slots=True)
class CaptureSummary:
    """What is in a capture."""

    name: str
    sensors: tuple[SensorSummary, ...]
    views: int
    seconds: float
    """From the first view to the last."""
    minimum: tuple[float, float, float]
    """Corner of the box around all places of cameras, in the world (metres where it is metric)."""
    maximum: tuple[float, float, float]
    course: float
    """Length of the way of the ego, else of the camera with the longest one, in metres where metric."""
    points: int
    sweeps: int
    lidar_points: int
    boxes: dict[str, int]
    """How many things of each class are annotated."""
    has: tuple[str, ...]
    """What every view has beside its picture."""
    attributes: dict[str, dict[str, int]]
    """How many views have each value of what the data set says about them, such as the weather."""
    is_metric: bool
    has_poses: bool
    up: tuple[float, float, float]
    problems: tuple[str, ...]


def summarized(capture: Capture) -> CaptureSummary:
    """Count and measure what a capture holds."""
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


def _sensor(views: list[View]) -> SensorSummary:
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

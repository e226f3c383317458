"""Recordings as sources of data sets: their photographs without lens, boxes, and lidar."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame, LidarSweep
from ..datasets.geometry import OPENCV_FROM_VEHICLE_AXES, Pose, invert_pose, lidar_depth, translation_pose
from ..datasets.undistort import undistort_frame
from ..evaluation.detection.ground_truth import ground_truth_from_boxes
from ..evaluation.lidar.scan import LidarTurn, sweep_turn
from ..rain.settings import RainSettings
from ..recordings.pictures import PhotoRain
from ..render.label_export import box_annotation
from ..render.object_labels import area_px, convex_outline, cut_at_edges
from ..render.provenance import PictureProvenance
from ..render.renderer import Renderer
from ..scene.geometry import box_corners
from ..scene.scene import Scene
from .source import DatasetChoice, DatasetMoment, DatasetSource, ObjectLabels, PicturesInRain, PlacedBox, Shot

_MIN_HEIGHT_PX = 3.0  # of an outline, as for objects of scenes
_ONLY = "camera"  # name of the only camera of a recording that has no name

Colors = UInt8[np.ndarray, "h w 3"]


class CaptureSource(DatasetSource):
    """A recording. A moment is a time of its busiest camera, with the pictures and the turn that are nearest to it."""

    kind = "recording"

    def __init__(
        self,
        capture: Capture,
        choice: DatasetChoice = DatasetChoice(),  # noqa: B008  # a value
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        """Use all moments, or at most those of the rate.

        Raises ValueError for unknown cameras, and for poses whose unit of length is unknown.
        """
        if capture.has_poses and not capture.is_metric:
            raise ValueError(f"{capture.name}: its unit of length is unknown, and rain falls in meters")
        self.name, self.facts, self.has_poses = capture.name, dict(facts or {}), capture.has_poses
        self._capture, self._sensor = capture, choice.sensor
        self._to_world = Scene(capture.name, up=capture.up).scene_to_world
        names = [each or _ONLY for each in capture.sensors]
        unknown = next((name for name in choice.cameras if name not in names), None)
        if unknown is not None:
            raise ValueError(f"cameras: {capture.name} has no camera {unknown!r}, only {', '.join(names)}")
        chosen = tuple(dict.fromkeys(choice.cameras or names))
        views = [view for view in capture if (view.sensor or _ONLY) in chosen]
        bent = list(dict.fromkeys(view.sensor or _ONLY for view in views if view.lens is not None))
        straight = {view.name: undistort_frame(view, choice.width_px) for view in views}
        grouped = _moments(views, chosen)
        self._views = [
            {name: straight[view.name] for name, view in group.items()}
            for group in _thinned(grouped, choice.rate_hz)[: choice.moments or len(grouped)]
        ]
        self.cameras = tuple(name for name in chosen if any(name in group for group in self._views))
        times_s = [min(view.time_s for view in group.values()) for group in self._views]
        self.moments = tuple(
            DatasetMoment(time_s, self._vehicle(time_s, group))
            for time_s, group in zip(times_s, self._views, strict=True)
        )
        self._sweeps = [_nearest(capture.sweeps, time_s, times_s) for time_s in times_s]
        self.has_lidar = choice.sensor is not None and any(each is not None for each in self._sweeps)
        self.left_out = tuple(self._missing(bent))

    def _missing(self, bent: Sequence[str]) -> list[str]:
        capture = self._capture
        lines: list[str] = []
        if not capture.has_poses:
            lines.append("the recording has no camera poses: no ego poses, boxes and lidar")
        elif not capture.boxes:
            lines.append("the recording has no boxes, so no objects are labeled")
        elif capture.ego is None:
            lines.append("the recording has no track of a vehicle: the first camera takes its place")
        if not capture.sweeps:
            lines.append("the recording has no lidar")
        elif any(sweep.intensities is None for sweep in capture.sweeps):
            lines.append("the recording's lidar has no intensities: they are 0")
        lines.append("instance masks: a recording has none; 2D boxes are those of the 3D boxes' outlines")
        if bent:
            lines.append(f"distortion of {', '.join(bent)}: pictures are undistorted, as the layouts hold pinholes")
        return lines

    def _vehicle(self, time_s: float, group: Mapping[str, CaptureFrame]) -> Pose:
        above = translation_pose(np.array([0.0, 0.0, -EGO_HEIGHT_M]))
        pose = None if self._capture.ego is None else self._capture.ego.pose(time_s)
        if pose is None:
            first = next(iter(group.values()))
            pose = first.camera.camera_to_world @ OPENCV_FROM_VEHICLE_AXES
        return self._to_world @ pose @ above

    def shot(self, moment: int, camera: str) -> Shot | None:
        view = self._views[moment].get(camera)
        return None if view is None else Shot(view.time_s, view.camera.moved(self._to_world))

    def camera_to_vehicle(self, camera: str) -> Pose:
        group = next(each for each in self._views if camera in each)
        view = group[camera]
        return invert_pose(self._vehicle(view.time_s, group)) @ self._to_world @ view.camera.camera_to_world

    def sweep_time_s(self, moment: int) -> float:
        sweep = self._sweeps[moment]
        return self.moments[moment].time_s if sweep is None else sweep.time_s

    def boxes(self, moment: int) -> list[PlacedBox]:
        time_s = self.sweep_time_s(moment)
        placed = ((box, box.track.pose(time_s)) for box in self._capture.boxes if self.has_poses)
        return [
            PlacedBox(box.id, box.class_name, box.size_lwh, self._to_world @ pose)
            for box, pose in placed
            if pose is not None
        ]

    def labels(self, renderer: Renderer, moment: int, camera: str) -> ObjectLabels:
        view = self._views[moment][camera]
        return ObjectLabels(self._objects(view), None, self._depth(view, moment))

    def _objects(self, view: CaptureFrame) -> list[dict[str, Any]]:
        boxes = {box.id: box for box in self._capture.boxes} if self.has_poses else {}
        found: list[dict[str, Any]] = []
        for truth in ground_truth_from_boxes(tuple(boxes.values()), view.camera, view.time_s):
            box = boxes[truth.id]
            pose = box.track.pose(view.time_s)
            if pose is None or truth.height_px < _MIN_HEIGHT_PX:
                continue
            to_camera = view.camera.world_to_camera @ pose
            left, top, right, bottom = truth.box_xyxy
            found.append({
                "class_name": box.class_name,
                "bbox": [round(each, 2) for each in (left, top, right - left, bottom - top)],
                "area": round((right - left) * (bottom - top), 2),
                "segmentation": [],
                "iscrowd": 0,
                "object": box.id,
                "visibility": round(truth.visibility, 4),
                "truncation": round(_truncation(to_camera, box.size_lwh, view), 4),
                "distance_m": round(truth.distance_m or 0.0, 3),
                "box_3d": box_annotation(box.size_lwh, to_camera),
            })  # fmt: skip
        return found

    def _depth(self, view: CaptureFrame, moment: int) -> Float32[np.ndarray, "h w"] | None:
        if view.depth_source is not None:
            return view.depth
        sweep = self._sweeps[moment]
        return None if sweep is None else lidar_depth(view, [sweep])

    def clear_turn(self, moment: int) -> LidarTurn | None:
        sweep = self._sweeps[moment]
        if sweep is None or self._sensor is None:
            return None
        return sweep_turn(sweep, self._sensor, self._capture.ego)

    def in_rain(self, renderer: Renderer, rain: RainSettings) -> PicturesInRain:
        return _PhotosInRain(PhotoRain(renderer, self._capture, rain), self._views)


class _PhotosInRain:
    def __init__(self, photos: PhotoRain, views: Sequence[Mapping[str, CaptureFrame]]) -> None:
        self._photos, self._views = photos, views

    def picture(self, moment: int, camera: str) -> tuple[Colors, PictureProvenance]:
        view = self._views[moment][camera]
        picture = self._photos.rainy(view, view.image)
        return picture, self._photos.facts[-1].provenance


def _truncation(
    to_camera: Float64[np.ndarray, "4 4"], size_lwh: tuple[float, float, float], view: CaptureFrame
) -> float:
    hull = convex_outline(box_corners(to_camera, size_lwh), view.camera)
    return min(max(1 - area_px(cut_at_edges(hull, view.camera)) / max(area_px(hull), 1e-9), 0.0), 1.0)


def _moments(views: Sequence[CaptureFrame], cameras: Sequence[str]) -> list[dict[str, CaptureFrame]]:
    """Group views by the times of the busiest camera; each view belongs to the nearest of these, one a camera."""
    by_camera = {name: [view for view in views if (view.sensor or _ONLY) == name] for name in cameras}
    busiest = max(by_camera.values(), key=len)
    times = np.array(sorted(view.time_s for view in busiest))
    groups: list[dict[str, CaptureFrame]] = [{} for _ in times]
    half_s = float(np.median(np.diff(times))) / 2 if len(times) > 1 else np.inf
    if half_s == 0:  # pictures without times
        for name, own in by_camera.items():
            for number, view in enumerate(own[: len(groups)]):
                groups[number][name] = view
        return groups
    for name, own in by_camera.items():
        for view in own:
            number = int(np.argmin(np.abs(times - view.time_s)))
            other = groups[number].get(name)
            off_s = abs(times[number] - view.time_s)
            if off_s <= half_s and (other is None or off_s < abs(times[number] - other.time_s)):
                groups[number][name] = view
    return groups


def _thinned(groups: Sequence[dict[str, CaptureFrame]], rate_hz: float | None) -> list[dict[str, CaptureFrame]]:
    taken: list[dict[str, CaptureFrame]] = []
    next_s = -np.inf
    for group in groups:
        time_s = min(view.time_s for view in group.values())
        if rate_hz is None or time_s >= next_s - 1e-6:
            taken.append(group)
            next_s = time_s + (0.0 if rate_hz is None else 1 / rate_hz)
    return taken


def _nearest(sweeps: Sequence[LidarSweep], time_s: float, times_s: Sequence[float]) -> LidarSweep | None:
    """Return the sweep nearest to a moment that is not nearer to another one."""
    nearest = min(sweeps, key=lambda each: abs(each.time_s - time_s), default=None)
    if nearest is None or min(times_s, key=lambda each: abs(each - nearest.time_s)) != time_s:
        return None
    return nearest

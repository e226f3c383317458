"""nuScenes from its own tables: annotated samples, six cameras, the roof lidar, boxes.

The world is the map's (z up); the vehicle's frame is on the ground below the rear axle. Images are rectified.
"""

import codecs
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from ..safe_io.errors import readable_validation_error
from ..safe_io.limits import read_file
from .capture import Capture, CaptureError, CaptureFrame, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import (
    BoxSample,
    Pose,
    invert_pose,
    opencv_camera_of_matrix,
    rigid_from_quaternion,
)
from .io.images import image_size, read_color
from .io.sweep_files import RowFile

_LIDAR_COLUMNS = 5  # x y z (m; right, forward, up) intensity (0..255) ring, float32
_US = 1e-6


def recognizes_nuscenes(path: Path) -> bool:
    """Return whether a path is nuScenes (v1.0-*/sample_data.json), the folder of its tables, or NUSCENES/scene-NNNN."""
    return _tables_in(path) is not None or (path.name.startswith("scene-") and _tables_in(path.parent) is not None)


def read_nuscenes(path: Path, key_frames_only: bool = True) -> Capture:
    """Read one scene: NUSCENES/scene-0061 (a name, not a folder on disk) or, for the dataset, the first available one.

    `key_frames_only` False adds the images between annotated samples (12 a second). Raises `CaptureError`.
    """
    folder = _tables_in(path)
    asked = None if folder else path.name
    folder = folder or _tables_in(path.parent)
    if folder is None:
        raise CaptureError(f"{path}: no tables of nuScenes in it (v1.0-mini/sample_data.json)")
    scenes = {scene.name: scene.token for scene in _table(folder, "scene", _NamedRow).values()}
    if asked is not None and asked not in scenes:
        raise CaptureError(f"{folder}: has no scene {asked!r}; it has {', '.join(sorted(scenes)[:10])}")
    samples = _table(folder, "sample", _Sample)
    by_scene: dict[str, list[_SampleData]] = defaultdict(list)
    for each in _table(folder, "sample_data", _SampleData).values():
        if each.sample_token in samples and (each.is_key_frame or not key_frames_only):
            by_scene[samples[each.sample_token].scene_token].append(each)
    name = asked or _first_there(folder, scenes, by_scene)
    scene = _SceneReader(folder, DrivingLog(name, road_m=0.0))
    others = sorted(each for each in scenes if each != name)
    if asked is None and others:
        scene.log.problems.append(
            f"{name} is read; open one of the other {len(others)} scenes as {folder.parent / others[0]}"
        )
    of_scene = {token: sample for token, sample in samples.items() if sample.scene_token == scenes[name]}
    scene.log.box_times_s = sorted(sample.timestamp * _US for sample in of_scene.values())
    with scene.log.omitting("boxes", CaptureError):
        scene.add_boxes(of_scene)
    return scene.capture(by_scene[scenes[name]], samples)


def _tables_in(path: Path) -> Path | None:
    if (path / "sample_data.json").is_file() and (path / "ego_pose.json").is_file():
        return path
    versions = sorted(path.glob("v1.0-*/sample_data.json")) if path.is_dir() else []
    return versions[0].parent if versions else None


# Tables
# Facts: docs/schema_nuscenes.md of github.com/nutonomy/nuscenes-devkit. Rotations are w x y z, sizes width length
# height, time stamps microseconds.


class _TableRow(msgspec.Struct, frozen=True, gc=False):
    token: str


class _NamedRow(_TableRow, frozen=True, gc=False):
    """A scene, which is 20 seconds of a drive, or a class of objects."""

    name: str


class _Sample(_TableRow, frozen=True, gc=False):
    """An annotated time."""

    timestamp: int
    scene_token: str


class _SampleData(_TableRow, frozen=True, gc=False):
    """A file of one sensor."""

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    timestamp: int
    is_key_frame: bool


class _Posed(_TableRow, frozen=True, gc=False):
    """Pose of the vehicle in the world."""

    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    def pose(self) -> Pose:
        return rigid_from_quaternion(self.rotation, self.translation)


class _CalibratedSensor(_Posed, frozen=True, gc=False):
    """Pose of a sensor: sensor to vehicle."""

    sensor_token: str
    camera_intrinsic: list[list[float]] = []


class _Sensor(_TableRow, frozen=True, gc=False):
    channel: str
    modality: str


class _Annotation(_Posed, frozen=True, gc=False):
    """A box at the time of a sample, in the world."""

    sample_token: str
    instance_token: str
    size: tuple[float, float, float]


class _Instance(_TableRow, frozen=True, gc=False):
    """An annotated object."""

    category_token: str


_RowType = TypeVar("_RowType", bound=_TableRow)


def _table(folder: Path, name: str, kind: type[_RowType]) -> dict[str, _RowType]:
    """Read the rows of a table by their tokens. Raises `CaptureError`."""
    file = folder / f"{name}.json"
    try:
        content = read_file(file).removeprefix(codecs.BOM_UTF8)
        rows: list[Any] = msgspec.json.decode(content, type=list[kind])
    except FileNotFoundError:
        raise CaptureError(f"{file}: this table of nuScenes is missing") from None
    except msgspec.ValidationError as error:
        raise CaptureError(f"{file}: {readable_validation_error(error, list[kind])}") from None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise CaptureError(f"{file}: not a JSON file that can be read ({error})") from None
    return {row.token: row for row in rows}


def _first_there(folder: Path, scenes: Mapping[str, str], by_scene: Mapping[str, list[_SampleData]]) -> str:
    """First scene, by name, with images on disk (a download may be a part of the dataset)."""
    for name in sorted(scenes):
        if any((folder.parent / each.filename).is_file() for each in by_scene[scenes[name]][:50]):
            return name
    raise CaptureError(f"{folder}: of none of its {len(scenes)} scenes are the files there")


class _SceneReader:
    def __init__(self, folder: Path, log: DrivingLog) -> None:
        self.folder, self.root, self.log = folder, folder.parent, log
        self.ego_poses = _table(folder, "ego_pose", _Posed)
        self.calibrated = _table(folder, "calibrated_sensor", _CalibratedSensor)
        self.sensors = _table(folder, "sensor", _Sensor)

    def add_boxes(self, samples: Mapping[str, _Sample]) -> None:
        """Add the boxes of samples. Raises `CaptureError` if the tables are missing, as in the test split."""
        annotations = _table(self.folder, "sample_annotation", _Annotation)
        classes = _table(self.folder, "category", _NamedRow)
        instances = _table(self.folder, "instance", _Instance)
        for each in annotations.values():
            if each.sample_token not in samples:
                continue
            instance = instances.get(each.instance_token)
            named = None if instance is None else classes.get(instance.category_token)
            name = "unknown" if named is None else named.name
            width, length, height = each.size
            with self.log.omitting(f"box {each.token}"):
                time_s = samples[each.sample_token].timestamp * _US
                self.log.boxes.append(
                    BoxSample(each.instance_token, name, time_s, (length, width, height), each.pose())
                )

    def capture(self, data: list[_SampleData], samples: Mapping[str, _Sample]) -> Capture:
        check_inside(self.root, (each.filename for each in data), self.root)
        lidars: list[_SampleData] = []
        times = [samples[each.sample_token].timestamp for each in data]
        numbers = {time: number for number, time in enumerate(sorted(set(times)))}
        for each in sorted(data, key=lambda each: each.timestamp):
            with self.log.omitting(each.filename):
                sensor = self._sensor(each)
                if sensor.modality in ("camera", "lidar"):
                    self.log.stamps.append((each.timestamp * _US, self._vehicle(each)))
                if sensor.modality == "camera":
                    number = numbers[samples[each.sample_token].timestamp]
                    self.log.views.append(self._view(each, sensor.channel, number))
                elif sensor.modality == "lidar":
                    lidars.append(each)
        order = {name: number for number, name in enumerate(sorted({view.sensor for view in self.log.views}))}
        self.log.views.sort(key=lambda view: (view.name.split("_", 1)[0], order[view.sensor], view.time_s))
        self.log.scans, self.log.scan_count = self._scans(lidars), len(lidars)
        return self.log.capture()

    def _sensor(self, each: _SampleData) -> _Sensor:
        calibrated = self.calibrated.get(each.calibrated_sensor_token)
        sensor = self.sensors.get(calibrated.sensor_token) if calibrated else None
        if sensor is None:
            raise ValueError("its sensor is not in the tables")
        return sensor

    def _vehicle(self, each: _SampleData) -> Pose:
        placed = self.ego_poses.get(each.ego_pose_token)
        if placed is None:
            raise ValueError("its ego pose is not in the tables")
        return placed.pose()

    def _view(self, each: _SampleData, channel: str, number: int) -> CaptureFrame:
        file = self.root / each.filename
        size = image_size(file)
        calibrated = self.calibrated[each.calibrated_sensor_token]
        matrix = np.asarray(calibrated.camera_intrinsic, np.float64)
        camera = opencv_camera_of_matrix(matrix, size, invert_pose(self._vehicle(each) @ calibrated.pose()))
        name = f"{number:04d}_{channel}" if each.is_key_frame else f"{number:04d}_{channel}_{each.timestamp}"
        return CaptureFrame(name, camera, partial(read_color, file), each.timestamp * _US, channel)

    def _scans(self, lidars: list[_SampleData]) -> Iterator[LidarScan]:
        for each in lidars:
            with self.log.omitting(each.filename):
                to_vehicle = self.calibrated[each.calibrated_sensor_token].pose()
                key, vehicle = RowFile(self.root / each.filename, _LIDAR_COLUMNS), self._vehicle(each)
                turn = key.read()
                yield LidarScan.placed(each.timestamp * _US, vehicle, to_vehicle, turn.points_m, turn.intensities, key)

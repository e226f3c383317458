"""nuScenes from its own tables: one scene of annotated samples, six cameras, the roof lidar, boxes.

The world is the map's (z up); the vehicle's frame is on the ground below the rear axle. Images are rectified.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float32, Float64

from ..safe_io.limits import read_file
from .capture import Capture, CaptureError, CaptureFrame, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, invert_pose, opencv_camera_of_matrix, rigid_from_quaternion, transform_points
from .io.images import image_size, read_color

_LIDAR_COLUMNS = 5  # x y z intensity ring, float32
_US = 1e-6


def recognizes_nuscenes(path: Path) -> bool:
    """Return whether a path is nuScenes (v1.0-*/sample_data.json), the folder of its tables, or NUSCENES/scene-NNNN."""
    return _tables_in(path) is not None or (path.name.startswith("scene-") and _tables_in(path.parent) is not None)


def read_nuscenes(path: Path, key_frames_only: bool = True) -> Capture:
    """Read one scene: NUSCENES/scene-0061 (a name, not a folder on disk) or, for the dataset, the first available one.

    `key_frames_only` False adds the images between annotated samples (12 a second). Raises `CaptureError`.
    """
    folder = _tables_in(path)
    wanted = None if folder else path.name
    folder = folder or _tables_in(path.parent)
    if folder is None:
        raise CaptureError(f"{path}: no tables of nuScenes in it (v1.0-mini/sample_data.json)")
    tables = NuScenesTables(folder)
    scenes = {scene.name: scene for scene in tables.scenes.values()}
    if wanted is not None and wanted not in scenes:
        raise CaptureError(f"{folder}: has no scene {wanted!r}; it has {', '.join(sorted(scenes)[:10])}")
    samples = {sample.token: sample.timestamp * _US for sample in tables.samples.values()}
    of_scene = {token: sample.scene_token for token, sample in tables.samples.items()}
    by_scene: dict[str, list[SampleData]] = defaultdict(list)
    for each in tables.sample_data.values():
        if each.sample_token in samples and (each.is_key_frame or not key_frames_only):
            by_scene[of_scene[each.sample_token]].append(each)
    chosen = scenes[wanted] if wanted else _first_there(folder, scenes, by_scene)
    tables.read_poses()
    drive = _SceneReader(tables, folder.parent, chosen, DrivingLog(chosen.name, road_m=0.0))
    others = sorted(name for name in scenes if name != chosen.name)
    if wanted is None and others:
        drive.record.problems.append(
            f"{chosen.name} is read; open one of the other {len(others)} scenes as {folder.parent / others[0]}"
        )
    drive.boxes({token: time for token, time in samples.items() if of_scene[token] == chosen.token})
    return drive.capture(by_scene[chosen.token])


def _tables_in(path: Path) -> Path | None:
    if (path / "sample_data.json").is_file() and (path / "ego_pose.json").is_file():
        return path
    versions = sorted(path.glob("v1.0-*/sample_data.json")) if path.is_dir() else []
    return versions[0].parent if versions else None


# Tables
# Facts: docs/schema_nuscenes.md of github.com/nutonomy/nuscenes-devkit. Rotations are w x y z, sizes width length
# height.


class NuScenesScene(msgspec.Struct, frozen=True, gc=False):
    """20 seconds of a drive."""

    token: str
    name: str


class SampleData(msgspec.Struct, frozen=True, gc=False):
    """A file of one sensor."""

    token: str
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    timestamp: int
    is_key_frame: bool


def _first_there(
    folder: Path, scenes: dict[str, NuScenesScene], by_scene: dict[str, list[SampleData]]
) -> NuScenesScene:
    """First scene, by name, with images on disk (a download may be a part of the dataset)."""
    for name in sorted(scenes):
        if any((folder.parent / each.filename).is_file() for each in by_scene[scenes[name].token][:50]):
            return scenes[name]
    raise CaptureError(f"{folder}: of none of its {len(scenes)} scenes are the files there")


Row = TypeVar("Row")


class Sample(msgspec.Struct, frozen=True, gc=False):
    """An annotated time."""

    token: str
    timestamp: int
    """Microseconds."""
    scene_token: str


class EgoPose(msgspec.Struct, frozen=True, gc=False):
    """Ego pose: vehicle to world."""

    token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class CalibratedSensor(msgspec.Struct, frozen=True, gc=False):
    """Pose of a sensor: sensor to vehicle."""

    token: str
    sensor_token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    camera_intrinsic: list[list[float]] = []


class Sensor(msgspec.Struct, frozen=True, gc=False):
    """A sensor's name and kind."""

    token: str
    channel: str
    modality: str


class Annotation(msgspec.Struct, frozen=True, gc=False):
    """A box at the time of a sample, in the world."""

    token: str
    sample_token: str
    instance_token: str
    translation: tuple[float, float, float]
    size: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


@dataclass(frozen=True)
class NuScenesTables:
    """Tables of one version of the dataset, read on first use. Each raises `CaptureError`."""

    folder: Path

    @cached_property
    def scenes(self) -> dict[str, NuScenesScene]:
        return self._rows("scene", NuScenesScene)

    @cached_property
    def samples(self) -> dict[str, Sample]:
        return self._rows("sample", Sample)

    @cached_property
    def sample_data(self) -> dict[str, SampleData]:
        return self._rows("sample_data", SampleData)

    @cached_property
    def ego_poses(self) -> dict[str, EgoPose]:
        return self._rows("ego_pose", EgoPose)

    @cached_property
    def calibrated_sensors(self) -> dict[str, CalibratedSensor]:
        return self._rows("calibrated_sensor", CalibratedSensor)

    @cached_property
    def sensors(self) -> dict[str, Sensor]:
        return self._rows("sensor", Sensor)

    def read_poses(self) -> None:
        """Read the tables that every sensor file needs, so that a broken table is reported once."""
        _ = self.ego_poses, self.calibrated_sensors, self.sensors

    @cached_property
    def annotations(self) -> dict[str, Annotation]:
        """Boxes; missing in the test split."""
        return self._rows("sample_annotation", Annotation)

    @cached_property
    def class_names(self) -> dict[str, str]:
        categories = self._rows("category", Category)
        instances = self._rows("instance", Instance)
        return {
            token: categories[each.category_token].name if each.category_token in categories else "unknown"
            for token, each in instances.items()
        }

    def _rows(self, name: str, kind: type[Row]) -> dict[str, Row]:
        file = self.folder / f"{name}.json"
        try:
            rows: list[Any] = msgspec.json.decode(read_file(file), type=list[kind])
        except FileNotFoundError:
            raise CaptureError(f"{file}: this table of nuScenes is missing") from None
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise CaptureError(f"{file}: {error}") from None
        return {row.token: row for row in rows}


@dataclass(frozen=True, slots=True)
class _SceneReader:
    tables: NuScenesTables
    root: Path
    scene: NuScenesScene
    record: DrivingLog

    def capture(self, data: list[SampleData]) -> Capture:
        check_inside(self.root, (each.filename for each in data), self.root)
        lidars: list[SampleData] = []
        numbers = {time: number for number, time in enumerate(sorted({self._sample_time(each) for each in data}))}
        for each in sorted(data, key=lambda each: each.timestamp):
            sensor = self._sensor(each)
            try:
                if sensor is None or sensor[1] not in ("camera", "lidar"):
                    continue
                self.record.stamps.append((each.timestamp * _US, self._vehicle(each)))
                if sensor[1] == "camera":
                    self.record.views.append(self._view(each, sensor[0], numbers[self._sample_time(each)]))
                else:
                    lidars.append(each)
            except (CaptureError, KeyError, ValueError) as error:
                self._left_out(each, str(error))
        order = {name: number for number, name in enumerate(sorted({view.sensor for view in self.record.views}))}
        self.record.views.sort(key=lambda view: (view.name.split("_", 1)[0], order[view.sensor], view.time_s))
        self.record.scans, self.record.scan_count = self._scans(lidars), len(lidars)
        return self.record.capture()

    def boxes(self, samples: dict[str, float]) -> None:
        """Read the boxes of the scene's samples, if published."""
        self.record.box_times_s = sorted(samples.values())
        try:
            annotations, names = self.tables.annotations, self.tables.class_names
        except CaptureError as error:
            self.record.problems.append(f"boxes left out: {error}")
            return
        for each in annotations.values():
            if each.sample_token not in samples:
                continue
            width, length, height = each.size
            try:
                pose = rigid_from_quaternion(each.rotation, each.translation)
                time, name = samples[each.sample_token], names.get(each.instance_token, "unknown")
                box = BoxSample(each.instance_token, name, time, (length, width, height), pose)
            except ValueError as error:
                self.record.problems.append(f"box {each.token} left out: {error}")
            else:
                self.record.boxes.append(box)

    def _sample_time(self, each: SampleData) -> int:
        return self.tables.samples[each.sample_token].timestamp

    def _left_out(self, each: SampleData, why: str) -> None:
        self.record.problems.append(f"{each.filename} left out: {why}")

    def _sensor(self, each: SampleData) -> tuple[str, str] | None:
        calibrated = self.tables.calibrated_sensors.get(each.calibrated_sensor_token)
        sensor = self.tables.sensors.get(calibrated.sensor_token) if calibrated else None
        if sensor is None:
            self._left_out(each, "its sensor is not in the tables")
            return None
        return sensor.channel, sensor.modality

    def _vehicle(self, each: SampleData) -> Float64[np.ndarray, "4 4"]:
        placed = self.tables.ego_poses.get(each.ego_pose_token)
        if placed is None:
            raise ValueError("its ego pose is not in the tables")
        return rigid_from_quaternion(placed.rotation, placed.translation)

    def _to_vehicle(self, each: SampleData) -> Float64[np.ndarray, "4 4"]:
        calibrated = self.tables.calibrated_sensors[each.calibrated_sensor_token]
        return rigid_from_quaternion(calibrated.rotation, calibrated.translation)

    def _view(self, each: SampleData, channel: str, number: int) -> CaptureFrame:
        file = self.root / each.filename
        width, height = image_size(file)
        matrix = np.asarray(self.tables.calibrated_sensors[each.calibrated_sensor_token].camera_intrinsic, np.float64)
        to_world = self._vehicle(each) @ self._to_vehicle(each)
        camera = opencv_camera_of_matrix(matrix, (width, height), invert_pose(to_world))
        name = f"{number:04d}_{channel}" if each.is_key_frame else f"{number:04d}_{channel}_{each.timestamp}"
        return CaptureFrame(name, camera, partial(read_color, file), each.timestamp * _US, channel)

    def _scans(self, lidars: list[SampleData]) -> Iterator[LidarScan]:
        for each in lidars:
            try:
                to_vehicle = self._to_vehicle(each)
                points, light = read_nuscenes_points(self.root / each.filename)
                placed = transform_points(to_vehicle, points)
                yield LidarScan(each.timestamp * _US, self._vehicle(each), placed, to_vehicle[:3, 3], light)
            except (CaptureError, ValueError) as error:
                self._left_out(each, str(error))


def read_nuscenes_points(
    file: Path, columns: int = _LIDAR_COLUMNS
) -> tuple[Float32[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]:
    """Points (m, in the lidar's frame: x right, y forward, z up) and intensities (0..255) of a .pcd.bin."""
    try:
        data = read_file(file)
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
    if len(data) % (4 * columns) or not data:
        raise CaptureError(f"{file}: {len(data)} bytes are not rows of {columns} numbers")
    rows = np.frombuffer(data, np.float32).reshape(-1, columns)
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])


class Instance(msgspec.Struct, frozen=True, gc=False):
    """An annotated object."""

    token: str
    category_token: str


class Category(msgspec.Struct, frozen=True, gc=False):
    """A class of objects."""

    token: str
    name: str

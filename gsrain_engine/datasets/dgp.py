"""TRI's Dataset Governance Policy (DGP): calibrations and scenes of cameras, lidar and boxes.

Facts: CameraIntrinsics in dgp/proto/geometry.proto of github.com/TRI-ML/dgp, which copies OpenCV's coefficients.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from ..scene.camera import Camera
from .capture import Capture, CaptureError, CaptureFrame, Lens, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, invert_pose, named_pose, opencv_camera, transform_points
from .io.arrays import WRONG_VALUES, read_json_object, read_npz, what_is_wrong
from .io.images import image_size, read_color


@dataclass(frozen=True, slots=True, eq=False)
class DgpSensor:
    """A row of a calibration: pose of a sensor and intrinsics of a camera."""

    to_vehicle: Float64[np.ndarray, "4 4"]
    intrinsics: dict[str, Any]

    def camera(self, width: int, height: int, world_to_camera: Float64[np.ndarray, "4 4"]) -> Camera:
        """Camera of an image; ValueError for invalid or skewed calibrations."""
        fx, fy, cx, cy, skew = (float(self.intrinsics.get(name, 0.0)) for name in ("fx", "fy", "cx", "cy", "skew"))
        if abs(skew) > 0.5:
            raise ValueError(f"its calibration has a skew of {skew:g} px, and cameras here have none")
        return opencv_camera((fx, fy), (cx, cy), (width, height), world_to_camera)

    def lens_distortion(self) -> Lens | None:
        """Distortion in the calibration; ValueError for models that OpenCV lacks."""
        value = {name: float(number) for name, number in self.intrinsics.items()}
        strange = [name for name in ("alpha", "beta", "w", "xi", "equirectangular", "taux", "tauy") if value.get(name)]
        if strange:
            raise ValueError(f"its lens model ({', '.join(strange)} in the calibration) is not known here")
        if value.get("fisheye", 0.0) not in (0.0, 1.0):
            raise ValueError(f"its fisheye model {value['fisheye']:g} is not known here")
        if value.get("fisheye"):
            return Lens("fisheye", tuple(value.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")))
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
        coefficients = [value.get(name, 0.0) for name in names]
        if not any(coefficients):
            return None
        length = next(count for count in (5, 8, 12) if not any(coefficients[count:]))
        return Lens("opencv", tuple(coefficients[:length]))


def read_dgp_calibration(file: Path) -> dict[str, DgpSensor]:
    """Sensors by name. Raises `CaptureError`."""
    values = read_json_object(file)
    try:
        rows = zip(values["names"], values["extrinsics"], values["intrinsics"], strict=True)
        return {str(name): DgpSensor(named_pose(pose), dict(lens)) for name, pose, lens in rows}
    except WRONG_VALUES as error:
        raise CaptureError(f"{file}: {what_is_wrong(error)}") from None


# DGP scenes
# The world is that of the poses, z up. The vehicle's frame (x forward, y left, z up, on the ground) is the target of
# the calibration's extrinsics. Facts: the messages of github.com/TRI-ML/dgp (dgp/proto).

_BOXES_3D = "1"  # annotation type BOUNDING_BOX_3D


def recognizes_dgp(path: Path) -> bool:
    """Return whether a path is a DGP dataset (scene_dataset*.json), one scene of it, or one of these files."""
    if path.is_file():
        return path.suffix == ".json" and path.name.startswith(("scene_dataset", "scene_"))
    return bool(_dataset_files(path)) or (bool(_scene_files(path)) and (path / "calibration").is_dir())


def read_dgp(path: Path) -> Capture:
    """Read one scene; for a dataset the first available one, with the others listed in the capture's problems."""
    problems: list[str] = []
    file = _scene_of(path, problems)
    try:
        return _DgpScene.opened(file, problems).capture()
    except CaptureError:
        raise
    except WRONG_VALUES as error:
        raise CaptureError(f"{file}: {what_is_wrong(error)}") from None


def _dataset_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("scene_dataset*.json"))


def _scene_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.glob("scene_*.json") if not file.name.startswith("scene_dataset"))


def _scene_of(path: Path, problems: list[str]) -> Path:
    if path.is_file():
        return _first_scene(path, problems) if path.name.startswith("scene_dataset") else path
    datasets = _dataset_files(path)
    return _first_scene(datasets[0], problems) if datasets else _scene_files(path)[0]


def _first_scene(dataset: Path, problems: list[str]) -> Path:
    splits = read_json_object(dataset).get("scene_splits")
    try:
        listed = dict.fromkeys(str(name) for split in dict(splits or {}).values() for name in split["filenames"])
    except WRONG_VALUES as error:
        raise CaptureError(f"{dataset}: scene_splits {what_is_wrong(error)}") from None
    try:
        check_inside(dataset.parent, listed, dataset)
        there = [name for name in listed if (dataset.parent / name).is_file()]
    except OSError as error:
        raise CaptureError(f"{dataset}: names a scene that no disk can hold ({error.strerror})") from None
    if not there:
        raise CaptureError(f"{dataset}: none of its {len(listed)} scenes is there")
    missing = [name for name in listed if name not in there]
    if missing:
        problems.append(f"{dataset.name}: {len(missing)} of {len(listed)} scenes missing: {_some(missing)}")
    if there[1:]:
        problems.append(f"{there[0]} is read; open one of the other scenes by its folder: {_some(there[1:])}")
    return dataset.parent / there[0]


def _some(names: list[str]) -> str:
    folders = [name.rpartition("/")[0] or name for name in names]
    return ", ".join(folders[:5]) + (", ..." if len(folders) > 5 else "")


@dataclass(frozen=True, slots=True)
class _DgpScene:
    """One scene file: its data by key, and its samples."""

    file: Path
    data: dict[str, dict[str, Any]]
    samples: list[dict[str, Any]]
    record: DrivingLog
    camera_stamps: list[tuple[float, Float64[np.ndarray, "4 4"], str]] = field(
        default_factory=list[tuple[float, Float64[np.ndarray, "4 4"], str]]
    )
    """Vehicle to world at the time of each image, and the image's camera."""

    @classmethod
    def opened(cls, file: Path, problems: list[str]) -> "_DgpScene":
        values = read_json_object(file)
        try:
            data = {str(datum["key"]): datum for datum in values["data"]}
            samples = sorted(values["samples"], key=lambda sample: str(sample["id"]["timestamp"]))
        except WRONG_VALUES as error:
            raise CaptureError(f"{file}: {what_is_wrong(error)}") from None
        check_inside(file.parent, _named_files(values, data, samples), file)
        record = DrivingLog(str(values.get("name") or file.parent.name), road_m=0.0, problems=problems)
        return cls(file, data, samples, record)

    def capture(self) -> Capture:
        classes = self._classes()
        lidars: list[_DgpLidar] = []
        for number, sample in enumerate(self.samples):
            rig = read_dgp_calibration(self.file.parent / "calibration" / f"{sample.get('calibration_key')}.json")
            for key in sample.get("datum_keys", ()):
                name = str(key)
                try:
                    datum = self.data[str(key)]
                    name = str(datum["id"]["name"])
                    if name not in rig:
                        raise ValueError("it is not in the calibration")
                    if "image" in datum["datum"]:
                        self.record.views.append(self._view(datum, rig[name], number))
                        vehicle = _pose(datum) @ invert_pose(rig[name].to_vehicle)
                        self.camera_stamps.append((_seconds(datum), vehicle, name))
                    elif "point_cloud" in datum["datum"]:
                        lidar = _DgpLidar(name, datum["datum"]["point_cloud"], _seconds(datum), _pose(datum), rig[name])
                        lidars.append(lidar)
                        self._boxes(lidar, classes)
                except WRONG_VALUES as error:
                    self._problem(f"{name} of sample {number}", what_is_wrong(error))
        self.record.stamps = [(each.time_s, each.vehicle_to_world) for each in lidars] or self._stamps_of_a_camera()
        self.record.scans, self.record.scan_count = self._scans(lidars), len(lidars)
        return self.record.capture()

    def _stamps_of_a_camera(self) -> list[tuple[float, Float64[np.ndarray, "4 4"]]]:
        """Vehicle poses from the first camera, for scenes without a lidar."""
        return [(time, pose) for time, pose, name in self.camera_stamps if name == self.camera_stamps[0][2]]

    def _problem(self, what: str, why: str) -> None:
        self.record.problems.append(f"{self.file.name}: {what} left out: {why}")

    def _classes(self) -> dict[int, str]:
        ontology = read_json_object(self.file).get("ontologies", {}).get(_BOXES_3D)
        if ontology is None:
            return {}
        try:
            items = read_json_object(self.file.parent / "ontology" / f"{ontology}.json")["items"]
            return {int(item["id"]): str(item["name"]) for item in items}
        except WRONG_VALUES as error:
            self.record.problems.append(f"names of classes are not known: {what_is_wrong(error)}")
            return {}

    def _view(self, datum: dict[str, Any], sensor: DgpSensor, number: int) -> CaptureFrame:
        image, name = datum["datum"]["image"], str(datum["id"]["name"])
        file = self.file.parent / image["filename"]
        width, height = image_size(file)
        if (width, height) != (image["width"], image["height"]):
            raise ValueError(f"{file.name} has {width}x{height} px, expected {image['width']}x{image['height']}")
        camera = sensor.camera(width, height, invert_pose(_pose(datum)))
        return CaptureFrame(
            f"{number:04d}_{name}", camera, partial(read_color, file), _seconds(datum), name, sensor.lens_distortion()
        )

    def _boxes(self, lidar: "_DgpLidar", classes: dict[int, str]) -> None:
        named = lidar.cloud.get("annotations", {}).get(_BOXES_3D)
        if named is None:
            return
        rows = read_json_object(self.file.parent / str(named)).get("annotations", [])
        self.record.box_times_s.append(lidar.time_s)
        for row in rows:
            try:
                box, number = row["box"], int(row["class_id"])
                size = (float(box["length"]), float(box["width"]), float(box["height"]))
                pose, name = lidar.to_world @ named_pose(box["pose"]), classes.get(number, f"class {number}")
                sample = BoxSample(str(row["instance_id"]), name, lidar.time_s, size, pose)
            except WRONG_VALUES as error:
                self._problem(f"a box of {named}", what_is_wrong(error))
            else:
                self.record.boxes.append(sample)

    def _scans(self, lidars: list["_DgpLidar"]) -> Iterator[LidarScan]:
        for lidar in lidars:
            try:
                yield lidar.scan(self.file.parent)
            except WRONG_VALUES as error:
                self._problem(str(lidar.cloud.get("filename", lidar.name)), what_is_wrong(error))


@dataclass(frozen=True, slots=True, eq=False)
class _DgpLidar:
    name: str
    cloud: dict[str, Any]
    time_s: float
    to_world: Float64[np.ndarray, "4 4"]
    sensor: DgpSensor

    @property
    def vehicle_to_world(self) -> Float64[np.ndarray, "4 4"]:
        return self.to_world @ invert_pose(self.sensor.to_vehicle)

    def scan(self, folder: Path) -> LidarScan:
        file, fields = folder / str(self.cloud["filename"]), [str(name) for name in self.cloud["point_format"]]
        rows = np.asarray(read_npz(file, "data"), np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(fields):
            raise ValueError(f"an array of {rows.shape}, expected a column for each of {' '.join(fields)}")
        to_vehicle = self.sensor.to_vehicle
        points = transform_points(to_vehicle, rows[:, [fields.index(axis) for axis in "XYZ"]])
        intensity = next((fields.index(name) for name in ("I", "INTENSITY") if name in fields), None)
        with np.errstate(over="ignore"):
            light = None if intensity is None else rows[:, intensity].astype(np.float32)
        return LidarScan(self.time_s, self.vehicle_to_world, points, to_vehicle[:3, 3], light)


def _named_files(
    values: dict[str, Any], data: dict[str, dict[str, Any]], samples: list[dict[str, Any]]
) -> Iterator[str]:
    """All file names in a scene; invalid ones are left to their readers."""
    for datum in data.values():
        for kind in _dicts(datum.get("datum")):
            named = [kind.get("filename"), *_values(kind.get("annotations"))]
            yield from (each for each in named if isinstance(each, str))
    yield from (f"calibration/{sample.get('calibration_key')}.json" for sample in samples)
    yield from (f"ontology/{name}.json" for name in _values(values.get("ontologies")))


def _values(values: Any) -> list[Any]:
    return list(values.values()) if isinstance(values, dict) else []


def _dicts(values: Any) -> list[dict[str, Any]]:
    return [each for each in _values(values) if isinstance(each, dict)]


def _pose(datum: dict[str, Any]) -> Float64[np.ndarray, "4 4"]:
    """Sensor to world."""
    return named_pose(next(iter(datum["datum"].values()))["pose"])


def _seconds(datum: dict[str, Any]) -> float:
    """Time stamp in seconds of the epoch; the years of public scenes are shifted."""
    stamp = datetime.fromisoformat(datum["id"]["timestamp"])
    return (stamp.replace(tzinfo=stamp.tzinfo or UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()

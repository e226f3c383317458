"""TRI's Dataset Governance Policy (DGP): calibrations and scenes of cameras, lidar and boxes.

The world is that of the poses, z up. The vehicle's frame (x forward, y left, z up, on the ground) is the target of the
calibration's extrinsics. Facts: the messages of github.com/TRI-ML/dgp (dgp/proto); their CameraIntrinsics have OpenCV's
coefficients.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..scene.camera import Camera
from ..scene.lens import Lens
from .capture import Capture, CaptureError, CaptureFrame, check_inside
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, Pose, invert_pose, named_pose, opencv_camera
from .io.arrays import WRONG_VALUES, read_json_object, what_is_wrong
from .io.images import image_size, read_color
from .io.sweep_files import ArchiveFile

_BOXES_3D = "1"  # annotation type BOUNDING_BOX_3D


def recognizes_dgp(path: Path) -> bool:
    """Return whether a path is a DGP dataset (scene_dataset*.json), one scene of it, or one of these files."""
    if path.is_file():
        return path.suffix == ".json" and path.name.startswith(("scene_dataset", "scene_"))
    return bool(_dataset_files(path)) or (bool(_scene_files(path)) and (path / "calibration").is_dir())


def read_dgp(path: Path) -> Capture:
    """Read one scene; for a dataset the first available one, with the others listed in the capture's problems."""
    problems: list[str] = []
    file = path if path.is_file() else (_dataset_files(path) or _scene_files(path))[0]
    if file.name.startswith("scene_dataset"):
        file = _first_scene(file, problems)
    try:
        return _DgpScene(file, problems).capture()
    except CaptureError:
        raise
    except WRONG_VALUES as error:
        raise CaptureError(f"{file}: {what_is_wrong(error)}") from None


def _dataset_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("scene_dataset*.json"))


def _scene_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.glob("scene_*.json") if not file.name.startswith("scene_dataset"))


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


class _DgpScene:
    def __init__(self, file: Path, problems: list[str]) -> None:
        self.file, self.folder = file, file.parent
        self.values = read_json_object(file)
        try:
            self.data = {str(datum["key"]): datum for datum in self.values["data"]}
            self.samples = sorted(self.values["samples"], key=lambda sample: str(sample["id"]["timestamp"]))
        except WRONG_VALUES as error:
            raise CaptureError(f"{file}: {what_is_wrong(error)}") from None
        check_inside(self.folder, self._named_files(), file)
        self.log = DrivingLog(str(self.values.get("name") or self.folder.name), road_m=0.0, problems=problems)

    def capture(self) -> Capture:
        classes = self._classes()
        lidars: list[_DgpLidar] = []
        camera_stamps: dict[str, list[tuple[float, Pose]]] = {}
        for number, sample in enumerate(self.samples):
            rig = _read_calibration(self.folder / "calibration" / f"{sample.get('calibration_key')}.json")
            for key in sample.get("datum_keys", ()):
                name = str(key)
                try:
                    datum = self.data[str(key)]
                    name = str(datum["id"]["name"])
                    if name not in rig:
                        raise ValueError("it is not in the calibration")
                    if "image" in datum["datum"]:
                        self.log.views.append(self._view(datum, rig[name], number))
                        vehicle = _pose(datum) @ invert_pose(rig[name].to_vehicle)
                        camera_stamps.setdefault(name, []).append((_seconds(datum), vehicle))
                    elif "point_cloud" in datum["datum"]:
                        lidar = _DgpLidar(name, datum["datum"]["point_cloud"], _seconds(datum), _pose(datum), rig[name])
                        lidars.append(lidar)
                        self._add_boxes(lidar, classes)
                except WRONG_VALUES as error:
                    self.log.problems.append(
                        f"{self.file.name}: {name} of sample {number} left out: {what_is_wrong(error)}"
                    )
        # Without a lidar, vehicle poses are those at the times of the first camera.
        stamps = [(each.time_s, each.to_world @ invert_pose(each.sensor.to_vehicle)) for each in lidars]
        self.log.stamps = stamps or next(iter(camera_stamps.values()), [])
        self.log.scans, self.log.scan_count = self._scans(lidars), len(lidars)
        return self.log.capture()

    def _named_files(self) -> Iterator[str]:
        """All file names in the scene; invalid ones are left to their readers."""
        for datum in self.data.values():
            for kind in _dict_values(datum.get("datum")):
                if isinstance(kind, dict):
                    named = [kind.get("filename"), *_dict_values(kind.get("annotations"))]
                    yield from (each for each in named if isinstance(each, str))
        yield from (f"calibration/{sample.get('calibration_key')}.json" for sample in self.samples)
        yield from (f"ontology/{name}.json" for name in _dict_values(self.values.get("ontologies")))

    def _classes(self) -> dict[int, str]:
        ontology = self.values.get("ontologies", {}).get(_BOXES_3D)
        if ontology is None:
            return {}
        try:
            items = read_json_object(self.folder / "ontology" / f"{ontology}.json")["items"]
            return {int(item["id"]): str(item["name"]) for item in items}
        except WRONG_VALUES as error:
            self.log.problems.append(f"names of classes are not known: {what_is_wrong(error)}")
            return {}

    def _view(self, datum: dict[str, Any], sensor: "DgpSensor", number: int) -> CaptureFrame:
        image, name = datum["datum"]["image"], str(datum["id"]["name"])
        file = self.folder / image["filename"]
        width, height = image_size(file)
        if (width, height) != (image["width"], image["height"]):
            raise ValueError(f"{file.name} has {width}x{height} px, expected {image['width']}x{image['height']}")
        camera = sensor.camera(width, height, invert_pose(_pose(datum)))
        return CaptureFrame(
            f"{number:04d}_{name}", camera, partial(read_color, file), _seconds(datum), name, sensor.lens()
        )

    def _add_boxes(self, lidar: "_DgpLidar", classes: dict[int, str]) -> None:
        named = lidar.cloud.get("annotations", {}).get(_BOXES_3D)
        if named is None:
            return
        rows = read_json_object(self.folder / str(named)).get("annotations", [])
        self.log.box_times_s.append(lidar.time_s)
        for row in rows:
            with self.log.omitting(f"{self.file.name}: a box of {named}", WRONG_VALUES):
                box, number = row["box"], int(row["class_id"])
                size = (float(box["length"]), float(box["width"]), float(box["height"]))
                pose, name = lidar.to_world @ named_pose(box["pose"]), classes.get(number, f"class {number}")
                self.log.boxes.append(BoxSample(str(row["instance_id"]), name, lidar.time_s, size, pose))

    def _scans(self, lidars: list["_DgpLidar"]) -> Iterator[LidarScan]:
        for lidar in lidars:
            with self.log.omitting(f"{self.file.name}: {lidar.cloud.get('filename', lidar.name)}", WRONG_VALUES):
                yield lidar.scan(self.folder)


@dataclass(frozen=True, slots=True, eq=False)
class DgpSensor:
    """A row of a calibration: pose of a sensor and intrinsics of a camera."""

    to_vehicle: Pose
    intrinsics: dict[str, Any]

    def camera(self, width: int, height: int, world_to_camera: Pose) -> Camera:
        """Camera of an image; ValueError for invalid or skewed calibrations."""
        fx, fy, cx, cy, skew = (float(self.intrinsics.get(name, 0.0)) for name in ("fx", "fy", "cx", "cy", "skew"))
        if abs(skew) > 0.5:
            raise ValueError(f"its calibration has a skew of {skew:g} px, and cameras here have none")
        return opencv_camera((fx, fy), (cx, cy), (width, height), world_to_camera)

    def lens(self) -> Lens | None:
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


def _read_calibration(file: Path) -> dict[str, DgpSensor]:
    """Sensors by name. Raises `CaptureError`."""
    values = read_json_object(file)
    try:
        rows = zip(values["names"], values["extrinsics"], values["intrinsics"], strict=True)
        return {str(name): DgpSensor(named_pose(pose), dict(lens)) for name, pose, lens in rows}
    except WRONG_VALUES as error:
        raise CaptureError(f"{file}: {what_is_wrong(error)}") from None


@dataclass(frozen=True, slots=True, eq=False)
class _DgpLidar:
    name: str
    cloud: dict[str, Any]
    time_s: float
    to_world: Pose
    sensor: DgpSensor

    def scan(self, folder: Path) -> LidarScan:
        fields = tuple(str(name) for name in self.cloud["point_format"])
        key = ArchiveFile(folder / str(self.cloud["filename"]), fields)
        turn = key.read()
        with np.errstate(over="ignore"):
            light = None if turn.intensities is None else turn.intensities.astype(np.float32)
        vehicle, to_vehicle = self.to_world @ invert_pose(self.sensor.to_vehicle), self.sensor.to_vehicle
        return LidarScan.placed(self.time_s, vehicle, to_vehicle, turn.points_m, light, key)


def _dict_values(values: Any) -> list[Any]:
    return list(values.values()) if isinstance(values, dict) else []


def _pose(datum: dict[str, Any]) -> Pose:
    """Sensor to world."""
    return named_pose(next(iter(datum["datum"].values()))["pose"])


def _seconds(datum: dict[str, Any]) -> float:
    """Time stamp in seconds of the epoch; the years of public scenes are shifted."""
    stamp = datetime.fromisoformat(datum["id"]["timestamp"])
    return (stamp.replace(tzinfo=stamp.tzinfo or UTC) - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()

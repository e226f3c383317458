"""Sensor logs of Argoverse 2: calibrations, poses, cameras, lidar and boxes.

The vehicle's frame (x forward, y left, z up) has its origin at the rear axle; the world is the city's, z up. Pictures
are undistorted, whatever coefficients their calibration states. Points of a turn are in the vehicle's frame at the
turn's time. Facts: Wilson et al., "Argoverse 2" (2021), the user guide, and src/av2/ of github.com/argoverse/av2-api.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from .capture import Capture, CaptureError, CaptureFrame
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, Pose, invert_pose, opencv_camera, rigid_from_quaternion
from .io.feather import feather_column, feather_words, read_feather
from .io.images import image_size, images_in, read_color
from .io.sweep_files import FeatherFile

POSES, INTRINSICS = "city_SE3_egovehicle.feather", "calibration/intrinsics.feather"
_MOUNTS, _BOXES = "calibration/egovehicle_SE3_sensor.feather", "annotations.feather"
_LIDAR = "up_lidar"
_ROAD_M = -0.33  # height of the road below the rear axle
_NS, _MARGIN_NS = 1e-9, 10**9
_LOG = "a log of Argoverse 2"


def recognizes_argoverse2(path: Path) -> bool:
    """Return whether a path is the folder of one log."""
    return (path / POSES).is_file() and (path / INTRINSICS).is_file()


def read_argoverse2(path: Path) -> Capture:
    """Read a log. Raises `CaptureError`."""
    return _Log(path).capture()


class _Log:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = DrivingLog(path.resolve().name, road_m=_ROAD_M)
        self.vehicles = self._vehicles()
        mounts = _Table(path / _MOUNTS)
        self.mounts = {name: mounts.pose(row) for row, name in enumerate(mounts.words("sensor_name"))}

    def capture(self) -> Capture:
        self._add_views()
        files = sorted((self.path / "sensors" / "lidar").glob("*.feather"))
        self.log.scans, self.log.scan_count = self._scans(files), len(files)
        times = [round(view.time_s / _NS) for view in self.log.views]
        span = (min(times, default=0) - _MARGIN_NS, max(times, default=0) + _MARGIN_NS)
        self.log.stamps = [(t * _NS, pose) for t, pose in self.vehicles.items() if span[0] <= t <= span[1]]
        if (self.path / _BOXES).is_file():
            with self.log.omitting(_BOXES):
                self._add_boxes()
        return self.log.capture()

    def _vehicles(self) -> dict[int, Pose]:
        """Vehicle to world, by nanoseconds."""
        table = _Table(self.path / POSES)
        poses: dict[int, Pose] = {}
        for row, time_ns in enumerate(table.numbers("timestamp_ns").tolist()):
            with self.log.omitting(f"row {row} of {POSES}"):
                poses[int(time_ns)] = table.pose(row)
        return poses

    def _vehicle(self, time_ns: int) -> Pose:
        if time_ns not in self.vehicles:
            raise ValueError(f"its time is not in {POSES}")
        return self.vehicles[time_ns]

    def _mount(self, sensor: str) -> Pose:
        if sensor not in self.mounts:
            raise ValueError(f"it is not in {_MOUNTS}")
        return self.mounts[sensor]

    def _add_views(self) -> None:
        lenses = _Table(self.path / INTRINSICS)
        rows = {name: row for row, name in enumerate(lenses.words("sensor_name"))}
        folder = self.path / "sensors" / "cameras"
        for sensor in sorted(each.name for each in folder.iterdir() if each.is_dir()) if folder.is_dir() else ():
            with self.log.omitting(sensor):
                if sensor not in rows:
                    raise ValueError(f"it is not in {INTRINSICS}")
                fx, fy, cx, cy, *size = (
                    float(lenses.numbers(f"{name}_px")[rows[sensor]])
                    for name in ("fx", "fy", "cx", "cy", "width", "height")
                )
                mount = self._mount(sensor)
                for number, file in enumerate(images_in(folder / sensor)):
                    with self.log.omitting(f"{sensor}/{file.name}"):
                        time_ns = _time_of(file)
                        found = image_size(file)
                        if found != tuple(size):
                            expected = f"{size[0]:.0f}x{size[1]:.0f}"
                            raise ValueError(f"has {found[0]}x{found[1]} px, expected {expected}")
                        to_camera = invert_pose(self._vehicle(time_ns) @ mount)
                        camera = opencv_camera((fx, fy), (cx, cy), found, to_camera)
                        view = CaptureFrame(
                            f"{number:04d}_{sensor}", camera, partial(read_color, file), time_ns * _NS, sensor
                        )
                        self.log.views.append(view)
        self.log.views.sort(key=lambda view: (view.time_s, view.sensor))

    def _scans(self, files: list[Path]) -> Iterator[LidarScan]:
        for file in files:
            with self.log.omitting(f"lidar/{file.name}"):
                time_ns, (x, y, z) = _time_of(file), self._mount(_LIDAR)[:3, 3].tolist()
                vehicle, key = self._vehicle(time_ns), FeatherFile(file, origin_m=(x, y, z))
                turn = key.read()
                assert turn.intensities is not None
                light = np.asarray(turn.intensities, np.float32)
                yield LidarScan(time_ns * _NS, vehicle, turn.points_m, np.array([x, y, z]), light, key)

    def _add_boxes(self) -> None:
        table = _Table(self.path / _BOXES)
        times = table.numbers("timestamp_ns").tolist()
        ids, classes = table.words("track_uuid"), table.words("category")
        sizes = np.stack([table.numbers(f"{name}_m") for name in ("length", "width", "height")], axis=1)
        self.log.box_times_s = [time_ns * _NS for time_ns in sorted(set(times))]
        for row, time_ns in enumerate(times):
            with self.log.omitting(f"box {row} of {_BOXES}"):
                size = (float(sizes[row, 0]), float(sizes[row, 1]), float(sizes[row, 2]))
                pose = self._vehicle(time_ns) @ table.pose(row)
                self.log.boxes.append(BoxSample(ids[row], classes[row], time_ns * _NS, size, pose))


class _Table:
    """Table of a log, whose rows may be poses. Everything raises `CaptureError`."""

    def __init__(self, file: Path) -> None:
        self.file, self._table = file, read_feather(file, _LOG)
        self._columns: dict[str, Shaped[np.ndarray, " n"]] = {}

    def numbers(self, name: str) -> Any:
        if name not in self._columns:
            self._columns[name] = feather_column(self._table, name, self.file)
        return self._columns[name]

    def words(self, name: str) -> list[str]:
        return feather_words(self._table, name, self.file)

    def pose(self, row: int) -> Pose:
        values = [float(self.numbers(name)[row]) for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")]
        try:
            return rigid_from_quaternion(values[:4], values[4:])
        except ValueError as error:
            raise CaptureError(f"{self.file}: row {row}: {error}") from None


def _time_of(file: Path) -> int:
    """Nanoseconds in the name of a file."""
    if not file.stem.isdecimal() or len(file.stem) > 19:
        raise ValueError("its name is no time in nanoseconds")
    return int(file.stem)

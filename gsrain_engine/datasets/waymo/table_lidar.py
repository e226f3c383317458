"""Lidar of Waymo's second release: rows of range images and of the poses of their pixels, as points."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from ..capture import CaptureError
from ..driving_record import Scan
from ..files.parquet_file import ParquetFile
from ..files.reading_errors import WRONG_VALUES, what_is_wrong
from ..geometry.rigid_poses import rigid_from_numbers
from ..named_problems import some_names
from .range_image import LASERS, WaymoLaser

_US = 1e-6
_TIME, _LASER = "key.frame_timestamp_micros", "key.laser_name"
_RETURNS = ("[LiDARComponent].range_image_return1", "[LiDARComponent].range_image_return2")
_PIXEL_POSE = "[LiDARPoseComponent].range_image_return1"


@dataclass(frozen=True, slots=True, eq=False)
class WaymoTableLidar:
    """The lidars of one segment; `problems` takes what is wrong with their rows."""

    root: Path
    segment: str
    poses: dict[int, Float64[np.ndarray, "4 4"]]
    """Vehicle to world of each frame, by its time stamp in microseconds."""
    problems: list[str]

    @property
    def is_there(self) -> bool:
        """Whether the segment's range images were downloaded."""
        return self._file("lidar").path.is_file()

    def lasers(self) -> dict[int, WaymoLaser]:
        """Calibrations by the numbers of lidars. Raises `CaptureError`."""
        column = "[LiDARCalibrationComponent]."
        names = [f"{column}{name}" for name in ("extrinsic.transform", "beam_inclination.min", "beam_inclination.max")]
        values = f"{column}beam_inclination.values"
        lasers: dict[int, WaymoLaser] = {}
        for row in self._file("lidar_calibration").rows([_LASER, *names], [values]):
            try:
                beams = np.asarray(row[values] if row[values] is not None else (), np.float64)
                ends = np.array([row[names[1]], row[names[2]]], np.float64)
                place = rigid_from_numbers(row[names[0]])
                lasers[int(row[_LASER])] = WaymoLaser(place, beams if len(beams) else ends, not len(beams))
            except WRONG_VALUES as error:
                self.problems.append(f"lidar {LASERS.get(row[_LASER])} left out: {what_is_wrong(error)}")
        return lasers

    def scans(self, lasers: dict[int, WaymoLaser]) -> Iterator[Scan]:
        """One scan of all lidars for each frame, in the order of the file."""
        pixel_poses = _PixelPoses(self._file("lidar_pose"))
        top = lasers.get(1) or next(iter(lasers.values()))
        columns = [f"{name}.{part}" for name in _RETURNS for part in ("values", "shape")]
        wrong: dict[str, list[str]] = defaultdict(list)
        rows = self._file("lidar").rows([_TIME, _LASER, *columns[:2]], columns[2:])
        try:
            for time, of_frame in groupby(rows, lambda row: row[_TIME]):
                clouds: list[Float64[np.ndarray, "p 3"]] = []
                lights: list[Float32[np.ndarray, " p"]] = []
                for row in of_frame:
                    try:
                        if time not in self.poses or row[_LASER] not in lasers:
                            raise ValueError("the vehicle's pose of its frame or its calibration is missing")
                        pose, laser = self.poses[time], lasers[row[_LASER]]
                        poses = pixel_poses.of(time, row[_LASER])
                        for name in _RETURNS:
                            image = _image(row, name)
                            if image is not None:
                                points, light = laser.points(image, poses, pose)
                                clouds.append(points)
                                lights.append(light)
                    except WRONG_VALUES as error:
                        wrong[what_is_wrong(error)].append(f"lidar {LASERS.get(row[_LASER])} at {time}")
                if clouds:
                    points, light = np.concatenate(clouds), np.concatenate(lights)
                    yield Scan(time * _US, self.poses[time], points, top.to_vehicle[:3, 3], light)
        except CaptureError as error:
            self.problems.append(f"the rest of the lidar left out: {error}")
        self.problems.extend(f"{some_names(names)} left out: {why}" for why, names in wrong.items())

    def _file(self, component: str) -> ParquetFile:
        return ParquetFile(self.root / component / f"{self.segment}.parquet")


class _PixelPoses:
    """Rows of lidar_pose, read along with those of lidar."""

    def __init__(self, file: ParquetFile) -> None:
        columns = [_TIME, _LASER, f"{_PIXEL_POSE}.values", f"{_PIXEL_POSE}.shape"]
        self._rows = file.rows(columns) if file.path.is_file() else iter(())
        self._waiting: dict[tuple[int, int], Float32[np.ndarray, "h w c"] | None] = {}
        self._lasers: set[int] = set()

    def of(self, time: int, laser: int) -> Float32[np.ndarray, "h w c"] | None:
        """Poses of a lidar's pixels; None for a lidar that has none, as all but the one on the roof."""
        if (time, laser) not in self._waiting and (laser == 1 or laser in self._lasers):
            for row in self._rows:
                key = (row[_TIME], row[_LASER])
                self._lasers.add(key[1])
                self._waiting[key] = _image(row, _PIXEL_POSE)
                if key == (time, laser):
                    break
        return self._waiting.pop((time, laser), None)


def _image(row: dict[str, Any], name: str) -> Float32[np.ndarray, "h w c"] | None:
    """A range image of a row; ValueError where its numbers and its shape disagree."""
    values, shape = row[f"{name}.values"], row[f"{name}.shape"]
    if values is None or not len(values):
        return None
    sides = tuple(int(side) for side in shape)
    if len(sides) != 3 or min(sides) < 1 or int(np.prod(sides)) != len(values):
        raise ValueError(f"a range image of {len(values)} numbers says that its shape is {sides}")
    return np.asarray(values, np.float32).reshape(sides)

"""KITTI's text files of calibrations and poses, and cameras of its projection matrices.

Facts: Geiger et al., "Vision meets Robotics: The KITTI Dataset" (2013), and the readme of its development kit.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.untrusted.limits import read_file

from ..capture import CaptureError, View
from ..files.picture_file import picture_size, read_color
from ..geometry.opencv_camera import opencv_camera_of_matrix
from ..geometry.rigid_poses import moved_to

Calibration = dict[str, Float64[np.ndarray, " _"]]
"""Numbers of each line of a file, by its name."""

_MAX_TEXT_BYTES = 1 << 28
_LARGEST = 1e12
"""Larger numbers are those of damaged files."""

IMU_HEIGHT_M, CAMERA_HEIGHT_M = 0.93, 1.65
"""Of the recording car's sensors above the road (figure 3 of the paper)."""


def read_calibration(file: Path) -> Calibration:
    """Read lines of `name: numbers`; lines of other things are left out. Raises `CaptureError`."""
    values: Calibration = {}
    for line in read_text(file).splitlines():
        name, _, rest = line.partition(":")
        try:
            values[name.strip()] = np.array([float(word) for word in rest.split()], np.float64)
        except ValueError:
            continue  # a date, or the time of day of the calibration
    return values


def numbers_of(values: Calibration, name: str, count: int, file: Path) -> Float64[np.ndarray, " n"]:
    """Numbers of one name; `CaptureError` where there are none or others than `count`."""
    found = values.get(name)
    if found is None or len(found) != count or not np.abs(found).max(initial=0) < _LARGEST:
        has = "no such line" if found is None else f"{len(found)} numbers"
        raise CaptureError(f"{file}: expected {count} finite numbers at {name}, it has {has}")
    return found


def read_text(file: Path) -> str:
    """Read a text file; `CaptureError` where it can't be."""
    try:
        return read_file(file, _MAX_TEXT_BYTES).decode("utf-8")
    except FileNotFoundError:
        raise CaptureError(f"{file}: no such file") from None
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise CaptureError(f"{file}: can't be read ({error})") from None


@dataclass(frozen=True, slots=True, eq=False)
class KittiCamera:
    """A rectified camera: its 3x4 projection of points in the frame of the first camera, rectified."""

    name: str
    projection: Float64[np.ndarray, "3 4"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.projection).all() or abs(np.linalg.det(self.projection[:, :3])) < 1e-9:
            raise ValueError("its projection matrix is not one of a camera")

    @property
    def from_first(self) -> Float64[np.ndarray, "4 4"]:
        """First camera to this one: a shift along the baseline."""
        return moved_to(np.linalg.solve(self.projection[:, :3], self.projection[:, 3]))

    def view(self, file: Path, name: str, time_s: float, world_to_first: Float64[np.ndarray, "4 4"]) -> View:
        """One picture, with a lens that rectification has straightened; raises `CaptureError` or ValueError."""
        pose = self.from_first @ world_to_first
        camera = opencv_camera_of_matrix(self.projection, picture_size(file), pose)
        return View(name, camera, partial(read_color, file), time_s, self.name)


def read_velodyne(file: Path) -> tuple[Float32[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]:
    """Points (m, x forward, y left, z up) and reflectances (0..1) of a .bin; raises `CaptureError`."""
    try:
        data = read_file(file)
    except OSError as error:
        raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
    if len(data) % 16 or not data:
        raise CaptureError(f"{file}: {len(data)} bytes are not rows of 4 numbers")
    rows = np.frombuffer(data, np.float32).reshape(-1, 4)
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])

"""RainSense as a capture: one sequence with its lidar and its boxes, or the pictures of the whole data set.

Beside what sequence.py reads: context/calib_lid_to_cam.txt (4x4, metres), lidar/frame_NNN.csv with X, Y, Z and
Reflectivity, and label/label_NNN.txt, a line a thing in KITTI's form (camera axes, turn about y).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from gsrain_engine.untrusted.limits import read_file

from ..capture import Capture, CaptureError, Sweep, TrackedBox
from ..geometry.box_tracks import BoxSample, tracked_boxes
from ..geometry.rigid_poses import rigid, transformed
from ..named_problems import some_names
from .sequence import RainSequence, find_rain_sequences, read_numbers, read_rain_sequence

_INTENSITY = "context/rainfall_intensity.txt"
_DEPTHS = ("", "*/", "*/*/", "*/*/*/")
_LABEL_WORDS = 15
_FARTHEST_M = 1e6
_NOTED_SKEW, _MOST_SKEWED = 0.005, 0.1
RAIN = "rain_mm_h"
"""The attribute of each view that says how hard it rained."""


def recognizes_rainsense(path: Path) -> bool:
    """Whether a folder is a RainSense sequence, or has some up to three levels below."""
    return any(next(path.glob(f"{depth}{_INTENSITY}"), None) is not None for depth in _DEPTHS)


def read_rainsense(path: Path) -> Capture:
    """Read a sequence: pictures, lidar and boxes in the world of its still camera; or all sequences' pictures.

    Raises `CaptureError` that names the file at fault.
    """
    try:
        if (path / _INTENSITY).is_file():
            return _sequence(path, read_rain_sequence(path.resolve()))
        return _data_set(path, find_rain_sequences(path))
    except CaptureError:
        raise
    except (ValueError, OSError) as error:
        raise CaptureError(str(error)) from None


def _sequence(folder: Path, sequence: RainSequence) -> Capture:
    problems: list[str] = []
    capture = _with_rain(sequence.capture(), sequence)
    numbers = [int(file.stem.rpartition("_")[2]) for file in sequence.images]
    times = dict(zip(numbers, sequence.times_s, strict=True))
    sweeps = _sweeps(folder, sequence, times, problems)
    return replace(capture, sweeps=sweeps, boxes=_boxes(folder, sequence, times, problems), problems=tuple(problems))


def _data_set(path: Path, sequences: Sequence[RainSequence]) -> Capture:
    captures = [_with_rain(sequence.capture(), sequence) for sequence in sequences]
    views = [
        replace(view, name=f"{sequence.name.replace('/', '_')}_{view.name}", sensor=sequence.name)
        for sequence, capture in zip(sequences, captures, strict=True)
        for view in capture
    ]
    told = (
        f"{len(sequences)} sequences of several places share no world; open one of their folders for lidar and boxes."
    )
    return Capture(path.resolve().name, tuple(views), has_poses=False, problems=(told,))


def _with_rain(capture: Capture, sequence: RainSequence) -> Capture:
    """Say with each view how hard it rained."""
    rain = {RAIN: f"{sequence.intensity_mm_h:g}"}
    return replace(capture, views=tuple(replace(view, attributes=rain) for view in capture))


def _sweeps(folder: Path, sequence: RainSequence, times: dict[int, float], problems: list[str]) -> tuple[Sweep, ...]:
    """Lidar frames of the pictures' numbers, in the world of the camera."""
    files = sorted((folder / "lidar").glob("frame_*.csv"))
    if not files:
        return ()
    broken: list[str] = []
    sweeps: list[Sweep] = []
    file = folder / "context" / "calib_lid_to_cam.txt"
    try:
        to_world = sequence.camera.camera_to_world @ _lidar_to_camera(file, problems)
    except (ValueError, OSError) as error:
        problems.append(f"The lidar is left out: {error}.")
        return ()
    for file in files:
        time_s = times.get(_number(file))
        try:
            if time_s is None:
                raise CaptureError(f"{file}: no picture has its number")
            sweeps.append(_sweep(file, time_s, to_world))
        except CaptureError as error:
            broken.append(str(error))
    if broken:
        problems.append(f"{len(broken)} of {len(files)} lidar frames are left out: {some_names(broken)}.")
    return tuple(sweeps)


def _lidar_to_camera(file: Path, problems: list[str]) -> Float64[np.ndarray, "4 4"]:
    """Return the rotation nearest to what the file holds (by singular values), for its matrix is a little skewed."""
    matrix = np.array(read_numbers(file, 16)).reshape(4, 4)
    if not np.abs(matrix).max() < _FARTHEST_M:
        raise CaptureError(f"{file}: must hold a rotation and a translation on this planet")
    left, stretch, right = np.linalg.svd(matrix[:3, :3])
    off = float(np.abs(stretch - 1).max())
    if not off < _MOST_SKEWED or np.linalg.det(left @ right) < 0:
        raise CaptureError(f"{file}: must hold a rotation and a translation (it stretches by {off:.1%})")
    if off > _NOTED_SKEW:
        problems.append(
            f"{file} holds no exact rotation (it stretches by {off:.1%}); the nearest one is used, and points may lie "
            "some pixels beside what they belong to."
        )
    return rigid(left @ right, matrix[:3, 3])


def _sweep(file: Path, time_s: float, to_world: Float64[np.ndarray, "4 4"]) -> Sweep:
    try:
        rows = [line.split(",") for line in read_file(file).decode("utf-8").splitlines()[1:] if line.strip()]
        table = np.array(rows, np.float64).reshape(-1, 4)
    except (OSError, ValueError) as error:
        raise CaptureError(f"{file}: no table of X, Y, Z, Reflectivity ({error})") from None
    table = table[(np.abs(table) < _FARTHEST_M).all(axis=1)]
    points = transformed(to_world, table[:, :3]).astype(np.float32)
    return Sweep(time_s, points, to_world[:3, 3].copy(), table[:, 3].astype(np.float32))


def _boxes(
    folder: Path, sequence: RainSequence, times: dict[int, float], problems: list[str]
) -> tuple[TrackedBox, ...]:
    """Each thing of each labelled picture: RainSense doesn't say which is which from one picture to the next."""
    files = [file for file in sorted((folder / "label").glob("label_*.txt")) if _number(file) in times]
    samples: list[BoxSample] = []
    broken: list[str] = []
    for file in files:
        try:
            samples += _labelled(file, sequence, times[_number(file)])
        except (OSError, ValueError) as error:
            broken.append(f"{file}: {error}")
    if broken:
        problems.append(f"{len(broken)} of {len(files)} label files are left out: {some_names(broken)}.")
    return tracked_boxes(samples, [times[_number(file)] for file in files])


def _labelled(file: Path, sequence: RainSequence, time_s: float) -> list[BoxSample]:
    samples: list[BoxSample] = []
    for row, line in enumerate(read_file(file).decode("utf-8").splitlines()):
        words = line.split()
        if len(words) < _LABEL_WORDS:
            if words:
                raise ValueError(f"line {row + 1} has {len(words)} words, expected {_LABEL_WORDS}")
            continue
        height, width, length, x, y, z, turn = (float(word) for word in words[8:_LABEL_WORDS])
        if not max(abs(number) for number in (x, y, z, turn)) < _FARTHEST_M:
            raise ValueError(f"line {row + 1} has a place that is none")
        about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
        # KITTI: the thing's length lies along its own x, which the turn leads to the camera's axes; y is down.
        object_axes = rigid(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), np.zeros(3))
        bottom = rigid(about_y, np.array([x, y, z])) @ object_axes
        bottom[:3, 3] += bottom[:3, 2] * (height / 2)
        pose = sequence.camera.camera_to_world @ bottom
        samples.append(BoxSample(f"{file.stem}-{row}", words[0], time_s, (length, width, height), pose))
    return samples


def _number(file: Path) -> int:
    digits = file.stem.rpartition("_")[2]
    return int(digits) if digits.isdigit() else -1

"""RainSense: one sequence with its lidar and boxes, or the images of the whole dataset.

Files of a sequence besides those of `read_rain_sequence`: context/calib_lid_to_cam.txt (4x4, meters),
lidar/frame_NNN.csv with X, Y, Z and Reflectivity, and label/label_NNN.txt, one object a line in KITTI's format (camera
axes, rotation about y).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from ..scene.camera import Camera, look_at
from ..scene.lens import Lens
from .capture import Capture, CaptureError, CaptureFrame, LidarSweep, TrackedBox, omissions
from .geometry import BoxSample, Pose, opencv_camera, rigid_pose, tracked_boxes, transform_points
from .io.arrays import read_bytes, read_text
from .io.images import image_size

_INTENSITY, _INTRINSICS = Path("context/rainfall_intensity.txt"), Path("context/camera_intrinsics.txt")
_DEPTHS = ("", "*/", "*/*/", "*/*/*/")
_LABEL_WORDS = 15
_FARTHEST_M, _LATEST_S = 1e6, 1e12
_NOTED_SKEW, _MAX_SKEWED = 0.005, 0.1
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_IMAGE_NUMBER = re.compile(r"image_(\d+)\.jpg")
CAMERA_HEIGHT_M = 1.5
"""Assumed height of a sensor on a car, as in the paper; the files don't contain it."""

SEPARATE_SEQUENCES = "Its sequences of several places share no world; open one of their folders for lidar and boxes."
"""Note on a capture of all images, which matters only to those who look for lidar or boxes."""

RAIN = "rain_mm_h"
"""Attribute of each view with the rain intensity."""


def recognizes_rainsense(path: Path) -> bool:
    """Return whether a folder is a RainSense sequence, or has some up to three levels below."""
    return any(next(path.glob(f"{depth}{_INTENSITY}"), None) is not None for depth in _DEPTHS)


def read_rainsense(path: Path) -> Capture:
    """Read a sequence (images, lidar and boxes in the world of its fixed camera) or the images of all sequences.

    Raises `CaptureError` that names the faulty file.
    """
    if (path / _INTENSITY).is_file():
        return _sequence(path, read_rain_sequence(path.resolve()))
    return _data_set(path, find_rain_sequences(path))


# Sequences
# Folders with image/image_NNN.jpg, context/camera_intrinsics.txt, context/rainfall_intensity.txt and timestamps.txt
# (IVtest-Lab/RainSense, doi 10.5281/zenodo.17231190).


@dataclass(frozen=True, slots=True, eq=False)
class RainSequence:
    """One sequence. Its camera is level in the world (meters, z up), 1.5 m above the ground, and looks along +x."""

    name: str
    """Folder below the dataset's own, such as light_rain/scene_2/case_000."""
    intensity_mm_h: float
    camera: Camera
    """Camera with its first pixel's center at (0.5, 0.5); the file has OpenCV's convention."""
    distortion: Float64[np.ndarray, "5"]
    """OpenCV's k1, k2, p1, p2, k3; the images are distorted."""
    images: tuple[Path, ...]
    times_s: tuple[float, ...]
    """Time of each image from the first time stamp."""

    def __len__(self) -> int:
        return len(self.images)

    def picture(self, number: int) -> UInt8[np.ndarray, "h w 3"]:
        """Read one image as display color (RGB). Raises `CaptureError` if it is broken or of another size."""
        return np.ascontiguousarray(self._read(number, cv2.IMREAD_COLOR)[..., ::-1])

    def gray_image(self, number: int) -> UInt8[np.ndarray, "h w"]:
        """Read one image's luma. Raises as `picture` does."""
        return self._read(number, cv2.IMREAD_GRAYSCALE)

    def capture(self, numbers: Sequence[int] | None = None) -> Capture:
        """Some or all images as a capture, read on demand."""
        lens = Lens("opencv", tuple(self.distortion.tolist()))
        rain = {RAIN: f"{self.intensity_mm_h:g}"}
        views = (
            CaptureFrame(
                self.images[k].stem, self.camera, partial(self.picture, k), self.times_s[k], lens=lens, attributes=rain
            )
            for k in (range(len(self)) if numbers is None else numbers)
        )
        return Capture(self.name, tuple(views))

    def _read(self, number: int, mode: int) -> UInt8[np.ndarray, "..."]:
        file = self.images[number]
        picture = _decoded(file, mode)
        expected = (self.camera.height, self.camera.width)
        if picture.shape[:2] != expected:
            raise CaptureError(f"{file}: {picture.shape[:2]} pixels, its sequence begins with {expected}")
        return np.asarray(picture, np.uint8)


def _sequence(folder: Path, sequence: RainSequence) -> Capture:
    problems: list[str] = []
    numbers = [int(file.stem.rpartition("_")[2]) for file in sequence.images]
    times = dict(zip(numbers, sequence.times_s, strict=True))
    sweeps = _sweeps(folder, sequence, times, problems)
    boxes = _boxes(folder, sequence, times, problems)
    return replace(sequence.capture(), sweeps=sweeps, boxes=boxes, problems=tuple(problems))


def _data_set(path: Path, sequences: Sequence[RainSequence]) -> Capture:
    views = [
        replace(view, name=f"{sequence.name.replace('/', '_')}_{view.name}", sensor=sequence.name)
        for sequence in sequences
        for view in sequence.capture()
    ]
    return Capture(path.resolve().name, tuple(views), has_poses=False, problems=(SEPARATE_SEQUENCES,))


def _sweeps(
    folder: Path, sequence: RainSequence, times: dict[int, float], problems: list[str]
) -> tuple[LidarSweep, ...]:
    """Lidar frames with the images' numbers, in the world of the camera."""
    files = sorted((folder / "lidar").glob("frame_*.csv"))
    if not files:
        return ()
    broken: list[str] = []
    sweeps: list[LidarSweep] = []
    try:
        to_camera = _lidar_to_camera(folder / "context" / "calib_lid_to_cam.txt", problems)
        to_world = sequence.camera.camera_to_world @ to_camera
    except CaptureError as error:
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
    problems += omissions(broken, f"{len(broken)} of {len(files)} lidar frames")
    return tuple(sweeps)


def _lidar_to_camera(file: Path, problems: list[str]) -> Pose:
    """Return the rotation nearest to the file's slightly skewed matrix (by singular values), and its translation."""
    matrix = np.array(_read_numbers(file, 16)).reshape(4, 4)
    if not np.abs(matrix).max() < _FARTHEST_M:
        raise CaptureError(f"{file}: must hold a rotation and a translation on this planet")
    left, stretch, right = np.linalg.svd(matrix[:3, :3])
    off = float(np.abs(stretch - 1).max())
    if not off < _MAX_SKEWED or np.linalg.det(left @ right) < 0:
        raise CaptureError(f"{file}: must hold a rotation and a translation (it stretches by {off:.1%})")
    if off > _NOTED_SKEW:
        problems.append(
            f"{file} holds no exact rotation (it stretches by {off:.1%}); the nearest one is used, and points may lie "
            "some pixels beside what they belong to."
        )
    return rigid_pose(left @ right, matrix[:3, 3])


def _sweep(file: Path, time_s: float, to_world: Pose) -> LidarSweep:
    try:
        rows = [line.split(",") for line in read_text(file).splitlines()[1:] if line.strip()]
        table = np.array(rows, np.float64).reshape(-1, 4)
    except ValueError as error:
        raise CaptureError(f"{file}: no table of X, Y, Z, Reflectivity ({error})") from None
    table = table[(np.abs(table) < _FARTHEST_M).all(axis=1)]
    points = transform_points(to_world, table[:, :3]).astype(np.float32)
    return LidarSweep(time_s, points, to_world[:3, 3].copy(), table[:, 3].astype(np.float32))


def _boxes(
    folder: Path, sequence: RainSequence, times: dict[int, float], problems: list[str]
) -> tuple[TrackedBox, ...]:
    """All objects of each labeled image as separate boxes: RainSense has no identities across images."""
    files = [file for file in sorted((folder / "label").glob("label_*.txt")) if _number(file) in times]
    samples: list[BoxSample] = []
    broken: list[str] = []
    for file in files:
        try:
            samples += _labeled(file, sequence, times[_number(file)])
        except CaptureError as error:
            broken.append(str(error))
        except ValueError as error:
            broken.append(f"{file}: {error}")
    problems += omissions(broken, f"{len(broken)} of {len(files)} label files")
    return tracked_boxes(samples, [times[_number(file)] for file in files])


def _labeled(file: Path, sequence: RainSequence, time_s: float) -> list[BoxSample]:
    samples: list[BoxSample] = []
    for row, line in enumerate(read_text(file).splitlines()):
        words = line.split()
        if len(words) < _LABEL_WORDS:
            if words:
                raise ValueError(f"line {row + 1} has {len(words)} words, expected {_LABEL_WORDS}")
            continue
        height, width, length, x, y, z, turn = (float(word) for word in words[8:_LABEL_WORDS])
        if not max(abs(number) for number in (x, y, z, turn)) < _FARTHEST_M:
            raise ValueError(f"line {row + 1} has a place that is none")
        about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
        # KITTI: the length is along the object's x axis, which the rotation maps to the camera's axes; y is down.
        object_axes = rigid_pose(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), np.zeros(3))
        bottom = rigid_pose(about_y, np.array([x, y, z])) @ object_axes
        bottom[:3, 3] += bottom[:3, 2] * (height / 2)
        pose = sequence.camera.camera_to_world @ bottom
        samples.append(BoxSample(f"{file.stem}-{row}", words[0], time_s, (length, width, height), pose))
    return samples


def _number(file: Path) -> int:
    digits = file.stem.rpartition("_")[2]
    return int(digits) if digits.isdigit() else -1


def find_rain_sequences(folder: Path) -> list[RainSequence]:
    """Read all sequences at or below a folder, by increasing intensity. Raises `CaptureError` if there is none."""
    found = sorted(file.parent.parent for file in folder.rglob(_INTENSITY.name) if file.parent.name == "context")
    if not found:
        raise CaptureError(
            f"{folder}: no RainSense sequence in it (a folder with {_INTENSITY} and image/image_000.jpg)"
        )
    sequences = [read_rain_sequence(each, each.relative_to(folder).as_posix()) for each in found]
    return sorted(sequences, key=lambda each: each.intensity_mm_h)


def read_rain_sequence(folder: Path, name: str | None = None) -> RainSequence:
    """Read a sequence's text files and list its images. Raises `CaptureError` that names the faulty file."""
    images = tuple(sorted(file for file in (folder / "image").glob("*.jpg") if _IMAGE_NUMBER.fullmatch(file.name)))
    if not images:
        raise CaptureError(f"{folder / 'image'}: no image_NNN.jpg in it")
    intensity = _read_numbers(folder / _INTENSITY, 1)[0]
    if not 0 <= intensity <= 500:
        raise CaptureError(f"{folder / _INTENSITY}: {intensity} mm/h, expected 0 to 500")
    k = _read_numbers(folder / _INTRINSICS, 14)
    first = _decoded(images[0], cv2.IMREAD_GRAYSCALE)
    eye = np.array([0.0, 0.0, CAMERA_HEIGHT_M])
    pose = look_at(eye, eye + [1.0, 0.0, 0.0], np.array([0.0, 0.0, 1.0]))
    try:
        camera = opencv_camera((k[0], k[4]), (k[2], k[5]), (first.shape[1], first.shape[0]), pose)
    except ValueError as error:
        raise CaptureError(f"{folder / _INTRINSICS}: {error}") from None
    times = _times(folder / "timestamps.txt", images)
    return RainSequence(name or folder.name, intensity, camera, np.array(k[9:14]), images, times)


def _read_numbers(file: Path, count: int) -> list[float]:
    """Read the numbers of a file of `name: values` lines and matrix rows."""
    words = [word for line in read_text(file).splitlines() for word in _NUMBER.findall(line.rpartition(":")[2])]
    if len(words) != count:
        raise CaptureError(f"{file}: {len(words)} numbers, expected {count}")
    return [float(word) for word in words]


def _decoded(file: Path, mode: int) -> UInt8[np.ndarray, "..."]:
    """Decode an image by OpenCV, as RainSense's own tools do; `CaptureError` if it is broken or truncated."""
    image_size(file)  # rejects decompression bombs and other file types first
    try:
        picture = cv2.imdecode(np.frombuffer(read_bytes(file), np.uint8), mode)
    except cv2.error:
        picture = None
    if picture is None:
        raise CaptureError(f"{file}: not a readable JPEG")
    return np.asarray(picture, np.uint8)


def _times(file: Path, images: Sequence[Path]) -> tuple[float, ...]:
    """Seconds of images by their numbers: row N belongs to image_N."""
    rows = read_text(file).split()[1:]
    numbers = [int(match[1]) for image in images if (match := _IMAGE_NUMBER.fullmatch(image.name))]
    if max(numbers) >= len(rows):
        raise CaptureError(f"{file}: {len(rows)} time stamps, expected at least {max(numbers) + 1}")
    try:
        first, *stamps = (float(rows[number].partition(",")[0]) for number in (0, *numbers))
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None
    if not all(abs(stamp) < _LATEST_S for stamp in (first, *stamps)):
        raise CaptureError(f"{file}: holds a time that is none")
    return tuple(stamp - first for stamp in stamps)

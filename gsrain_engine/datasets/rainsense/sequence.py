"""RainSense: pictures of a roadside camera that stands still in rain of known intensity.

A sequence is a folder with image/image_NNN.jpg, context/camera_intrinsics.txt, context/rainfall_intensity.txt and
timestamps.txt (IVtest-Lab/RainSense, doi 10.5281/zenodo.17231190).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.untrusted.limits import read_file

from ..capture import Capture, CaptureError, Lens, View
from ..files.picture_file import picture_size
from ..geometry.opencv_camera import opencv_camera

CAMERA_HEIGHT_M = 1.5
"""Assumed, for the files don't tell it: the height of a sensor on a car, as the paper has it."""

_INTENSITY, _INTRINSICS = Path("context/rainfall_intensity.txt"), Path("context/camera_intrinsics.txt")
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_LATEST_S = 1e12
_IMAGE_NUMBER = re.compile(r"image_(\d+)\.jpg")


@dataclass(frozen=True, slots=True, eq=False)
class RainSequence:
    """One sequence. Its camera stands level in the world (metres, z up), 1.5 m above the ground, and looks along +x."""

    name: str
    """The folder below the data set's own, such as light_rain/scene_2/case_000."""
    intensity_mm_h: float
    camera: Camera
    """Its first pixel has its centre at (0.5, 0.5), as everywhere here; the file's own numbers are OpenCV's."""
    distortion: Float64[np.ndarray, "5"]
    """OpenCV's k1, k2, p1, p2, k3; the pictures are as the lens made them."""
    images: tuple[Path, ...]
    times_s: tuple[float, ...]
    """Of each picture, from the first time stamp."""

    def __len__(self) -> int:
        return len(self.images)

    def picture(self, number: int) -> UInt8[np.ndarray, "h w 3"]:
        """Read one picture as display colour (RGB). Raises ValueError where it is broken or of another size."""
        return np.ascontiguousarray(self._read(number, cv2.IMREAD_COLOR)[..., ::-1])

    def grey(self, number: int) -> UInt8[np.ndarray, "h w"]:
        """Read one picture's luma. Raises as `picture` does."""
        return self._read(number, cv2.IMREAD_GRAYSCALE)

    def capture(self, numbers: Sequence[int] | None = None) -> Capture:
        """Some pictures, or all, as a capture; they are read when they are asked for."""
        chosen = range(len(self)) if numbers is None else numbers
        lens = Lens("opencv", tuple(self.distortion.tolist()))
        views = (
            View(self.images[k].stem, self.camera, partial(self.picture, k), self.times_s[k], lens=lens) for k in chosen
        )
        return Capture(self.name, tuple(views))

    def _read(self, number: int, mode: int) -> UInt8[np.ndarray, "..."]:
        file = self.images[number]
        picture = _decoded(file, mode)
        expected = (self.camera.height, self.camera.width)
        if picture.shape[:2] != expected:
            raise CaptureError(f"{file}: {picture.shape[:2]} pixels, its sequence begins with {expected}")
        return np.asarray(picture, np.uint8)


def find_rain_sequences(folder: Path) -> list[RainSequence]:
    """Read every sequence at or below a folder, by rising intensity. Raises ValueError where there is none."""
    found = sorted(file.parent.parent for file in folder.rglob(_INTENSITY.name) if file.parent.name == "context")
    if not found:
        raise ValueError(f"{folder}: no RainSense sequence in it (a folder with {_INTENSITY} and image/image_000.jpg)")
    sequences = [read_rain_sequence(each, each.relative_to(folder).as_posix()) for each in found]
    return sorted(sequences, key=lambda each: each.intensity_mm_h)


def read_rain_sequence(folder: Path, name: str | None = None) -> RainSequence:
    """Read what a sequence's text files say, and list its pictures. Raises ValueError that names the file at fault."""
    images = tuple(sorted(file for file in (folder / "image").glob("*.jpg") if _IMAGE_NUMBER.fullmatch(file.name)))
    if not images:
        raise ValueError(f"{folder / 'image'}: no image_NNN.jpg in it")
    intensity = read_numbers(folder / _INTENSITY, 1)[0]
    if not 0 <= intensity <= 500:
        raise ValueError(f"{folder / _INTENSITY}: {intensity} mm/h, expected 0 to 500")
    k = read_numbers(folder / _INTRINSICS, 14)
    first = _decoded(images[0], cv2.IMREAD_GRAYSCALE)
    eye = np.array([0.0, 0.0, CAMERA_HEIGHT_M])
    pose = look_at(eye, eye + [1.0, 0.0, 0.0], np.array([0.0, 0.0, 1.0]))
    try:
        camera = opencv_camera((k[0], k[4]), (k[2], k[5]), (first.shape[1], first.shape[0]), pose)
    except ValueError as error:
        raise ValueError(f"{folder / _INTRINSICS}: {error}") from None
    times = _times(folder / "timestamps.txt", images)
    return RainSequence(name or folder.name, intensity, camera, np.array(k[9:14]), images, times)


def read_numbers(file: Path, count: int) -> list[float]:
    """Read the numbers of a file of `name: values` lines and matrix rows."""
    lines = _text(file).splitlines()
    words = [word for line in lines for word in _NUMBER.findall(line.rpartition(":")[2])]
    if len(words) != count:
        raise ValueError(f"{file}: {len(words)} numbers, expected {count}")
    return [float(word) for word in words]


def _decoded(file: Path, mode: int) -> UInt8[np.ndarray, "..."]:
    """Decode a picture by OpenCV, as RainSense's own tools do; `CaptureError` where it is broken, or cut off."""
    picture_size(file)  # a bomb, or a file of another kind, is refused before
    try:
        picture = cv2.imdecode(np.frombuffer(read_file(file), np.uint8), mode)
    except cv2.error:
        picture = None
    if picture is None:
        raise CaptureError(f"{file}: not a readable JPEG")
    return np.asarray(picture, np.uint8)


def _times(file: Path, images: Sequence[Path]) -> tuple[float, ...]:
    """Seconds of pictures by their numbers: row N belongs to image_N."""
    rows = _text(file).split()[1:]
    numbers = [int(match[1]) for image in images if (match := _IMAGE_NUMBER.fullmatch(image.name))]
    if max(numbers) >= len(rows):
        raise ValueError(f"{file}: {len(rows)} time stamps, expected at least {max(numbers) + 1}")
    try:
        first, *stamps = (float(rows[number].partition(",")[0]) for number in (0, *numbers))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    if not all(abs(stamp) < _LATEST_S for stamp in (first, *stamps)):
        raise ValueError(f"{file}: holds a time that is none")
    return tuple(stamp - first for stamp in stamps)


def _text(file: Path) -> str:
    try:
        return read_file(file).decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: no text ({error})") from None

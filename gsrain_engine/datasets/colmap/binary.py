"""COLMAP's binary files: cameras.bin, images.bin, points3D.bin, all little-endian."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.untrusted.limits import read_file

from ..capture import CaptureError
from .model import PARAMETERS, ColmapCamera, ColmapImage, ColmapModel

_MODELS = tuple(PARAMETERS)
_CAMERA, _IMAGE, _POINT = struct.Struct("<IiQQ"), struct.Struct("<I7dI"), struct.Struct("<Q3d3BdQ")
_COUNT = struct.Struct("<Q")
_SEEN_BYTES, _TRACK_BYTES = 24, 8
_LONGEST_NAME = 4096


def read_colmap_binary(folder: Path) -> ColmapModel:
    """Read a model; raises `CaptureError` for a file that is cut, or whose counts don't fit into it."""
    points, colors = _points(folder / "points3D.bin")
    return ColmapModel(_cameras(folder / "cameras.bin"), _images(folder / "images.bin"), points, colors)


class _Bytes:
    """A file's bytes and how far they are read; whatever is asked for is checked against what is left."""

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            self.data = read_file(file)
        except OSError as error:
            raise CaptureError(f"{file}: can't be read ({error.strerror})") from None
        self.at = 0

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        start = self.at
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise CaptureError(f"{self.file}: is cut off at byte {len(self.data)}, {size} more were to come")
        self.at += size

    def count(self, smallest: int) -> int:
        """Read a count of records that take at least so many bytes each."""
        (count,) = self.take(_COUNT)
        if count > (len(self.data) - self.at) // smallest:
            raise CaptureError(f"{self.file}: says {count} records, its {len(self.data)} bytes can't hold them")
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise CaptureError(f"{self.file}: the image's name at byte {self.at} has no end")
        text = self.data[self.at : end]
        self.at = end + 1
        return text.decode("utf-8", errors="surrogateescape")


def _cameras(file: Path) -> dict[int, ColmapCamera]:
    data = _Bytes(file)
    cameras: dict[int, ColmapCamera] = {}
    for _ in range(data.count(_CAMERA.size)):
        id_, model, width, height = data.take(_CAMERA)
        if not 0 <= model < len(_MODELS):
            raise CaptureError(f"{file}: camera {id_} has model number {model}, known are 0..{len(_MODELS) - 1}")
        parameters = data.take(struct.Struct(f"<{PARAMETERS[_MODELS[model]]}d"))
        cameras[id_] = ColmapCamera(id_, _MODELS[model], width, height, parameters)
    return cameras


def _images(file: Path) -> tuple[ColmapImage, ...]:
    data = _Bytes(file)
    images: list[ColmapImage] = []
    for _ in range(data.count(_IMAGE.size + 1 + _COUNT.size)):
        _, qw, qx, qy, qz, tx, ty, tz, camera_id = data.take(_IMAGE)
        images.append(ColmapImage(data.name(), camera_id, (qw, qx, qy, qz), (tx, ty, tz)))
        data.skip(data.count(_SEEN_BYTES) * _SEEN_BYTES)
    return tuple(images)


def _points(file: Path) -> tuple[Float64[np.ndarray, "p 3"], UInt8[np.ndarray, "p 3"]]:
    if not file.is_file():
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    data = _Bytes(file)
    count = data.count(_POINT.size)
    points, colors = np.empty((count, 3)), np.empty((count, 3), np.uint8)
    for k in range(count):
        _, x, y, z, r, g, b, _, length = data.take(_POINT)
        points[k] = x, y, z
        colors[k] = r, g, b
        data.skip(length * _TRACK_BYTES)
    return points, colors

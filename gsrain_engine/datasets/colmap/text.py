"""COLMAP's text files: cameras.txt, images.txt, points3D.txt."""

from collections.abc import Iterator
from io import TextIOWrapper
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.untrusted.limits import open_file

from ..capture import CaptureError
from .model import ColmapCamera, ColmapImage, ColmapModel

_MAX_TEXT_BYTES = 1 << 34


def read_colmap_text(folder: Path) -> ColmapModel:
    """Read a model; raises `CaptureError` that names the file and the line."""
    points, colors = _points(folder / "points3D.txt")
    return ColmapModel(_cameras(folder / "cameras.txt"), _images(folder / "images.txt"), points, colors)


def _cameras(file: Path) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    for number, line in _lines(file):
        if not line or line.startswith("#"):
            continue
        try:
            id_, model, width, height, *parameters = line.split()
            camera = ColmapCamera(int(id_), model, int(width), int(height), tuple(float(each) for each in parameters))
        except ValueError:
            raise _bad(file, number, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]") from None
        cameras[camera.id] = camera
    return cameras


def _images(file: Path) -> tuple[ColmapImage, ...]:
    """Each image has two lines; the second, with what was seen in it, may be empty and is passed by."""
    images: list[ColmapImage] = []
    lines = _lines(file)
    for number, line in lines:
        if not line or line.startswith("#"):
            continue
        try:
            _, qw, qx, qy, qz, tx, ty, tz, camera_id, name = line.split(maxsplit=9)
            turn, shift = (float(qw), float(qx), float(qy), float(qz)), (float(tx), float(ty), float(tz))
            images.append(ColmapImage(name, int(camera_id), turn, shift))
        except ValueError:
            raise _bad(file, number, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME") from None
        next(lines, None)
    return tuple(images)


def _points(file: Path) -> tuple[Float64[np.ndarray, "p 3"], UInt8[np.ndarray, "p 3"]]:
    rows: list[list[float]] = []
    for number, line in _lines(file) if file.is_file() else ():
        if not line or line.startswith("#"):
            continue
        try:
            row = [float(each) for each in line.split(maxsplit=7)[1:7]]
        except ValueError:
            row = []
        if len(row) != 6 or not all(0 <= color <= 255 for color in row[3:]):
            raise _bad(file, number, "POINT3D_ID X Y Z R G B ERROR TRACK[] with colours within 0..255")
        rows.append(row)
    table = np.array(rows, np.float64).reshape(-1, 6)
    return table[:, :3], table[:, 3:].astype(np.uint8)


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    try:
        with TextIOWrapper(open_file(file, _MAX_TEXT_BYTES), encoding="utf-8") as stream:
            for number, line in enumerate(stream, 1):
                yield number, line.strip()
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{file}: can't be read as text ({error})") from None


def _bad(file: Path, number: int, expected: str) -> CaptureError:
    return CaptureError(f"{file}, line {number}: expected {expected}")

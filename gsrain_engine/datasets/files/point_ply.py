"""Point clouds in PLY files, as text or binary: places, and colours where there are some."""

from io import TextIOWrapper
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats.ply_header import element_rows, read_ply_header
from gsrain_engine.untrusted.limits import InputError, open_file

from ..capture import CaptureError

_LARGEST_HEADER = 1 << 20
_MAX_TEXT_BYTES = 1 << 32
_COLORS = ("red", "green", "blue")


def read_point_ply(file: Path) -> tuple[Float64[np.ndarray, "p 3"], UInt8[np.ndarray, "p 3"] | None]:
    """Read points that are finite, and their colours (0..255); `CaptureError` that names the file where that fails."""
    try:
        with open_file(file) as stream:
            text = b"\nformat ascii" in stream.read(_LARGEST_HEADER).partition(b"end_header")[0]
        columns = _text_columns(file) if text else _binary_columns(file)
    except (InputError, SceneFormatError) as error:
        raise CaptureError(str(error)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{file}: {error}") from None
    if not all(axis in columns for axis in "xyz"):
        raise CaptureError(f"{file}: its vertices have no x, y, z")
    points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not all(name in columns for name in _COLORS):
        return points[finite], None
    colors = np.stack([columns[name] for name in _COLORS], axis=1)[finite].astype(np.float64)
    whole = colors.max(initial=0) > 1 or columns["red"].dtype.kind in "iu"
    return points[finite], np.clip(colors if whole else colors * 255, 0, 255).astype(np.uint8)


def _binary_columns(file: Path) -> dict[str, np.ndarray]:
    with open_file(file) as stream:
        elements = read_ply_header(file, stream)
        if "vertex" not in elements:
            raise CaptureError(f"{file}: a PLY of points has an element 'vertex'")
        dtype, offset = element_rows(file, elements["vertex"])
        stream.seek(offset)
        data = stream.read(elements["vertex"].nbytes)
    rows = np.frombuffer(data, dtype)
    return {name: rows[name] for name in dtype.names or ()}


def _text_columns(file: Path) -> dict[str, np.ndarray]:
    """Columns of the element vertex, which must come first; its properties must be single numbers."""
    names: list[str] = []
    count, element = 0, ""
    with TextIOWrapper(open_file(file, _MAX_TEXT_BYTES), encoding="utf-8") as stream:
        for line in stream:
            match line.split():
                case ["element", element, number] if element != "vertex" or number.isdigit():
                    count = int(number[:12]) if element == "vertex" else count
                case ["property", "list", *_] if element == "vertex":
                    raise CaptureError(f"{file}: its vertices have lists")
                case ["property", _, name] if element == "vertex":
                    names.append(name)
                case ["end_header"]:
                    break
                case _:
                    pass
        values: list[list[float]] = []
        for line in stream:
            if len(values) == count:
                break
            try:
                values.append([float(word) for word in line.split()])
            except ValueError:
                raise CaptureError(f"{file}: vertex {len(values)} holds something else than numbers") from None
    if len(values) < count or any(len(row) != len(names) for row in values):
        raise CaptureError(f"{file}: {count} vertices of {len(names)} numbers were to come, it is cut off or damaged")
    table = np.array(values, np.float64).reshape(count, len(names))
    columns = {name: table[:, k] for k, name in enumerate(names)}
    return columns

"""Files of one lidar turn each, which can be written anew with other points."""

import io
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int64, Shaped

from ..capture import CaptureError
from .arrays import read_bytes, read_npz
from .feather import encoded_feather, feather_column, read_feather

Encode = Callable[[Int64[np.ndarray, " m"], Float[np.ndarray, "m 3"], Shaped[np.ndarray, " m"] | None], bytes]


_ARRAY = "data"  # of DGP's .npz files


class StoredTurn(NamedTuple):
    """Points of a file, in the frame and the types in which they are stored."""

    points_m: Float[np.ndarray, "n 3"]
    intensities: Shaped[np.ndarray, " n"] | None
    encode: Encode
    """Returns the content of a file that has some of the rows, with other points and intensities."""


@dataclass(frozen=True, slots=True)
class SweepFile(ABC):
    """One lidar turn on disk."""

    file: Path
    origin_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), kw_only=True)
    """Position of the sensor in the frame of the points."""

    @abstractmethod
    def read(self) -> StoredTurn:
        """Read all rows; raises `CaptureError`."""


@dataclass(frozen=True, slots=True)
class RowFile(SweepFile):
    """Rows of float32 numbers: x, y, z, intensity, and others."""

    columns: int

    def read(self) -> StoredTurn:
        data = read_bytes(self.file)
        if len(data) % (4 * self.columns) or not data:
            raise CaptureError(f"{self.file}: {len(data)} bytes are not rows of {self.columns} numbers")
        rows = np.frombuffer(data, np.float32).reshape(-1, self.columns)

        def encode(kept: Any, points: Any, intensities: Any) -> bytes:
            found = rows[kept].copy()
            found[:, :3], found[:, 3] = points, intensities
            return found.tobytes()

        return StoredTurn(rows[:, :3], rows[:, 3], encode)


@dataclass(frozen=True, slots=True)
class ArchiveFile(SweepFile):
    """Array `data` of an .npz file, a column for each of `fields`: X, Y, Z and others."""

    fields: tuple[str, ...]

    def read(self) -> StoredTurn:
        rows = read_npz(self.file, _ARRAY)
        if rows.ndim != 2 or rows.shape[1] != len(self.fields):
            raise CaptureError(
                f"{self.file}: an array of {rows.shape}, expected a column for each of {' '.join(self.fields)}"
            )
        missing = [axis for axis in "XYZ" if axis not in self.fields]
        if missing:
            raise CaptureError(f"{self.file}: has no column {missing[0]}, only {' '.join(self.fields)}")
        axes = [self.fields.index(axis) for axis in "XYZ"]
        light = next((self.fields.index(name) for name in ("I", "INTENSITY") if name in self.fields), None)

        def encode(kept: Any, points: Any, intensities: Any) -> bytes:
            found = rows[kept].copy()
            found[:, axes] = points
            if light is not None:
                found[:, light] = intensities
            array, stream = io.BytesIO(), io.BytesIO()
            np.save(array, found)
            with zipfile.ZipFile(io.BytesIO(read_bytes(self.file))) as recorded, zipfile.ZipFile(stream, "w") as copy:
                for member in recorded.infolist():
                    is_data = member.filename.removesuffix(".npy") == _ARRAY
                    copy.writestr(member, array.getvalue() if is_data else recorded.read(member))
            return stream.getvalue()

        return StoredTurn(rows[:, axes].astype(np.float64), None if light is None else rows[:, light], encode)


@dataclass(frozen=True, slots=True)
class FeatherFile(SweepFile):
    """Columns x, y, z, intensity and others of an Arrow file."""

    def read(self) -> StoredTurn:
        table = read_feather(self.file, "a lidar turn of Argoverse 2")
        points = np.stack([feather_column(table, axis, self.file).astype(np.float64) for axis in "xyz"], axis=1)
        light = feather_column(table, "intensity", self.file)

        def encode(kept: Any, points: Any, intensities: Any) -> bytes:
            columns = {axis: points[:, k] for k, axis in enumerate("xyz")}
            return encoded_feather(table, kept, {**columns, "intensity": intensities}, read_bytes(self.file))

        return StoredTurn(points, light, encode)

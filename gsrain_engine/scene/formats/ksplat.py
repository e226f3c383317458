"""KSPLAT scenes (mkkellogg, https://github.com/mkkellogg/GaussianSplats3D), levels 0 to 2, and `.splat` scenes."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped

from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import read_file
from ..gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians, sh_from_color
from ._common import check_room, checked_gaussians, rounded_bytes

_HEADER_BYTES = 4096
_HEADER = struct.Struct("<BBxxIIIIHxx3fff")
"""Version, sections (capacity, used), Gaussians (capacity, used), level, scene center, range of 8-bit harmonics."""

_SECTION_BYTES = 1024
_SECTION = struct.Struct("<IIIIfHxxIIIIH")
"""Gaussians (used, capacity), Gaussians per bucket, buckets, block size, bytes per bucket, quantization range, bytes of
the section, full buckets, other buckets, SH degree.
"""

_BUCKET_BYTES = 12
_POSITION_RANGE = 32767
_HARMONICS_RANGE = 1.5  # default for a header whose range of positions or of 8-bit harmonics is 0
_LARGEST_DEGREE = 2


@dataclass(frozen=True, slots=True)
class _KsplatHeader:
    sections: int
    count: int
    level: int
    harmonics_min: float
    harmonics_max: float


@dataclass(frozen=True, slots=True)
class _KsplatSection:
    count: int
    room: int
    bucket_size: int
    buckets: int
    block_size: float
    bucket_bytes: int
    position_range: int
    unused_bytes: int
    full_buckets: int
    other_buckets: int
    sh_degree: int

    @property
    def bucket_table_bytes(self) -> int:
        """Lengths of the partially filled buckets, then the centers of all."""
        return 4 * self.other_buckets + self.bucket_bytes * self.buckets


def read_ksplat(path: Path) -> Gaussians:
    """Read a KSPLAT file; sections of different SH degree are padded with zeros to the highest.

    Layout: `SplatBuffer.js` of version 0.4.7. Raises `SceneFormatError` if the file is damaged or truncated.
    """
    data = read_file(path)
    header = _read_header(path, data)
    check_room(path, header.count, COEFFICIENTS_OF_DEGREE[_LARGEST_DEGREE])
    start = _HEADER_BYTES + _SECTION_BYTES * header.sections
    parts: list[Gaussians] = []
    found = 0
    for index in range(header.sections):
        section = _read_section(path, data, index)
        record = _record(header.level, section.sh_degree)
        end = start + section.bucket_table_bytes + record.itemsize * section.room
        if end > len(data):
            raise SceneFormatError(path, f"section {index} ends at byte {end}, the file has {len(data)}: it is cut off")
        records_start = start + section.bucket_table_bytes
        records = np.frombuffer(data, record, section.count, records_start)
        centres = _bucket_centers(path, section, data[start:records_start]) if header.level else None
        parts.append(_decode(path, header, section, records, centres))
        start, found = end, found + section.count
    if found != header.count:
        raise SceneFormatError(path, f"its sections hold {found} Gaussians, the header says {header.count}")
    return Gaussians.concatenate(parts)


def _read_header(path: Path, data: bytes) -> _KsplatHeader:
    if len(data) < _HEADER_BYTES:
        raise SceneFormatError(path, f"a KSPLAT file has at least {_HEADER_BYTES} bytes, this one has {len(data)}")
    major, minor, sections, _, _, count, level, _, _, _, low, high = _HEADER.unpack_from(data)
    if major != 0 or minor < 1:
        raise SceneFormatError(path, f"not a KSPLAT file of version 0.1 or above: its version is {major}.{minor}")
    if level > 2:
        raise SceneFormatError(path, f"compression level {level} can't be read, levels 0 to 2 can")
    if _HEADER_BYTES + _SECTION_BYTES * sections > len(data):
        raise SceneFormatError(path, f"the headers of {sections} sections don't fit into a file of {len(data)} bytes")
    low, high = low or -_HARMONICS_RANGE, high or _HARMONICS_RANGE
    if level == 2 and not low < high:
        raise SceneFormatError(path, f"8-bit harmonics must range from low to high, not from {low} to {high}")
    return _KsplatHeader(sections, count, level, low, high)


def _read_section(path: Path, data: bytes, index: int) -> _KsplatSection:
    section = _KsplatSection(*_SECTION.unpack_from(data, _HEADER_BYTES + _SECTION_BYTES * index))
    if section.count > section.room:
        raise SceneFormatError(path, f"section {index} has room for {section.room} Gaussians and holds {section.count}")
    if section.sh_degree > _LARGEST_DEGREE:
        raise SceneFormatError(path, f"section {index}: SH degree {section.sh_degree}, 0 to 2 would be right")
    return section


def _record(level: int, sh_degree: int) -> np.dtype[np.void]:
    """Type of one Gaussian, without padding between the fields."""
    mean, number = ("<f4", "<f4") if level == 0 else ("<u2", "<f2")
    harmonics = ("harmonics", ("<f4", "<f2", "u1")[level], 3 * (COEFFICIENTS_OF_DEGREE[sh_degree] - 1))
    return np.dtype([("mean", mean, 3), ("scale", number, 3), ("quaternion", number, 4), ("color", "u1", 4), harmonics])


def _bucket_centers(path: Path, section: _KsplatSection, table: bytes) -> Float32[np.ndarray, "n 3"]:
    """Center of each Gaussian's bucket: the full buckets come first."""
    if section.bucket_bytes != _BUCKET_BYTES or section.full_buckets + section.other_buckets > section.buckets:
        raise SceneFormatError(
            path,
            f"{section.full_buckets} full and {section.other_buckets} other buckets of {section.bucket_bytes} bytes "
            f"can't be: there are {section.buckets} of {_BUCKET_BYTES} bytes",
        )
    lengths = np.frombuffer(table, "<u4", section.other_buckets).astype(np.int64)
    centres = np.frombuffer(table, "<f4", 3 * section.buckets, 4 * section.other_buckets).reshape(-1, 3)
    ends = np.cumsum(np.concatenate([np.full(section.full_buckets, section.bucket_size), lengths]))
    held = int(ends[-1]) if len(ends) else 0
    if section.count > held:
        raise SceneFormatError(path, f"the buckets of a section hold {held} of its {section.count} Gaussians")
    return centres[np.searchsorted(ends, np.arange(section.count), side="right")].astype(np.float32)


def _decode(
    path: Path,
    header: _KsplatHeader,
    section: _KsplatSection,
    records: Shaped[np.ndarray, " n"],
    centres: Float32[np.ndarray, "n 3"] | None,
) -> Gaussians:
    # Damaged floats cause warnings when converted or multiplied; the checks below report them.
    with np.errstate(invalid="ignore", over="ignore"):
        means = records["mean"].astype(np.float32)
        if centres is not None:
            steps = section.position_range or _POSITION_RANGE
            means = (means - np.float32(steps)) * np.float32(section.block_size / 2 / steps) + centres
        scales = records["scale"].astype(np.float32)
        quaternions = records["quaternion"].astype(np.float32)
        sh = _decode_harmonics(header, section, records)
    return checked_gaussians(path, means, scales, quaternions, records["color"][:, 3] / np.float32(255), sh)


def _decode_harmonics(
    header: _KsplatHeader, section: _KsplatSection, records: Shaped[np.ndarray, " n"]
) -> Float32[np.ndarray, "n k 3"]:
    stored = records["harmonics"].astype(np.float32)
    if header.level == 2:
        stored = header.harmonics_min + stored / 255 * (header.harmonics_max - header.harmonics_min)
    sh = np.empty((len(records), COEFFICIENTS_OF_DEGREE[section.sh_degree], 3), np.float32)
    sh[:, 0] = (records["color"][:, :3] / np.float32(255) - np.float32(0.5)) / np.float32(SH_C0)
    for degree in range(1, section.sh_degree + 1):
        first, end = COEFFICIENTS_OF_DEGREE[degree - 1], COEFFICIENTS_OF_DEGREE[degree]
        # Channel by channel within a degree: all reds, all greens, all blues.
        band = stored[:, 3 * (first - 1) : 3 * (end - 1)].reshape(len(records), 3, end - first)
        sh[:, first:end] = band.transpose(0, 2, 1)
    return sh


# .splat
# Kevin Kwok's viewer, https://github.com/antimatter15/splat: 32 bytes per Gaussian, no header.

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])
"""Scales are linear, rgba is display color and opacity times 255, the quaternion is (w, x, y, z) * 128 + 128."""


def read_splat(path: Path) -> Gaussians:
    """Read a .splat file; the format has no spherical harmonics above degree 0.

    Raises `SceneFormatError` if the file is empty, ends inside a row, or holds invalid values.
    """
    size = path.stat().st_size
    if size == 0 or size % _ROW.itemsize:
        raise SceneFormatError(
            path, f"a .splat has {_ROW.itemsize} bytes a Gaussian; {size} bytes are no whole number of them above 0"
        )
    check_room(path, size // _ROW.itemsize, 1)
    rows = np.frombuffer(read_file(path, size), _ROW)
    quaternions = rows["quaternion"].astype(np.float32) - np.float32(128)
    rgba = rows["rgba"] / np.float32(255)
    means, scales = rows["mean"].astype(np.float32), rows["scale"].astype(np.float32)
    opacities = np.ascontiguousarray(rgba[:, 3])
    return checked_gaussians(path, means, scales, quaternions, opacities, sh_from_color(rgba[:, :3]))


def write_splat(gaussians: Gaussians, path: Path) -> None:
    """Write a .splat file, in the same order: drops harmonics above degree 0, clamps colors to 0 .. 1.

    Raises `ValueError` without Gaussians: an empty file would look damaged.
    """
    if not len(gaussians):
        raise ValueError("a .splat has no header and thus at least one Gaussian; there is none to write")
    rows = np.empty(len(gaussians), _ROW)
    rows["mean"] = gaussians.means
    rows["scale"] = gaussians.scales
    rows["rgba"][:, :3] = rounded_bytes((gaussians.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)) * 255)
    rows["rgba"][:, 3] = rounded_bytes(gaussians.opacities * 255)
    rows["quaternion"] = rounded_bytes(gaussians.quaternions * 128 + 128)
    path.write_bytes(rows.tobytes())

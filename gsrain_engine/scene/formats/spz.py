"""SPZ scenes (Niantic Labs, https://github.com/nianticlabs/spz), versions 1 to 4; written as version 4."""

import logging
import struct
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import zstandard
from jaxtyping import Float32

from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import read_file
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ._common import (
    COARSE_SHARE,
    check_plausible,
    check_room,
    checked_gaussians,
    gunzip,
    gunzip_start,
    rounded_bytes,
    unzstd,
    with_largest,
    without_largest,
)

logger = logging.getLogger("gsrain")
_MAGIC = b"NGSP"
_GZIP_MAGIC = b"\x1f\x8b"
_HEADER = struct.Struct("<4sIIBBBB")
"""Magic, version, number of Gaussians, SH degree, fractional bits, flags, number of streams (0 before version 4)."""

_CONTENTS_OFFSET = struct.Struct("<I12x")  # follows the header in version 4: offset of the table of contents
_STREAM_SIZES = struct.Struct("<QQ")  # one entry of that table: compressed and unpacked size of a stream in bytes
_ANTIALIASED_FLAG, _EXTENSIONS_FLAG = 1, 2
_EXTENSIONS_BYTES = 2**20
"""Largest size of vendor extensions, camera limits and the like, which are ignored but for the axes of version 4. They
follow the Gaussians in versions 2 and 3, and the header in version 4.
"""

_EXTENSION = struct.Struct("<II")  # kind and length in bytes of one extension of version 4
_AXES_EXTENSION = 0xADBE0003  # SPZ_ADOBE_coordinate_system
_KNOWN_AXES = (0, 4)  # not specified, and right, up, back: the axes of files without that extension
_ZSTD_LEVEL = 9  # 19 saves 1 % and takes ten times as long

_FRACTIONAL_BITS = 23  # maximum for a 24-bit fixed-point coordinate with sign
_WRITTEN_FRACTIONAL_BITS = 16  # finest step written: 15 micrometers for a scene in meters
_BITS = range(_WRITTEN_FRACTIONAL_BITS, -1, -1)
_LARGEST_FIXED = (1 << 23) - 1
_FEW = 0.01  # share of Gaussians that may be moved closer
_COLOR_SCALE = 0.15  # SPZ stores sh[0] * 0.15 + 0.5 as color, so that the range is -0.44 to 1.44 instead of 0 to 1
_POINT_FLIP = np.array([1, -1, -1], np.float32)
_XYZW_FLIP = np.array([1, -1, -1, 1], np.float32)
_SH_FLIP = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
"""SPZ axes are right, up, back; those of PLY and of `Gaussians` right, down, front: half a turn about x.

It negates y and z, and every harmonic that is odd in y and z together.
"""

_SCALES = np.exp(np.arange(256, dtype=np.float32) / 16 - 10)
_OPACITIES = np.arange(256, dtype=np.float32) / 255
_BASE_SH = ((np.arange(256) / 255 - 0.5) / _COLOR_SCALE).astype(np.float32)
_REST_ZERO, _REST_STEP = np.float32(128), np.float32(1 / 128)
"""Byte for 0, and step, of harmonics above degree 0; the step is a power of 2, so that nothing rounds."""


@dataclass(frozen=True, slots=True)
class _SpzHeader:
    version: int
    count: int
    sh_degree: int
    fractional_bits: int
    flags: int
    streams: int

    @property
    def coefficients(self) -> int:
        return COEFFICIENTS_OF_DEGREE[self.sh_degree]

    @property
    def stream_sizes(self) -> dict[str, int]:
        """Bytes of every attribute, in file order."""
        sizes = {
            "means": 6 if self.version == 1 else 9,
            "opacities": 1,
            "colors": 3,
            "scales": 3,
            "quaternions": 3 if self.version <= 2 else 4,
            "spherical harmonics": 3 * (self.coefficients - 1),
        }
        return {name: size * self.count for name, size in sizes.items()}


def read_spz(path: Path) -> Gaussians:
    """Read an SPZ file of version 1, 2, 3 (gzip or uncompressed) or 4 (zstd), converted to PLY axes.

    Raises `SceneFormatError` if the file is damaged or has a version above 4 or an SH degree above 3.
    """
    data = read_file(path)
    count, degree = spz_size(path, data)
    check_room(path, count, COEFFICIENTS_OF_DEGREE[degree])
    return decode_spz(path, data)


def decode_spz(path: Path, data: bytes) -> Gaussians:
    """Decode the bytes of an SPZ file, which may be part of the file at `path`; see `read_spz`."""
    gzipped = data.startswith(_GZIP_MAGIC)
    header = _read_header(path, gunzip_start(path, data, _HEADER.size) if gzipped else data)
    if gzipped and header.version >= 4:
        raise SceneFormatError(path, f"SPZ version {header.version} inside gzip: only versions 1 to 3 are gzipped")
    streams = _zstd_streams(path, data, header) if header.version >= 4 else _plain_streams(path, data, header)
    return replace(_decode(path, header, streams), antialiased=bool(header.flags & _ANTIALIASED_FLAG))


def spz_size(path: Path, data: bytes | memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree in the bytes of an SPZ file, which may be part of the file at `path`.

    Raises `SceneFormatError` if its header is damaged or speaks of more than the bytes can hold.
    """
    is_gzip = bytes(data[:2]) == _GZIP_MAGIC
    header = _read_header(
        path, gunzip_start(path, bytes(data), _HEADER.size) if is_gzip else bytes(data[: _HEADER.size])
    )
    check_plausible(path, header.count, header.coefficients, len(data))
    return header.count, header.sh_degree


def write_spz(gaussians: Gaussians, path: Path) -> None:
    """Write an SPZ file to exactly this path, not atomically; see `encode_spz` for version, losses and errors."""
    path.write_bytes(encode_spz(gaussians))


def encode_spz(gaussians: Gaussians) -> bytes:
    """Encode Gaussians, in PLY axes, as SPZ version 4: a header, a table of contents, a zstd frame per attribute.

    Harmonics keep 8 bits and means up to 16 fractional bits, more than in Niantic's own writer, in files that are
    larger by a third: the step is 1/128 for harmonics, 1/16 for log scales. Values outside SPZ's ranges are clamped:
    scales to e^-10 .. e^5.9, harmonics above degree 0 to -1 .. 127/128. All means have one step; a few that are so far
    out that it would show are moved towards the origin and made smaller, so that they look the same from there.

    Raises `ValueError` if a mean is not finite or farther out than 2^23 units.
    """
    gaussians, fractional_bits = _with_step(gaussians)
    streams = [
        _encode_means(gaussians.means, fractional_bits),
        rounded_bytes(gaussians.opacities * 255).tobytes(),
        rounded_bytes((gaussians.sh[:, 0] * _COLOR_SCALE + 0.5) * 255).tobytes(),
        rounded_bytes((np.log(np.maximum(gaussians.scales, 1e-10)) + 10) * 16).tobytes(),
        _encode_quaternions(gaussians.quaternions),
    ]
    if gaussians.sh_degree:
        streams.append(_encode_rest(gaussians.sh))
    flags = _ANTIALIASED_FLAG if gaussians.antialiased else 0
    header = _HEADER.pack(_MAGIC, 4, len(gaussians), gaussians.sh_degree, fractional_bits, flags, len(streams))
    compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
    frames = [compressor.compress(stream) for stream in streams]
    table = [_STREAM_SIZES.pack(len(frame), len(stream)) for frame, stream in zip(frames, streams, strict=True)]
    offset = _CONTENTS_OFFSET.pack(_HEADER.size + _CONTENTS_OFFSET.size)
    return b"".join((header, offset, *table, *frames))


def _read_header(path: Path, start: bytes) -> _SpzHeader:
    if len(start) < _HEADER.size:
        raise SceneFormatError(path, f"an SPZ file has a header of {_HEADER.size} bytes, this one has {len(start)}")
    magic, *values = _HEADER.unpack_from(start)
    header = _SpzHeader(*values)
    if magic != _MAGIC:
        raise SceneFormatError(path, f"not an SPZ file: it starts with {magic!r} where {_MAGIC!r} belongs")
    if not 1 <= header.version <= 4:
        raise SceneFormatError(path, f"SPZ version {header.version} can't be read, versions 1 to 4 can")
    if header.sh_degree >= len(COEFFICIENTS_OF_DEGREE):
        raise SceneFormatError(path, f"SH degree {header.sh_degree} can't be read, degrees 0 to 3 can")
    if header.fractional_bits > _FRACTIONAL_BITS:
        raise SceneFormatError(path, f"{header.fractional_bits} fractional bits, at most {_FRACTIONAL_BITS} can be")
    return header


def _plain_streams(path: Path, data: bytes, header: _SpzHeader) -> dict[str, bytes]:
    """Attributes of versions 1 to 3, which follow one another."""
    sizes = header.stream_sizes
    expected = _HEADER.size + sum(sizes.values())
    extensions = _EXTENSIONS_BYTES if header.flags & _EXTENSIONS_FLAG else 0
    if data.startswith(_GZIP_MAGIC):
        data = gunzip(path, data, expected + extensions)
    if not expected <= len(data) <= expected + extensions:
        raise SceneFormatError(
            path, f"{header.count} Gaussians of SH degree {header.sh_degree} take {expected} bytes, not {len(data)}"
        )
    ends = np.cumsum([_HEADER.size, *sizes.values()]).tolist()
    return {name: data[start:end] for name, start, end in zip(sizes, ends[:-1], ends[1:], strict=True)}


def _zstd_streams(path: Path, data: bytes, header: _SpzHeader) -> dict[str, bytes]:
    """Attributes of version 4: a zstd frame each, listed in a table of contents."""
    sizes = header.stream_sizes
    if header.sh_degree == 0 and header.streams == len(sizes) - 1:
        del sizes["spherical harmonics"]
    if header.streams != len(sizes):
        raise SceneFormatError(path, f"{header.streams} streams, {len(sizes)} would be right")
    listed = _table_of_contents(path, data, header)
    streams: dict[str, bytes] = {}
    for (name, size), (start, end, unpacked_size) in zip(sizes.items(), listed, strict=True):
        if unpacked_size != size:
            raise SceneFormatError(path, f"the stream of {name} must hold {size} bytes, the file says {unpacked_size}")
        streams[name] = unzstd(path, data[start:end], size, name)
    return {"spherical harmonics": b"", **streams}


def _table_of_contents(path: Path, data: bytes, header: _SpzHeader) -> list[tuple[int, int, int]]:
    """Start, end and unpacked size of every stream."""
    streams = header.streams
    table = _HEADER.size + _CONTENTS_OFFSET.size
    if len(data) >= table:
        table = _CONTENTS_OFFSET.unpack_from(data, _HEADER.size)[0]
    start = table + streams * _STREAM_SIZES.size
    if table < _HEADER.size + _CONTENTS_OFFSET.size or start > len(data):
        raise SceneFormatError(path, f"the table of contents at byte {table} is outside the file's {len(data)} bytes")
    if header.flags & _EXTENSIONS_FLAG:
        _check_axes(path, data[_HEADER.size + _CONTENTS_OFFSET.size : table][:_EXTENSIONS_BYTES])
    listed: list[tuple[int, int, int]] = []
    for packed_size, unpacked_size in _STREAM_SIZES.iter_unpack(data[table:start]):
        listed.append((start, start + packed_size, unpacked_size))
        start += packed_size
    if start > len(data):
        raise SceneFormatError(path, f"the streams take {start} bytes, the file has {len(data)}: it is cut off")
    return listed


def _check_axes(path: Path, extensions: bytes) -> None:
    """Reject a file that an extension says to have other axes than SPZ's."""
    offset = 0
    while offset + _EXTENSION.size <= len(extensions):
        kind, size = _EXTENSION.unpack_from(extensions, offset)
        offset += _EXTENSION.size
        if kind == _AXES_EXTENSION:
            axes = int.from_bytes(extensions[offset : offset + 4], "little")
            if axes not in _KNOWN_AXES:
                raise SceneFormatError(path, f"its axes (SPZ_ADOBE_coordinate_system) must be 4, RUB, not {axes}")
        offset += size


def _decode(path: Path, header: _SpzHeader, streams: dict[str, bytes]) -> Gaussians:
    n = header.count
    raw = {name: np.frombuffer(stream, np.uint8) for name, stream in streams.items()}
    sh = np.empty((n, header.coefficients, 3), np.float32)
    sh[:, 0] = _BASE_SH[raw["colors"].reshape(n, 3)]
    rest = sh.reshape(n, 3 * header.coefficients)[:, 3:]  # in place: a copy takes longer than the arithmetic
    np.subtract(raw["spherical harmonics"].reshape(rest.shape), _REST_ZERO, out=rest)
    rest *= np.repeat(_SH_FLIP[1 : header.coefficients] * _REST_STEP, 3)
    return checked_gaussians(
        path,
        _decode_means(header, streams["means"]) * _POINT_FLIP,
        _SCALES[raw["scales"].reshape(n, 3)],
        _decode_quaternions(header, streams["quaternions"]),
        _OPACITIES[raw["opacities"]],
        sh,
    )


def _decode_means(header: _SpzHeader, stream: bytes) -> Float32[np.ndarray, "n 3"]:
    if header.version == 1:
        means = np.frombuffer(stream, "<f2").astype(np.float32).reshape(header.count, 3)
        return np.where(np.isfinite(means), means, np.float32(np.nan))  # reported by the final check
    fixed = np.zeros((3 * header.count, 4), np.uint8)
    fixed[:, 1:] = np.frombuffer(stream, np.uint8).reshape(-1, 3)
    # The 24 bits are in the upper part of 32, so that the right shift extends their sign.
    integers = fixed.view("<i4").reshape(header.count, 3) >> 8
    return integers.astype(np.float32) / np.float32(1 << header.fractional_bits)


def _decode_quaternions(header: _SpzHeader, stream: bytes) -> Float32[np.ndarray, "n 4"]:
    if header.version <= 2:
        xyz = np.frombuffer(stream, np.uint8).reshape(header.count, 3).astype(np.float32) / np.float32(127.5) - 1
        xyzw = with_largest(np.full(header.count, 3), xyz)
    else:
        packed = np.frombuffer(stream, "<u4")
        # From the top: 2 bits for the largest, then a sign and 9 bits of magnitude for each of the others in order.
        fields = (packed[:, None] >> np.array([20, 10, 0], np.uint32)) & 1023
        magnitudes = (fields & 511).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
        xyzw = with_largest(packed >> 30, np.where(fields & 512, -magnitudes, magnitudes))
    return np.ascontiguousarray((xyzw * _XYZW_FLIP)[:, [3, 0, 1, 2]])  # indexing by columns gives a column-major array


def _with_step(gaussians: Gaussians) -> tuple[Gaussians, int]:
    """Gaussians that fit, and the fractional bits of the finest step for them; see `encode_spz`."""
    if not len(gaussians):
        return gaussians, _WRITTEN_FRACTIONAL_BITS
    reaches = np.abs(gaussians.means).max(axis=1)
    size = float(np.median(gaussians.scales.max(axis=1)))
    bits = next((bits for bits in _BITS if float(reaches.max()) * (1 << bits) < _LARGEST_FIXED), None)
    fine = min((bits for bits in _BITS if 2.0**-bits <= COARSE_SHARE * size), default=_WRITTEN_FRACTIONAL_BITS)
    if bits is not None and bits >= fine:
        return gaussians, bits
    if not np.isfinite(reaches).all():
        raise ValueError(f"SPZ holds means up to {_LARGEST_FIXED} units from the origin, not infinite ones or NaN")
    limit = (_LARGEST_FIXED - 1) / (1 << fine)
    far = np.flatnonzero(reaches > limit)
    if len(far) <= _FEW * len(gaussians):
        told = "SPZ: %d of %d Gaussians farther than %.4g units out were moved closer, at the same apparent size"
        logger.warning(told, len(far), len(gaussians), limit)
        means, scales = gaussians.means.copy(), gaussians.scales.copy()
        factors = (limit / reaches[far]).astype(np.float32)[:, None]
        means[far] *= factors
        scales[far] *= factors
        return replace(gaussians, means=means, scales=scales), fine
    if bits is None:
        raise ValueError(f"SPZ holds means up to {_LARGEST_FIXED} units from the origin, not {reaches.max():g}")
    told = "SPZ: means are in steps of %.3g units, most Gaussians are %.3g wide: a .ply or .glb is exact"
    logger.warning(told, 2.0**-bits, size)
    return gaussians, bits


def _encode_means(means: Float32[np.ndarray, "n 3"], fractional_bits: int) -> bytes:
    fixed = np.rint((means * _POINT_FLIP).astype(np.float64) * (1 << fractional_bits)).astype("<i4")
    return fixed.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()


def _encode_quaternions(quaternions: Float32[np.ndarray, "n 4"]) -> bytes:
    largest, others = without_largest(quaternions[:, [1, 2, 3, 0]] * _XYZW_FLIP)
    magnitudes = np.rint(np.abs(others) * np.float32(511 * np.sqrt(2))).astype(np.uint32)
    fields = np.minimum(magnitudes, 511) | np.where(others < 0, 512, 0).astype(np.uint32)
    packed = (largest.astype(np.uint32) << 30) | (fields[:, 0] << 20) | (fields[:, 1] << 10) | fields[:, 2]
    return packed.astype("<u4").tobytes()


def _encode_rest(sh: Float32[np.ndarray, "n k 3"]) -> bytes:
    n, k, _ = sh.shape
    rest = sh.reshape(n, 3 * k)[:, 3:] * np.repeat(_SH_FLIP[1:k] / _REST_STEP, 3)
    rest += _REST_ZERO
    return rounded_bytes(rest).tobytes()

"""SOG scenes of PlayCanvas: numbers in lossless images.

Source: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog
"""

import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import Meta
from PIL import Image

from ...safe_io.errors import SceneFormatError, readable_validation_error
from ...safe_io.limits import TooLargeError, read_file
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ._common import check_expansion, check_room, checked_gaussians, with_largest
from .stored_zip import open_zip, read_member

_META = "meta.json"
_STREAMED_META = "lod-meta.json"
_STREAMED_META_BYTES = 2**26  # a tree with a node for some thousand Gaussians
_META_BYTES = 2**20  # three codebooks of 256 numbers take 16 KB
_SPARE_PIXELS = 2**16  # maximum excess of pixels over Gaussians in an image; writers pad the last rows
_PALETTE_COLUMNS = 64
_FIRST_LARGEST = 252  # alpha of a quaternion's pixel: 252, 253, 254, 255 if w, x, y, z is the largest and omitted
ReadMember = Callable[[str, int], bytes]
"""Returns a file of the scene by name; raises if it is longer than the given number of bytes."""


def is_sog_folder(folder: Path) -> bool:
    """Return whether a folder has a streamed SOG scene, or its `meta.json` describes one: it has the field of means."""
    if (folder / _STREAMED_META).is_file():
        return True
    try:
        values = json.loads(read_file(folder / _META, _META_BYTES))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(values, dict) and "means" in values


def read_sog(path: Path) -> Gaussians:
    """Read a SOG scene, version 1 or 2: a `.sog` (a zip), a folder with `meta.json` and its images, or that file.

    Of a streamed scene (`lod-meta.json` and its folder), the finest level is read, and its environment. Raises
    `SceneFormatError` if it is incomplete, damaged or implausibly large.
    """
    if path.name.lower() == _STREAMED_META or (path.is_dir() and (path / _STREAMED_META).is_file()):
        return _read_streamed(path if path.is_dir() else path.parent)
    if path.is_dir() or path.name.lower() == _META:
        folder = path if path.is_dir() else path.parent
        file_bytes = sum(file.stat().st_size for file in folder.glob("*.webp"))
        return _decode(path, lambda name, most: _folder_member(path, folder / name, most), file_bytes)
    data = read_file(path)
    archive = open_zip(path, data)
    with archive:
        return _decode(path, lambda name, most: read_member(path, archive, name, most), len(data))


class _Span(msgspec.Struct, frozen=True):
    """Gaussians of one file of a streamed scene."""

    file: Annotated[int, Meta(ge=0)]
    offset: Annotated[int, Meta(ge=0)]
    count: Annotated[int, Meta(ge=0)]


class _LodNode(msgspec.Struct, frozen=True):
    children: list["_LodNode"] = []
    lods: dict[str, _Span] = {}
    """By level, of which 0 is the finest."""


class _StreamedMeta(msgspec.Struct, frozen=True):
    filenames: list[str]
    tree: _LodNode
    environment: str | None = None


def _read_streamed(folder: Path) -> Gaussians:
    """Read the finest level of each leaf of a streamed scene, as splat-transform writes them, and its environment."""
    path = folder / _STREAMED_META
    try:
        meta = msgspec.json.decode(read_file(path, _STREAMED_META_BYTES), type=_StreamedMeta)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(path, readable_validation_error(error, _StreamedMeta)) from None
    spans: dict[int, list[_Span]] = {}
    waiting = [meta.tree]
    while waiting:
        node = waiting.pop()
        waiting += reversed(node.children)
        if node.lods and not node.children:
            finest = min(node.lods, key=lambda level: (not level.isdecimal(), int(level) if level.isdecimal() else 0))
            spans.setdefault(node.lods[finest].file, []).append(node.lods[finest])
    check_room(path, sum(span.count for of_file in spans.values() for span in of_file), 1)
    parts: list[Gaussians] = []
    for number, of_file in sorted(spans.items()):
        if number >= len(meta.filenames):
            raise SceneFormatError(path, f"its tree names file {number}, filenames has {len(meta.filenames)}")
        found = read_sog(_part_of(folder, meta.filenames[number]))
        if any(span.offset + span.count > len(found) for span in of_file):
            told = f"its tree names Gaussians beyond the {len(found)} of {meta.filenames[number]}"
            raise SceneFormatError(path, told)
        parts += [found.take(slice(span.offset, span.offset + span.count)) for span in of_file]
    if meta.environment:
        parts.append(read_sog(_part_of(folder, meta.environment)))
    return Gaussians.concatenate(parts)


def _part_of(folder: Path, name: str) -> Path:
    """File of a streamed scene; it must be a SOG scene in a folder below that of the scene."""
    part = folder / name
    is_sog = part.name == _META or part.suffix == ".sog"
    if "\0" in name or not is_sog or not part.resolve().is_relative_to(folder.resolve()):
        raise SceneFormatError(folder / _STREAMED_META, f"{name[:80]!r} must be a meta.json or .sog below its folder")
    return part


def _folder_member(path: Path, file: Path, most: int) -> bytes:
    if not file.is_file():
        raise SceneFormatError(path, f"there is no file {file.name}")
    try:
        return read_file(file, most)
    except TooLargeError:
        raise SceneFormatError(path, f"{file.name} has more than {most} bytes") from None


def _decode(path: Path, read: ReadMember, file_bytes: int) -> Gaussians:
    meta = read_meta(path, read(_META, _META_BYTES))
    check_expansion(path, meta.count, 1, file_bytes)

    def pixels(name: str) -> UInt8[np.ndarray, "count 4"]:
        return _pixels(path, read, name, meta.count)

    low, high, base = map(pixels, (*meta.files.means.files, *meta.files.sh0.files))
    with np.errstate(over="ignore", invalid="ignore"):  # the final check reports infinite values
        means = _decode_means(meta.files.means, low, high)
        scales = np.exp(_looked_up(meta.log_scales, pixels(meta.files.scales.files[0])))
    sh = np.empty((meta.count, 1, 3), np.float32)
    if meta.files.shN is not None:
        sh = _decode_rest(path, read, meta, meta.files.shN.files, file_bytes)
    sh[:, 0] = _looked_up(meta.base, base)
    quaternions = _decode_quaternions(path, pixels(meta.files.quats.files[0]))
    found = checked_gaussians(path, means, scales, quaternions, meta.opacities[base[:, 3]], sh)
    return replace(found, antialiased=isinstance(meta.files, _SogVersion2) and meta.files.antialias)


def _pixels(path: Path, read: ReadMember, name: str, count: int) -> UInt8[np.ndarray, "count 4"]:
    most = count + _SPARE_PIXELS
    data = read(_file_name(path, name), 8 * most)
    width, height = lossless_webp_size(path, name, data)
    if not count <= width * height <= most:
        raise SceneFormatError(path, f"{name} has {width} x {height} pixels, not one for each of {count} Gaussians")
    return read_lossless_webp(path, name, data)[:count]


def _looked_up(codebooks: Float32[np.ndarray, "3 256"], pixels: UInt8[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 3"]:
    return np.stack([codebook[pixels[:, channel]] for channel, codebook in enumerate(codebooks)], axis=1)


# meta.json
# Version 1 is converted to the form of version 2.


def _decode_means(
    means: "_Means", low: UInt8[np.ndarray, "n 4"], high: UInt8[np.ndarray, "n 4"]
) -> Float32[np.ndarray, "n 3"]:
    steps = low[:, :3] + high[:, :3] * 256.0
    mins, maxs = np.array(means.mins), np.array(means.maxs)
    logarithms = mins + (maxs - mins) * (steps / 65535)
    return (np.sign(logarithms) * np.expm1(np.abs(logarithms))).astype(np.float32)


def _decode_quaternions(path: Path, pixels: UInt8[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 4"]:
    bad = np.flatnonzero(pixels[:, 3] < _FIRST_LARGEST)
    if len(bad):
        found = f"{len(bad)} of {len(pixels)} quaternions have an alpha below {_FIRST_LARGEST}"
        raise SceneFormatError(path, f"{found}, the first is number {bad[0]}")
    others = (pixels[:, :3] / np.float32(127.5) - 1) * np.float32(np.sqrt(0.5))
    return with_largest(pixels[:, 3] - np.uint8(_FIRST_LARGEST), others)


def _decode_rest(
    path: Path, read: ReadMember, meta: "SogMeta", files: list[str], file_bytes: int
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics with room for degree 0: row `label` of the palette, whose images have 64 entries per row."""
    centroids = _file_name(path, files[0])
    data = read(centroids, 2**24)
    width, height = lossless_webp_size(path, centroids, data)
    widths = {_PALETTE_COLUMNS * (k - 1): degree for degree, k in enumerate(COEFFICIENTS_OF_DEGREE) if degree}
    degree = widths.get(width)
    if degree is None or (meta.bands is not None and degree != meta.bands):
        right = [w for w, d in widths.items() if meta.bands in (None, d)]
        raise SceneFormatError(path, f"{centroids} is {width} pixels wide, {right} would be right")
    entries = _PALETTE_COLUMNS * height
    if not (meta.palette_count or 1) <= entries <= 2**16:
        raise SceneFormatError(path, f"{centroids} has room for {entries} entries, not {meta.palette_count}")
    coefficients = COEFFICIENTS_OF_DEGREE[degree] - 1
    check_expansion(path, meta.count, coefficients + 1, file_bytes)
    palette = np.zeros((entries, coefficients + 1, 3), np.float32)
    colors = read_lossless_webp(path, centroids, data)[:, :3].reshape(entries, coefficients, 3)
    palette[:, 1:] = meta.rest[colors]
    pixels = _pixels(path, read, files[1], meta.count)
    labels = pixels[:, 0] + pixels[:, 1].astype(np.int64) * 256
    last = (meta.palette_count or entries) - 1
    if meta.count and labels.max() > last:
        raise SceneFormatError(path, f"{files[1]} asks for palette entry {labels.max()}, the last one is {last}")
    return palette[labels]


_Triple = Annotated[list[float], Meta(min_length=3, max_length=3)]
_Codebook = Annotated[list[float | None], Meta(min_length=2, max_length=256)]
_OneFile = Annotated[list[str], Meta(min_length=1, max_length=1)]
_TwoFiles = Annotated[list[str], Meta(min_length=2, max_length=2)]
_PALETTE = 65536  # labels have 16 bits
_NO_HARMONICS = np.zeros(256, np.float32)


# Unknown fields are ignored, unlike in GSRAIN's own files: writers add their own (`asset`).
class _Means(msgspec.Struct, frozen=True):
    mins: _Triple
    maxs: _Triple
    files: _TwoFiles
    shape: list[int] = []


class _Quaternions(msgspec.Struct, frozen=True):
    files: _OneFile


class _Coded(msgspec.Struct, frozen=True):
    codebook: _Codebook
    files: _OneFile


class _CodedRest(msgspec.Struct, frozen=True):
    bands: Annotated[int, Meta(ge=1, le=3)]
    codebook: _Codebook
    files: _TwoFiles
    count: Annotated[int, Meta(ge=1, le=_PALETTE)] | None = None


class _SogVersion2(msgspec.Struct, frozen=True):
    count: Annotated[int, Meta(ge=0, lt=2**32)]
    means: _Means
    scales: _Coded
    quats: _Quaternions
    sh0: _Coded
    shN: _CodedRest | None = None  # noqa: N815 - the format's own name
    antialias: bool = False


class _Ranged(msgspec.Struct, frozen=True):
    mins: Annotated[list[float], Meta(min_length=3, max_length=4)]
    maxs: Annotated[list[float], Meta(min_length=3, max_length=4)]
    files: _OneFile


class _RangedRest(msgspec.Struct, frozen=True):
    mins: float
    maxs: float
    files: _TwoFiles


class _SogVersion1(msgspec.Struct, frozen=True):
    means: _Means
    scales: _Ranged
    quats: _Quaternions
    sh0: _Ranged
    shN: _RangedRest | None = None  # noqa: N815 - the format's own name


class _SogVersion(msgspec.Struct, frozen=True):
    version: int = 1


@dataclass(frozen=True, slots=True)
class SogMeta:
    """Content of `meta.json`: names of the images, and codebooks of 256 numbers for their bytes.

    Missing entries of a short codebook are NaN, so that bytes that refer to them are detected.
    """

    files: _SogVersion1 | _SogVersion2
    count: int
    log_scales: Float32[np.ndarray, "3 256"]
    base: Float32[np.ndarray, "3 256"]
    """Harmonic of degree 0."""
    opacities: Float32[np.ndarray, "256"]
    rest: Float32[np.ndarray, "256"]
    """Harmonics above degree 0; unused without any."""
    bands: int | None = None
    """SH degree; in version 1 the width of the palette's image determines it."""
    palette_count: int | None = None


def read_meta(path: Path, text: bytes) -> SogMeta:
    """Read the description of a SOG scene, version 2 or 1 (2024, without a `version`).

    Raises `SceneFormatError` that names the field, as in ``Expected `int` - at `$.count` ``.
    """
    version = 2
    try:
        version = msgspec.json.decode(text, type=_SogVersion).version
        if version == 1:
            return _from_version_1(path, msgspec.json.decode(text, type=_SogVersion1))
        if version == 2:
            return _from_version_2(path, msgspec.json.decode(text, type=_SogVersion2))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        kind = _SogVersion1 if version == 1 else _SogVersion2
        raise SceneFormatError(path, f"meta.json: {readable_validation_error(error, kind)}") from None
    raise SceneFormatError(path, f"meta.json: version {version} of SOG can't be read, versions 1 and 2 can")


def _from_version_2(path: Path, meta: _SogVersion2) -> SogMeta:
    rest = meta.shN
    return SogMeta(
        files=meta,
        count=meta.count,
        log_scales=np.tile(_codebook(path, "scales", meta.scales.codebook), (3, 1)),
        base=np.tile(_codebook(path, "sh0", meta.sh0.codebook), (3, 1)),
        opacities=np.arange(256, dtype=np.float32) / 255,
        rest=_NO_HARMONICS if rest is None else _codebook(path, "shN", rest.codebook),
        bands=None if rest is None else rest.bands,
        palette_count=None if rest is None else rest.count,
    )


def _from_version_1(path: Path, meta: _SogVersion1) -> SogMeta:
    if not meta.means.shape or not 0 <= meta.means.shape[0] < 2**32:
        raise SceneFormatError(path, "meta.json: means.shape must start with the number of Gaussians")
    if len(meta.sh0.mins) != 4 or len(meta.sh0.maxs) != 4:
        raise SceneFormatError(path, "meta.json: mins and maxs of sh0 must hold 4 numbers: red, green, blue, opacity")
    base = _ramps(meta.sh0.mins, meta.sh0.maxs)
    return SogMeta(
        files=meta,
        count=meta.means.shape[0],
        log_scales=_ramps(meta.scales.mins[:3], meta.scales.maxs[:3]),
        base=base[:3],
        opacities=(1 / (1 + np.exp(-np.clip(base[3], -80, 80)))).astype(np.float32),
        rest=_NO_HARMONICS if meta.shN is None else _ramps([meta.shN.mins], [meta.shN.maxs])[0],
    )


def _codebook(path: Path, name: str, values: list[float | None]) -> Float32[np.ndarray, "256"]:
    first, *others = values
    numbers = [number for number in others if number is not None]
    if len(numbers) != len(others):
        raise SceneFormatError(path, f"meta.json: {name}.codebook holds null after its first entry")
    if first is None:
        # Early writers stored null as the first entry: as in PlayCanvas, extrapolate one step below the second.
        first = numbers[0] + (numbers[0] - numbers[-1]) / 255
    codebook = np.full(256, np.nan, np.float32)
    with np.errstate(over="ignore"):  # infinity, like NaN, is rejected when a Gaussian uses it
        codebook[: len(values)] = np.array([first, *numbers]).astype(np.float32)
    return codebook


def _ramps(mins: list[float], maxs: list[float]) -> Float32[np.ndarray, "channels 256"]:
    """Codebooks of version 1: 256 equal steps from the minimum to the maximum."""
    low, high = np.array(mins)[:, None], np.array(maxs)[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        return (low + (high - low) * (np.arange(256) / 255)).astype(np.float32)


def _file_name(path: Path, name: str) -> str:
    """Accept only a bare file name: a scene must not refer to files outside its folder."""
    if not name or name in (".", "..") or "\0" in name or len(name) > 255:
        raise SceneFormatError(path, f"meta.json: {name[:40]!r} is not the name of a file")
    if PurePosixPath(name).name != name or PureWindowsPath(name).name != name:
        raise SceneFormatError(path, f"meta.json: the file {name!r} must lie beside meta.json, without a folder")
    return name


# Lossless WebP images
# The size is checked before decoding.

_CHUNK = struct.Struct("<4sI")
_RIFF_HEADER_BYTES = 12
_LOSSLESS_SIGNATURE = 0x2F
_ANIMATION_FLAG = 0x02


def lossless_webp_size(path: Path, name: str, data: bytes) -> tuple[int, int]:
    """Width and height in pixels; `name` is the image's file, `path` the scene's.

    Layout: WebP container and lossless bitstream specifications (RFC 9649, sections 2 and 3.4). Raises
    `SceneFormatError` if it is no WebP, or a lossy or animated one.
    """
    if data[:4] != b"RIFF" or data[8:_RIFF_HEADER_BYTES] != b"WEBP":
        raise SceneFormatError(path, f"{name} is not a WebP image")
    offset = _RIFF_HEADER_BYTES
    canvas: tuple[int, int] | None = None
    while offset + _CHUNK.size <= len(data):
        kind, size = _CHUNK.unpack_from(data, offset)
        body = data[offset + _CHUNK.size : offset + _CHUNK.size + min(size, 10)]
        if kind == b"VP8L" and len(body) >= 5 and body[0] == _LOSSLESS_SIGNATURE:
            bits = int.from_bytes(body[1:5], "little")
            image = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
            if canvas not in (None, image):
                raise SceneFormatError(path, f"{name} is damaged: its header says {canvas} pixels, its image {image}")
            return image
        if kind == b"VP8X" and len(body) == 10 and not body[0] & _ANIMATION_FLAG:
            canvas = int.from_bytes(body[4:7], "little") + 1, int.from_bytes(body[7:10], "little") + 1
        elif canvas is None or kind in (b"VP8X", b"VP8 ", b"VP8L", b"ANIM", b"ANMF"):
            break
        offset += _CHUNK.size + size + size % 2
    raise SceneFormatError(path, f"{name} must be a single lossless WebP image (a VP8L chunk), which it is not")


def read_lossless_webp(path: Path, name: str, data: bytes) -> UInt8[np.ndarray, "pixels 4"]:
    """Red, green, blue and alpha of every pixel, row by row. Check the size with `lossless_webp_size` first."""
    width, height = lossless_webp_size(path, name, data)
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as image:
            pixels = np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError, Image.DecompressionBombError):
        raise SceneFormatError(path, f"{name} is damaged") from None
    if pixels.shape != (height, width, 4):
        raise SceneFormatError(path, f"{name} is damaged: {width} x {height} pixels expected, {pixels.shape[:2]} found")
    return pixels.reshape(-1, 4)

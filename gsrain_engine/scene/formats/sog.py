"""SOG scenes of PlayCanvas: numbers in lossless images.

Source: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from gsrain_engine.untrusted.limits import TooLargeError, read_file

from ..errors import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from .bounded import check_expansion
from .checks import checked_gaussians
from .smallest_three import with_largest
from .sog_meta import RestHarmonics, SogMeta, read_meta
from .webp import lossless_webp_size, read_lossless_webp

_META = "meta.json"
_META_BYTES = 2**20
"""Three codebooks of 256 numbers take 16 KB."""
_SPARE_PIXELS = 2**16
"""How many more pixels than Gaussians an image may have; writers fill up the last rows."""
_PALETTE_COLUMNS = 64
_FIRST_LARGEST = 252
"""Alpha of a quaternion's pixel: 252, 253, 254, 255 where w, x, y, z is the largest and left out."""

_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, ValueError, OSError)
"""What `zipfile` raises for damage, by trial."""

ReadMember = Callable[[str, int], bytes]
"""Bytes of a file of the scene, by name; an error where it is longer than so many bytes."""


def is_sog_folder(folder: Path) -> bool:
    """Whether a folder holds the meta.json of SOG: a JSON object that says where the means are, not only that name."""
    try:
        values = json.loads(read_file(folder / _META, _META_BYTES))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(values, dict) and "means" in values


def read_sog(path: Path) -> Gaussians:
    """Read a SOG scene, version 1 or 2: a `.sog` (a zip), a folder with `meta.json` and its images, or that file.

    Raises `SceneFormatError` where something is missing, damaged or out of all proportion.
    """
    if path.is_dir() or path.name.lower() == _META:
        folder = path if path.is_dir() else path.parent
        return _decode(path, lambda name, most: _folder_member(path, folder / name, most), _folder_bytes(folder))
    data = read_file(path)
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except _ZIP_ERRORS as error:
        raise SceneFormatError(path, f"not a whole zip file: {error}") from None
    with archive:
        return _decode(path, lambda name, most: _zip_member(path, archive, name, most), len(data))


def _folder_bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.glob("*.webp"))


def _folder_member(path: Path, file: Path, most: int) -> bytes:
    if not file.is_file():
        raise SceneFormatError(path, f"there is no file {file.name}")
    try:
        return read_file(file, most)
    except TooLargeError:
        raise SceneFormatError(path, f"{file.name} has more than {most} bytes") from None


def _zip_member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    try:
        member = archive.getinfo(name)
    except KeyError:
        raise SceneFormatError(path, f"there is no {name} in the zip file") from None
    if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise SceneFormatError(path, f"{name} in the zip file must be stored or deflated, without a password")
    if member.file_size > most:
        raise SceneFormatError(path, f"{name} has {member.file_size} bytes, at most {most} would be right")
    try:
        with archive.open(member) as file:
            return file.read(most)
    except _ZIP_ERRORS as error:
        raise SceneFormatError(path, f"{name} in the zip file is damaged: {error}") from None


def _decode(path: Path, read: ReadMember, file_bytes: int) -> Gaussians:
    meta = read_meta(path, read(_META, _META_BYTES))
    check_expansion(path, meta.count, 1, file_bytes)
    low = _pixels(path, read, meta.means_files[0], meta.count)
    high = _pixels(path, read, meta.means_files[1], meta.count)
    base = _pixels(path, read, meta.base_file, meta.count)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are named by the check at the end
        means = _decode_means(meta, low, high)
        scales = np.exp(_looked_up(meta.log_scales, _pixels(path, read, meta.scales_file, meta.count)))
    sh = np.empty((meta.count, 1, 3), np.float32)
    if meta.rest is not None:
        sh = _decode_rest(path, read, meta.rest, meta.count, file_bytes)
    sh[:, 0] = _looked_up(meta.base, base)
    return checked_gaussians(
        path,
        means,
        scales,
        _decode_quaternions(path, _pixels(path, read, meta.quaternions_file, meta.count)),
        meta.opacities[base[:, 3]],
        sh,
    )


def _pixels(path: Path, read: ReadMember, name: str, count: int) -> UInt8[np.ndarray, "count 4"]:
    """Pixels of the first `count` Gaussians."""
    most = count + _SPARE_PIXELS
    data = read(name, 8 * most)
    width, height = lossless_webp_size(path, name, data)
    if not count <= width * height <= most:
        raise SceneFormatError(path, f"{name} has {width} x {height} pixels, not one for each of {count} Gaussians")
    return read_lossless_webp(path, name, data)[:count]


def _looked_up(codebooks: Float32[np.ndarray, "3 256"], pixels: UInt8[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 3"]:
    return np.stack([codebook[pixels[:, channel]] for channel, codebook in enumerate(codebooks)], axis=1)


def _decode_means(
    meta: SogMeta, low: UInt8[np.ndarray, "n 4"], high: UInt8[np.ndarray, "n 4"]
) -> Float32[np.ndarray, "n 3"]:
    steps = low[:, :3] + high[:, :3] * 256.0
    logarithms = meta.mins + (meta.maxs - meta.mins) * (steps / 65535)
    return (np.sign(logarithms) * np.expm1(np.abs(logarithms))).astype(np.float32)


def _decode_quaternions(path: Path, pixels: UInt8[np.ndarray, "n 4"]) -> Float32[np.ndarray, "n 4"]:
    bad = np.flatnonzero(pixels[:, 3] < _FIRST_LARGEST)
    if len(bad):
        found = f"{len(bad)} of {len(pixels)} quaternions have an alpha below {_FIRST_LARGEST}"
        raise SceneFormatError(path, f"{found}, the first is number {bad[0]}")
    others = (pixels[:, :3] / np.float32(127.5) - 1) * np.float32(np.sqrt(0.5))
    return with_largest(pixels[:, 3] - np.uint8(_FIRST_LARGEST), others)


def _decode_rest(
    path: Path, read: ReadMember, rest: RestHarmonics, count: int, file_bytes: int
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics above degree 0, with room for that: row `label` of the palette, whose images have 64 entries a row."""
    data = read(rest.centroids, 2**24)
    width, height = lossless_webp_size(path, rest.centroids, data)
    widths = {_PALETTE_COLUMNS * (k - 1): degree for degree, k in enumerate(COEFFICIENTS_OF_DEGREE) if degree}
    degree = widths.get(width)
    if degree is None or (rest.bands is not None and degree != rest.bands):
        right = [w for w, d in widths.items() if rest.bands in (None, d)]
        raise SceneFormatError(path, f"{rest.centroids} is {width} pixels wide, {right} would be right")
    entries = _PALETTE_COLUMNS * height
    if not (rest.palette_count or 1) <= entries <= 2**16:
        raise SceneFormatError(path, f"{rest.centroids} has room for {entries} entries, not {rest.palette_count}")
    coefficients = COEFFICIENTS_OF_DEGREE[degree] - 1
    check_expansion(path, count, coefficients + 1, file_bytes)
    palette = np.zeros((entries, coefficients + 1, 3), np.float32)
    colors = read_lossless_webp(path, rest.centroids, data)[:, :3].reshape(entries, coefficients, 3)
    palette[:, 1:] = rest.codebook[colors]
    pixels = _pixels(path, read, rest.labels, count)
    labels = pixels[:, 0] + pixels[:, 1].astype(np.int64) * 256
    last = (rest.palette_count or entries) - 1
    if count and labels.max() > last:
        raise SceneFormatError(path, f"{rest.labels} asks for palette entry {labels.max()}, the last one is {last}")
    return palette[labels]

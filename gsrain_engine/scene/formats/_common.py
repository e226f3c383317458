"""Shared parts of scene formats: bounded decompression, memory checks, validation, and packed quaternions."""

import io
import logging
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import zstandard
from jaxtyping import Bool, Float32, Integer, UInt8

from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import max_expanded_bytes
from ..gaussians import Gaussians
from ..scene import Layer, Scene
from ..transforms import FILE_UP

_LARGEST_ZSTD_WINDOW = 2**27  # the default limit of zstd (windowLog 27)


def check_expansion(path: Path, count: int, coefficients: int, file_bytes: int) -> None:
    """Reject a header that requires more memory than is free or than is plausible for its file size.

    `count` Gaussians have `coefficients` spherical harmonics per color. Call it before allocating.
    """
    check_plausible(path, count, coefficients, file_bytes)
    check_room(path, count, coefficients)


def check_plausible(path: Path, count: int, coefficients: int, file_bytes: int) -> None:
    """Reject a header that speaks of more Gaussians than can be in a file of its size."""
    wanted = gaussian_bytes(count, coefficients)
    if wanted > max_expanded_bytes(file_bytes):
        raise SceneFormatError(
            path,
            f"the header speaks of {count} Gaussians ({wanted / 1e9:.1f} GB), "
            f"which can't be in a file of {file_bytes} bytes",
        )


def gunzip_start(path: Path, data: bytes, size: int) -> bytes:
    """First `size` bytes of a gzip stream; fewer if it ends before."""
    try:
        return zlib.decompressobj(wbits=31).decompress(data, size)
    except zlib.error:
        raise SceneFormatError(path, "the gzip stream is damaged") from None


def gunzip(path: Path, data: bytes, at_most: int) -> bytes:
    """Decompress a whole gzip stream of at most `at_most` bytes, and verify its checksum."""
    stream = zlib.decompressobj(wbits=31)
    try:
        unpacked = stream.decompress(data, at_most + 1)
    except zlib.error:
        raise SceneFormatError(path, "the gzip stream is damaged") from None
    if len(unpacked) > at_most:
        raise SceneFormatError(path, f"the gzip stream holds more than {at_most} bytes, which it may hold at most")
    if not stream.eof:
        raise SceneFormatError(path, "the gzip stream ends too early: the file is cut off")
    return unpacked


def unzstd(path: Path, data: bytes, size: int, name: str) -> bytes:
    """Decompress one zstd frame of exactly `size` bytes; `name` describes its content in errors."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_ZSTD_WINDOW)
    try:
        with decompressor.stream_reader(io.BytesIO(data)) as reader:
            unpacked = reader.read(size + 1)
    except zstandard.ZstdError:
        raise SceneFormatError(path, f"the zstd stream of {name} is damaged") from None
    if len(unpacked) != size:
        more = "more" if len(unpacked) > size else f"only {len(unpacked)}"
        raise SceneFormatError(path, f"the zstd stream of {name} must hold {size} bytes, it holds {more}")
    return unpacked


# Memory of a scene

logger = logging.getLogger("gsrain")
DRAWING_FACTOR = 1.6
"""Maximum memory to open and draw a scene, as a multiple of the bytes of its Gaussians."""

_WORTH_SAYING_BYTES = 200e6


def check_room(path: Path, count: int, coefficients: int) -> None:
    """Log the memory that a scene will need, and reject one that can't fit, before it is allocated.

    Raises `SceneFormatError`.
    """
    wanted = gaussian_bytes(count, coefficients)
    available = psutil.virtual_memory().available
    if DRAWING_FACTOR * wanted > available:
        raise SceneFormatError(
            path,
            f"{count:,} Gaussians need {DRAWING_FACTOR * wanted / 1e9:.1f} GB of memory to be opened and drawn, "
            f"{available / 1e9:.1f} GB are free",
        )
    if wanted > _WORTH_SAYING_BYTES:
        logger.info("%s: %s Gaussians, %.1f GB", path.name, f"{count:,}", wanted / 1e9)


def gaussian_bytes(count: int, coefficients: int) -> int:
    """Bytes of `Gaussians`: means, scales, quaternions, opacities, harmonics, all float32."""
    return 4 * count * (3 + 3 + 4 + 1 + 3 * coefficients)


# Validation

_MAX_LEFT_OUT = 0.1
"""Largest share of a file's Gaussians that may be unusable: programs leave a few rows of NaN, damage does more."""


def checked_gaussians(
    path: Path,
    means: Float32[np.ndarray, "n 3"],
    scales: Float32[np.ndarray, "n 3"],
    quaternions: Float32[np.ndarray, "n 4"],
    opacities: Float32[np.ndarray, " n"],
    sh: Float32[np.ndarray, "n k 3"],
) -> Gaussians:
    """Build `Gaussians` from the `usable_rows` of a file's values, with unit quaternions. Raises `SceneFormatError`."""
    fit = usable_rows(path, means, scales, quaternions, opacities, sh)
    if not fit.all():
        means, scales, quaternions, opacities, sh = (each[fit] for each in (means, scales, quaternions, opacities, sh))
    lengths = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
    np.divide(quaternions, lengths[:, None], out=quaternions)
    return Gaussians(means, scales, quaternions, opacities, sh)


def usable_rows(
    path: Path,
    means: Float32[np.ndarray, "n 3"],
    scales: Float32[np.ndarray, "n 3"],
    quaternions: Float32[np.ndarray, "n 4"],
    opacities: Float32[np.ndarray, " n"],
    sh: Float32[np.ndarray, "n k 3"],
) -> Bool[np.ndarray, " n"]:
    """Mask of the rows that are Gaussians.

    Others hold numbers that are not finite, a negative scale, a zero quaternion or an opacity outside 0 to 1. They are
    logged with their number. Raises `SceneFormatError` with the same words if they are more than a tenth.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
        faults = {
            **_not_finite(
                {"mean": means, "scale": scales, "quaternion": quaternions, "opacity": opacities, "color": sh}
            ),
            "a negative scale": None if scales.min(initial=0) >= 0 else (scales < 0).any(axis=1),
            "a zero quaternion": None if lengths.min(initial=1) > 1e-12 else lengths <= 1e-12,
            "a quaternion too long to be normalized": None if lengths.max(initial=0) < np.inf else np.isinf(lengths),
            "an opacity outside 0 to 1": (opacities < 0) | (opacities > 1),
        }
    bad = {what: np.asarray(rows) for what, rows in faults.items() if rows is not None and rows.any()}
    if bad:
        left_out = np.logical_or.reduce([*bad.values()])
        told = ", ".join(_counted(np.flatnonzero(rows), len(rows), what) for what, rows in bad.items())
        if left_out.sum() > _MAX_LEFT_OUT * len(left_out):
            raise SceneFormatError(path, told)
        logger.warning("%s: %d Gaussians are left out: %s", path, left_out.sum(), told)
        return ~left_out
    return np.ones(len(means), np.bool_)


def check_finite(path: Path, fields: Mapping[str, Float32[np.ndarray, "..."]]) -> None:
    """Reject fields, one row per Gaussian, that hold NaN or infinity.

    Raises `SceneFormatError` with the field, the number of affected Gaussians and the first of them.
    """
    for what, bad in _not_finite(fields).items():
        raise SceneFormatError(path, _counted(np.flatnonzero(bad), len(bad), what))


def _not_finite(fields: Mapping[str, Float32[np.ndarray, "..."]]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Masks of the rows with NaN or infinity, of the fields that have any; the keys are phrases."""
    found: dict[str, Bool[np.ndarray, " n"]] = {}
    for name, values in fields.items():
        # Cheap test: a sum is finite only if every term is, apart from float32 overflow.
        with np.errstate(invalid="ignore"):  # infinity minus infinity
            total = np.sum(values, dtype=np.float64)
        if not np.isfinite(total):
            article = "an" if name[0] in "aeiou" else "a"
            bad = np.asarray(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
            found[f"{article} {name} that is not a finite number"] = bad
    return found


def _counted(bad: "np.ndarray[tuple[int], np.dtype[np.int64]]", total: int, what: str) -> str:
    return f"{len(bad)} of {total} Gaussians have {what}, the first is number {bad[0]}"


# Scenes of single files


def single_layer(name: str, gaussians: Gaussians) -> Scene:
    """Scene of one background layer; files of Gaussians store neither axes nor unit, so both are assumed."""
    name = printable_name(name)
    return Scene(name, (Layer(name, gaussians),), up=FILE_UP, up_is_assumed=True, unit_is_assumed=True)


def printable_name(name: str) -> str:
    """Name that can be saved as JSON: one that is not UTF-8 can't."""
    return name.encode(errors="replace").decode()


def stem_of(path: Path, suffix: str) -> str:
    """Name of a file without the suffix of its format; for a file named only by a suffix, its folder's name."""
    return path.name[: -len(suffix)] if len(path.name) > len(suffix) else path.resolve().parent.name


# Format description


class Format(NamedTuple):
    """A single-file scene format."""

    suffix: str
    """End of the file's name, in lower case; the first matching row counts."""
    read: Callable[[Path], Gaussians]
    write: Callable[[Gaussians, Path], None] | None
    """Writes to exactly this path, a temporary one; None for read-only formats."""
    description: str
    """Half a sentence for the documentation: contents, versions."""
    sh_degree: int = 3
    """Highest degree of harmonics; with 0, colors do not depend on the viewing direction."""
    read_scene: Callable[[Path], Scene] | None = None
    """Reads more than Gaussians: layers, actors, rigs; None for formats that hold only Gaussians."""
    write_scene: Callable[[Scene, Path], None] | None = None
    """Writes more than the flattened scene, to exactly this path."""
    lost: Callable[[list[str]], list[str]] | None = None
    """Selects from the phrases of `lost_when_flattened` those that apply to `write_scene`."""
    packages: tuple[str, ...] = ()
    """Modules of `OPTIONAL_PACKAGES` that it needs."""


# Packed numbers

COARSE_SHARE = 0.1
"""Largest step of written means, as a share of the median size, that does not show."""


def rounded_bytes(values: Float32[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """Round values to bytes; those outside 0 .. 255 are clamped."""
    whole = np.rint(values)
    return np.clip(whole, 0, 255, out=whole).astype(np.uint8)


OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Stored components, in order, if the largest is component 0, 1, 2 or 3."""


def with_largest(largest: Integer[np.ndarray, " n"], others: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 4"]:
    """Restore quaternions from three components and the index (0..3) of the largest, which is never negative.

    If the three together are longer than 1, by damage or rounding, the largest becomes 0.
    """
    quaternions = np.empty((len(others), 4), np.float32)
    np.put_along_axis(quaternions, OTHERS[largest], others, axis=1)
    rest = np.sqrt(np.maximum(0, 1 - np.einsum("ij,ij->i", others, others)))
    np.put_along_axis(quaternions, largest[:, None].astype(np.intp), rest[:, None], axis=1)
    return quaternions


def without_largest(
    quaternions: Float32[np.ndarray, "n 4"],
) -> tuple[Integer[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
    """Index of the largest component and the three others, with the signs that make the largest positive."""
    largest = np.abs(quaternions).argmax(axis=1)
    signs = np.where(np.take_along_axis(quaternions, largest[:, None], axis=1) < 0, np.float32(-1), np.float32(1))
    return largest, np.take_along_axis(quaternions, OTHERS[largest], axis=1) * signs

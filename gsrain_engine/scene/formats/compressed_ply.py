"""Compressed PLY files (SuperSplat, PlayCanvas): 16 bytes per Gaussian, within the bounds of chunks of 256.

Layout as written by SuperSplat and splat-transform (PlayCanvas, MIT): element `chunk` with bounds of means, log scales
and, in newer files, colors; `vertex` with four 32-bit words; optional `sh` with a byte per coefficient.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from io import BufferedReader
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64, UInt, UInt32

from ...safe_io.errors import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians
from ..scene import robust_bounds
from ._common import COARSE_SHARE, check_room, checked_gaussians, with_largest, without_largest
from .ply_header import ANTIALIASED, PlyElement, element_rows

logger = logging.getLogger("gsrain")
_MEANS = ("x", "y", "z")
_CHUNK = 256  # gaussians per chunk, with common bounds
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LOG_SCALES = ("scale_x", "scale_y", "scale_z")
_MEANS_BITS = (11, 10, 11)
_LOG_SCALES_RANGE = 20.0  # log scales are clamped to -20 .. 20
_COLOR_BITS = (8, 8, 8, 8)
_ROTATION_BITS = (2, 10, 10, 10)
_SH_RANGE = 8.0  # harmonics are in -4 .. 4; bytes 0 and 255 are the ends, the others the midpoints of 256 steps.


def is_compressed(elements: dict[str, PlyElement]) -> bool:
    vertex = elements.get("vertex")
    return "chunk" in elements and vertex is not None and _PACKED[0] in _names(vertex.dtype)


def read_compressed(path: Path, file: BufferedReader, elements: dict[str, PlyElement]) -> Gaussians:
    """Read the Gaussians of a compressed PLY after its header.

    Raises `SceneFormatError` if a property is missing, counts contradict one another or bounds are not finite.
    """
    check_room(path, elements["vertex"].rows, COEFFICIENTS_OF_DEGREE[-1] if "sh" in elements else 1)
    rows = _read(path, file, elements["vertex"], _PACKED)
    packed = {name: _unsigned(path, rows, name, "uint32") for name in _PACKED}
    chunk = elements["chunk"]
    n = elements["vertex"].rows
    if chunk.rows != -(-n // _CHUNK):
        raise SceneFormatError(path, f"{n} Gaussians need {-(-n // _CHUNK)} chunks, the header lists {chunk.rows}")
    with np.errstate(over="ignore", invalid="ignore"):  # overflow gives infinity, which the final check reports
        has_colors = "min_r" in _names(chunk.dtype)
        values = [*_MEANS, *_LOG_SCALES, *("rgb" if has_colors else "")]
        bounds = _read(path, file, chunk, tuple(f"{end}_{value}" for value in values for end in ("min", "max")))
        means = _between(bounds, _fractions(packed["packed_position"], _MEANS_BITS), _MEANS)
        logs = _between(bounds, _fractions(packed["packed_scale"], _MEANS_BITS), _LOG_SCALES)
        colors = _fractions(packed["packed_color"], _COLOR_BITS)
        opacities = np.ascontiguousarray(colors[:, 3])
        base = _between(bounds, colors[:, :3], "rgb") if has_colors else colors[:, :3]
        sh = _read_sh(path, file, elements.get("sh"), n)
        sh[:, 0] = (base - np.float32(0.5)) / np.float32(SH_C0)
        np.exp(logs, out=logs)
    found = checked_gaussians(path, means, logs, _quaternions(packed["packed_rotation"]), opacities, sh)
    return replace(found, antialiased=elements["vertex"].is_antialiased)


def write_compressed(gaussians: Gaussians, path: Path) -> None:
    """Write a compressed PLY in `chunk_order`, so that those of a chunk are close together.

    Means keep 11, 10 and 11 bits within a chunk, log scales, too, quaternions 10 bits a component, opacities and colors
    8 bits, harmonics above degree 0 8 bits within -4 .. 4. Raises `ValueError` without Gaussians, which have no bounds.
    """
    if not len(gaussians):
        raise ValueError("a compressed PLY has bounds of at least one Gaussian; there is none to write")
    sorted_ = gaussians.take(chunk_order(gaussians))
    logs = np.log(np.maximum(sorted_.scales, np.float32(1e-37))).clip(-_LOG_SCALES_RANGE, _LOG_SCALES_RANGE)
    colors = sorted_.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)
    starts = np.arange(0, len(gaussians), _CHUNK)
    columns: dict[str, Float32[np.ndarray, " chunks"]] = {}
    words: list[UInt32[np.ndarray, " n"]] = []
    for names, values, bits in (
        (_MEANS, sorted_.means, _MEANS_BITS),
        (_LOG_SCALES, logs, _MEANS_BITS),
        ("rgb", colors, _COLOR_BITS[:3]),
    ):
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        for end, bound in (("min", low), ("max", high)):
            columns |= {f"{end}_{name}": bound[:, i] for i, name in enumerate(names)}
        chunk = np.arange(len(values)) // _CHUNK
        if values is sorted_.means:
            _warn_of_coarse_steps((high - low).max(axis=1)[chunk] / ((1 << min(bits)) - 1), sorted_)
        span = np.where(high > low, high - low, 1)[chunk]
        words.append(_words((values - low[chunk]) / span, bits))
    position, scale, color = words
    largest, others = without_largest(sorted_.quaternions)
    rotation = _words(others / np.float32(np.sqrt(2)) + np.float32(0.5), _ROTATION_BITS[1:])
    packed = {
        "packed_position": position,
        "packed_rotation": rotation | (largest.astype(np.uint32) << np.uint32(30)),
        "packed_scale": scale,
        "packed_color": (color << np.uint32(8)) | _words(sorted_.opacities[:, None], (8,)),
    }
    rest = 3 * (gaussians.sh.shape[1] - 1)
    lines = [f"element chunk {len(starts)}", *(f"property float {name}" for name in columns)]
    lines += [f"element vertex {len(gaussians)}", *(f"property uint {name}" for name in packed)]
    if rest:
        lines += [f"element sh {len(gaussians)}", *(f"property uchar f_rest_{i}" for i in range(rest))]
    mark = [f"comment {ANTIALIASED}"] if gaussians.antialiased else []
    header = "\n".join(["ply", "format binary_little_endian 1.0", *mark, *lines, "end_header", ""])
    with path.open("wb") as file:
        file.write(header.encode())
        file.write(np.stack(list(columns.values()), axis=1).astype("<f4").tobytes())
        file.write(np.stack(list(packed.values()), axis=1).astype("<u4").tobytes())
        if rest:
            steps = np.floor(sorted_.sh[:, 1:] * np.float32(256 / _SH_RANGE) + np.float32(128))
            file.write(steps.clip(0, 255).astype(np.uint8).transpose(0, 2, 1).tobytes())


def chunk_order(gaussians: Gaussians) -> Int64[np.ndarray, " n"]:
    """Order of Gaussians in which each 256 are close together.

    They follow a Morton curve whose cells are divided further where more than a chunk are in one. Those far out, which
    would take its precision from the scene, are last, in chunks of their own; the least visible of the others fill up
    the first of these.
    """
    box = robust_bounds(gaussians)
    reach = _FAR_EXTENTS * (box.high - box.low).max()
    is_far = np.any((gaussians.means < box.low - reach) | (gaussians.means > box.high + reach), axis=1)
    near, far = np.flatnonzero(~is_far), np.flatnonzero(is_far)
    if len(far) and len(near) % _CHUNK:
        visibility = gaussians.opacities[near] * gaussians.scales[near].max(axis=1) ** 2
        order = np.argsort(visibility, kind="stable")
        rest = len(near) % _CHUNK
        near, far = np.sort(near[order[rest:]]), np.concatenate([near[order[:rest]], far])
    return np.concatenate([_along_curve(gaussians.means, near), _along_curve(gaussians.means, far)])


_FAR_EXTENTS = 2.0  # times the extent of a scene's middle, beyond it, from which on Gaussians are far out


def _along_curve(means: Float32[np.ndarray, "n 3"], indices: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"]:
    """Sort indices along a Morton curve, finer and finer until at most a chunk is in a cell or all are in one place."""
    ordered = indices.copy()
    waiting = [(0, len(indices))]
    while waiting:
        start, end = waiting.pop()
        there = means[ordered[start:end]].astype(np.float64)
        low, high = there.min(axis=0, initial=np.inf), there.max(axis=0, initial=-np.inf)
        if end - start <= 1 or not (high > low).any():
            continue
        cells = ((there - low) * ((_CELLS - 1) / (high - low).max())).astype(np.uint64)
        codes = np.zeros(end - start, np.uint64)
        for bit in range(_CELLS.bit_length() - 1):
            for axis in range(3):
                codes |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
        order = np.argsort(codes, kind="stable")
        ordered[start:end] = ordered[start:end][order]
        firsts = np.flatnonzero(np.diff(codes[order], prepend=codes[order[0]] + np.uint64(1)))
        bounds = np.append(firsts, end - start) + start
        waiting += [(a, b) for a, b in pairwise(bounds.tolist()) if b - a > _CHUNK]
    return ordered


_CELLS = 1024  # cells along each axis of a Morton curve


def _warn_of_coarse_steps(steps: Float32[np.ndarray, " n"], gaussians: Gaussians) -> None:
    """Log how many Gaussians lie on steps of a size that shows: a tenth of that of most of them."""
    size = float(np.median(gaussians.scales.max(axis=1)))
    coarse = int(np.count_nonzero(steps > COARSE_SHARE * size))
    if coarse > _FEW * len(gaussians):
        told = "%d of %d Gaussians are placed in steps of up to %.3g units, most are %.3g wide: a .ply or .glb is exact"
        logger.warning(told, coarse, len(gaussians), steps.max(), size)


_FEW = 0.01  # share of Gaussians that may be placed coarsely without a word


def _words(fractions: Float32[np.ndarray, "n f"], bits: Sequence[int]) -> UInt32[np.ndarray, " n"]:
    """Pack fractions 0 .. 1 into bit fields of a word, the first in the highest bits."""
    words = np.zeros(len(fractions), np.uint32)
    for fraction, size in zip(fractions.T, bits, strict=True):
        field = np.rint(fraction.clip(0, 1) * np.float32((1 << size) - 1)).astype(np.uint32)
        words = (words << np.uint32(size)) | field
    return words


def _between(
    bounds: "np.ndarray[Any, np.dtype[Any]]", fractions: Float32[np.ndarray, "n 3"], values: Sequence[str]
) -> Float32[np.ndarray, "n 3"]:
    """Interpolate between the bounds of each Gaussian's chunk."""
    low, high = (
        np.stack([bounds[f"{end}_{value}"].astype(np.float32) for value in values], axis=-1) for end in ("min", "max")
    )
    chunk = np.arange(len(fractions)) // _CHUNK
    return low[chunk] * (1 - fractions) + high[chunk] * fractions


def _read(
    path: Path, file: BufferedReader, element: PlyElement, needed: tuple[str, ...]
) -> "np.ndarray[Any, np.dtype[Any]]":
    dtype, offset = element_rows(path, element)
    missing = [name for name in needed if name not in _names(dtype)]
    if missing:
        raise SceneFormatError(path, f"element {element.name!r} of a compressed PLY lacks {', '.join(missing)}")
    file.seek(offset)
    data = file.read(element.nbytes)
    if len(data) != element.nbytes:
        raise SceneFormatError(path, "the file became shorter while it was read")
    return np.frombuffer(data, dtype)


def _unsigned(path: Path, rows: "np.ndarray[Any, np.dtype[Any]]", name: str, kind: str) -> UInt[np.ndarray, " n"]:
    """One property, in native byte order; `kind` is the integer type of the packed bits."""
    if rows[name].dtype.newbyteorder("=") != kind:
        raise SceneFormatError(path, f"property {name} of a compressed PLY must be {kind}, not {rows[name].dtype}")
    return rows[name].astype(kind)


def _read_sh(path: Path, file: BufferedReader, element: PlyElement | None, n: int) -> Float32[np.ndarray, "n k 3"]:
    """Read the harmonics of all degrees; degree 0 is left unset."""
    if element is None:
        return np.empty((n, 1, 3), np.float32)
    count = sum(name.startswith("f_rest_") for name in _names(element.dtype))
    expected = {3 * (coefficients - 1): coefficients for coefficients in COEFFICIENTS_OF_DEGREE}
    if count not in expected or element.rows != n:
        raise SceneFormatError(
            path, f"element 'sh' has {element.rows} rows of {count} f_rest_*: expected {n} rows of 0, 9, 24 or 45"
        )
    rows = _read(path, file, element, tuple(f"f_rest_{i}" for i in range(count)))
    sh = np.empty((n, expected[count], 3), np.float32)
    rest = expected[count] - 1
    for channel in range(3):
        for k in range(rest):
            sh[:, 1 + k, channel] = _SH_OF_BYTE[_unsigned(path, rows, f"f_rest_{channel * rest + k}", "uint8")]
    return sh


def _sh_of_byte() -> Float32[np.ndarray, "256"]:
    middles = (np.arange(256, dtype=np.float32) + np.float32(0.5)) / 256
    middles[0], middles[255] = 0, 1
    return (middles - np.float32(0.5)) * np.float32(_SH_RANGE)


_SH_OF_BYTE = _sh_of_byte()


def _fractions(words: UInt[np.ndarray, " n"], bits: tuple[int, ...]) -> Float32[np.ndarray, "n f"]:
    """Unpack words into bit fields from the top bit down, each as a fraction 0 .. 1 of its maximum."""
    fields = np.empty((len(words), len(bits)), np.float32)
    shift = sum(bits)
    for i, size in enumerate(bits):
        shift -= size
        fields[:, i] = ((words >> np.uint32(shift)) & np.uint32((1 << size) - 1)) / np.float32((1 << size) - 1)
    return fields


def _quaternions(words: UInt[np.ndarray, " n"]) -> Float32[np.ndarray, "n 4"]:
    """Unpack rotations: the upper two bits index the largest of w, x, y, z; the others are within +-1/sqrt(2)."""
    others = (_fractions(words, _ROTATION_BITS)[:, 1:] - np.float32(0.5)) * np.float32(np.sqrt(2))
    return with_largest((words >> np.uint32(30)).astype(np.int64), others)


def _names(dtype: "np.dtype[Any] | None") -> tuple[str, ...]:
    return (dtype.names or ()) if dtype is not None else ()

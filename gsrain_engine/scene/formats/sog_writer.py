"""Writing of SOG scenes, version 2 (PlayCanvas): codebooks, a palette of harmonics, and lossless images of both.

Source of the layout: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog
"""

import io
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8, UInt32
from PIL import Image

from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ..lod_order import morton_order
from ._common import rounded_bytes, without_largest
from .stored_zip import write_stored_zip

CODES = 256
"""Entries of a codebook: one per value of a byte."""
_PALETTE_COLUMNS = 64
_SMALLEST_PALETTE, LARGEST_PALETTE = 1024, 65536  # half to all of the Gaussians, as PlayCanvas' own writer, in between
_COARSE_CELLS = 256
_SAMPLES = 1 << 16  # Gaussians from which the coarse cells of a palette are found
_COARSE_ROUNDS, _FINE_ROUNDS, _CODEBOOK_ROUNDS = 10, 6, 30  # of Lloyd's algorithm
_DISTANCES = 1 << 24  # numbers of a block of distances: 64 MB
_SURFACE_CELL = 4.0  # side of the cells, in scene units, in which Gaussians of one surface follow each other
_WEBP_EFFORT = 50  # of 100, which takes 20 times as long and saves nothing


def write_sog(gaussians: Gaussians, path: Path, *, codes: int = CODES) -> None:
    """Write a `.sog`: a zip file of lossless WebP images and their description, with the Gaussians in `sog_order`.

    Means keep 16 bits of their signed logarithm, scales and base colors the nearest of `codes` values, quaternions 8
    bits per component, opacities 8 bits; harmonics above degree 0 become one of at most 65536 vectors. Deterministic.

    Raises `ValueError` without Gaussians, which have no ranges.
    """
    if not len(gaussians):
        raise ValueError("a SOG has ranges of at least one Gaussian; there is none to write")
    ordered = gaussians.take(sog_order(gaussians))
    n = len(ordered)
    columns = image_columns(n)
    low, high, ranges = _encode_means(ordered.means)
    log_scales, scales = coded(np.log(np.maximum(ordered.scales, np.float32(1e-37))), codes)
    base_codes, base = coded(ordered.sh[:, 0], codes)
    opacities = rounded_bytes(ordered.opacities * 255)[:, None]
    pixels = {
        "means_l.webp": low,
        "means_u.webp": high,
        "quats.webp": _encode_quaternions(ordered.quaternions),
        "scales.webp": scales,
        "sh0.webp": np.concatenate([base, opacities], axis=1),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": "GSRAIN"},
        "count": n,
        "means": {**ranges, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": log_scales, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": base_codes, "files": ["sh0.webp"]},
    }
    if ordered.antialiased:
        meta["antialias"] = True
    images = {name: lossless_image(rows, columns) for name, rows in pixels.items()}
    if ordered.sh_degree:
        meta["shN"], harmonics = encode_harmonics(ordered.sh, LARGEST_PALETTE)
        images |= harmonics
    write_stored_zip(path, {**images, "meta.json": msgspec.json.encode(meta)})


def sog_order(gaussians: Gaussians) -> UInt32[np.ndarray, " n"]:
    """Morton order; where many Gaussians are turned alike, as on modeled surfaces, those of a surface by their rows.

    Images of the street have 0.76 of the bytes in this order.
    """
    order = morton_order(gaussians)
    turns, (x, y, z) = _encode_quaternions(gaussians.quaternions[order]), gaussians.means[order].T
    if len(np.unique(turns, axis=0)) > len(order) // 2:
        return order
    cells = np.floor(gaussians.means[order] / np.float32(_SURFACE_CELL))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return order[np.lexsort((y, x, z, *turns.T, first[cell.reshape(-1)]))]


def image_columns(n: int) -> int:
    """Width in pixels of the images with one pixel per Gaussian."""
    return -(-int(np.ceil(np.sqrt(n))) // 4) * 4


def encode_harmonics(sh: Float32[np.ndarray, "n k 3"], largest: int) -> tuple[dict[str, Any], dict[str, bytes]]:
    """`shN` of a description, and its images, for the harmonics above degree 0: at most `largest` vectors."""
    n, others = len(sh), sh.shape[1] - 1
    palette, labels = find_palette(sh[:, 1:].reshape(n, -1), largest)
    codes, entries = coded(palette)
    files = ["shN_centroids.webp", "shN_labels.webp"]
    degree = COEFFICIENTS_OF_DEGREE.index(others + 1)
    numbers = np.stack([labels & 255, labels >> 8], axis=1).astype(np.uint8)
    images = {
        files[0]: lossless_image(entries.reshape(len(palette) * others, 3), _PALETTE_COLUMNS * others),
        files[1]: lossless_image(numbers, image_columns(n)),
    }
    return {"count": len(palette), "bands": degree, "codebook": codes, "files": files}, images


def _encode_means(
    means: Float32[np.ndarray, "n 3"],
) -> tuple[UInt8[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"], dict[str, list[float]]]:
    """Lower and upper bytes, and the ranges of the logarithms."""
    exact, mins, maxs = mean_steps(means)
    steps = np.rint(exact).astype(np.uint16)
    return (steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8), {"mins": mins.tolist(), "maxs": maxs.tolist()}


def mean_steps(
    means: Float32[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Means in steps of a SOG file, not yet rounded, with the least and the largest logarithm of each axis."""
    logarithms = np.sign(means) * np.log1p(np.abs(means, dtype=np.float64))
    mins, maxs = logarithms.min(axis=0), logarithms.max(axis=0)
    return (logarithms - mins) / np.where(maxs > mins, maxs - mins, 1) * 65535, mins, maxs


def _encode_quaternions(quaternions: Float32[np.ndarray, "n 4"]) -> UInt8[np.ndarray, "n 4"]:
    largest, others = without_largest(quaternions)
    components = rounded_bytes((others * np.float32(np.sqrt(2)) + 1) * np.float32(127.5))
    return np.concatenate([components, (252 + largest)[:, None].astype(np.uint8)], axis=1)


def lossless_image(rows: UInt8[np.ndarray, "n c"], columns: int) -> bytes:
    """Lossless WebP of one pixel per row; the last row of the image is filled up."""
    pixels = np.zeros((-(-len(rows) // columns) * columns, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(rows), : rows.shape[1]] = rows
    file = io.BytesIO()
    picture = Image.fromarray(pixels.reshape(-1, columns, 4))
    picture.save(file, "WEBP", lossless=True, exact=True, quality=_WEBP_EFFORT, method=4)
    return file.getvalue()


# Codebooks and palettes


def coded(values: Float32[np.ndarray, "n c"], codes: int = CODES) -> tuple[list[float], UInt8[np.ndarray, "n c"]]:
    """Codebook of 256 numbers for values, of which the first `codes` differ, and the index of the nearest for each."""
    codebook = find_codebook(values.ravel(), codes)
    return np.pad(codebook, (0, CODES - len(codebook)), "edge").tolist(), nearest_codes(values, codebook)


def find_codebook(values: Float32[np.ndarray, " n"], size: int = CODES) -> Float32[np.ndarray, " size"]:
    """Find an even number of numbers, in increasing order, near which the values are (Lloyd 1982).

    Starts from quantiles and equal steps in equal parts, so that rare values outside get codes, too.
    """
    ordered = np.sort(values.astype(np.float64))
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    half = size // 2
    steps = np.linspace(ordered[0], ordered[-1], half)
    codes = np.sort(np.concatenate([np.quantile(ordered, (np.arange(half) + 0.5) / half), steps]))
    for _ in range(_CODEBOOK_ROUNDS):
        ends = np.searchsorted(ordered, (codes[1:] + codes[:-1]) / 2)
        ends = np.concatenate([[0], ends, [len(ordered)]])
        counts = np.diff(ends)
        codes = np.where(counts > 0, np.diff(sums[ends]) / np.maximum(counts, 1), codes)
    return codes.astype(np.float32)


def nearest_codes(values: Float32[np.ndarray, "n c"], codebook: Float32[np.ndarray, " k"]) -> UInt8[np.ndarray, "n c"]:
    """Indices of the nearest numbers of a codebook in increasing order."""
    return np.searchsorted((codebook[1:] + codebook[:-1]) / 2, values).astype(np.uint8)


def find_palette(
    rows: Float32[np.ndarray, "n d"], largest: int = LARGEST_PALETTE
) -> tuple[Float32[np.ndarray, "k d"], Int64[np.ndarray, " n"]]:
    """Vectors that stand for rows, and the index of the one for each row.

    Equal rows, such as those of Gaussians without harmonics, count once. k is a power of 2 between half of the rows and
    all, 1024 to `largest` (at most 65536), or all if there are fewer. Rows are divided into 256 coarse cells and each
    of these on its own, so that the time grows with n sqrt(k), not n k (Lloyd 1982).
    """
    whole = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first_of, number_of = np.unique(whole, return_index=True, return_inverse=True)
    palette, labels = _palette_of_distinct(rows[first_of], largest)
    return palette, labels[number_of]


def _palette_of_distinct(
    rows: Float32[np.ndarray, "n d"], largest: int
) -> tuple[Float32[np.ndarray, "k d"], Int64[np.ndarray, " n"]]:
    n = len(rows)
    size = min(n, largest, max(_SMALLEST_PALETTE, 1 << (n.bit_length() - 1)))
    if size == n:
        return rows, np.arange(n)
    samples = rows[:: -(-n // _SAMPLES)]
    cells = _lloyd(samples, min(_COARSE_CELLS, size // 4), _COARSE_ROUNDS)
    cell_of = _nearest(rows, cells)
    order = np.argsort(cell_of, kind="stable")
    counts = np.bincount(cell_of, minlength=len(cells))
    shares = _shares(counts, size)
    palette: list[Float32[np.ndarray, "k d"]] = []
    labels = np.empty(n, np.int64)
    start = first = 0
    for count, share in zip(counts.tolist(), shares.tolist(), strict=True):
        members = order[start : start + count]
        start += count
        if count:
            own = _lloyd(rows[members], share, _FINE_ROUNDS)
            labels[members] = first + _nearest(rows[members], own)
            palette.append(own)
            first += share
    return np.concatenate(palette), labels


def _shares(counts: Int64[np.ndarray, " c"], size: int) -> Int64[np.ndarray, " c"]:
    """Divide `size` vectors among cells by their numbers of rows: at least one, at most one per row."""
    shares = np.minimum(np.maximum(counts * size // counts.sum(), 1), counts)
    spare = size - int(shares.sum())
    for cell in np.argsort(shares - counts, kind="stable")[: max(spare, 0)]:  # those with the most rows without
        shares[cell] += shares[cell] < counts[cell]
    return shares


def _lloyd(rows: Float32[np.ndarray, "n d"], size: int, rounds: int) -> Float32[np.ndarray, "k d"]:
    """Centers of `size` clusters, from a start at random rows, with the same random numbers each time."""
    if size >= len(rows):
        return rows
    centers = rows[np.sort(np.random.default_rng(0).choice(len(rows), size, replace=False))]
    for _ in range(rounds):
        labels = _nearest(rows, centers)
        order = np.argsort(labels, kind="stable")
        present, starts, counts = np.unique(labels[order], return_index=True, return_counts=True)
        sums: Float64[np.ndarray, "k d"] = np.add.reduceat(rows[order], starts, axis=0, dtype=np.float64)
        centers = centers.copy()
        centers[present] = (sums / counts[:, None]).astype(np.float32)
    return centers


def _nearest(rows: Float32[np.ndarray, "n d"], centers: Float32[np.ndarray, "k d"]) -> Int64[np.ndarray, " n"]:
    """Index of the nearest center of each row."""
    squares = 0.5 * np.einsum("ij,ij->i", centers, centers)
    step = max(1, _DISTANCES // len(centers))
    blocks = (rows[start : start + step] for start in range(0, len(rows), step))
    return np.concatenate([(squares - block @ centers.T).argmin(axis=1) for block in blocks])

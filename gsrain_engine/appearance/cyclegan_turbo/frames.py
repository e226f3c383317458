"""Pictures as the network takes them: sizes, tiles, and the way back to the clear picture's size."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32

from gsrain_engine.appearance.attention.window import Window

Picture = Float32[np.ndarray, "_ _ c"]


def frame_size(height: int, width: int, side_px: int | None, multiple: int) -> tuple[int, int]:
    """Height and width, multiples of `multiple`, at which the shorter side is about `side_px`; nothing is enlarged.

    Each side is rounded to the nearest multiple: proportions change by less than 1 % at 512 px with multiples of 8.
    """
    scale = 1.0 if side_px is None else min(side_px / min(height, width), 1.0)
    rows, columns = (max(round(side * scale / multiple), 1) for side in (height, width))
    return rows * multiple, columns * multiple


def resized(image: Picture, height: int, width: int) -> Picture:
    """Bring a picture (h, w, c) to another size: by area where it shrinks (nothing aliases), cubic where it grows."""
    if image.shape[:2] == (height, width):
        return image
    shrinks = height <= image.shape[0] and width <= image.shape[1]
    found = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
    return found.reshape(height, width, image.shape[2]).astype(np.float32)


def brought_back(made: Picture, seen: Picture, clear: Picture, detail: bool) -> Picture:
    """Bring what the network made of `seen` to the size of the clear picture that `seen` was made from; display, 0..1.

    With `detail`, what the clear picture has beyond `seen` is added: the top band of a Laplacian pyramid (Burt and
    Adelson 1983), since the transfer is about low frequencies.
    """
    height, width = clear.shape[:2]
    large = resized(made, height, width)
    if detail and made.shape != clear.shape:
        large = large + clear - resized(seen, height, width)
    return np.clip(large, 0, 1)


def tiles(height: int, width: int, tile_px: int, overlap_px: int, multiple: int) -> tuple[Window, ...]:
    """Cut a picture into windows of at most `tile_px` a side that overlap, all beginning at multiples of `multiple`."""
    tall, wide = min(tile_px, height), min(tile_px, width)
    rows, columns = _starts(height, tall, overlap_px, multiple), _starts(width, wide, overlap_px, multiple)
    return tuple(Window(top, left, tall, wide, (height, width)) for top in rows for left in columns)


def blended(parts: Sequence[Picture], windows: Sequence[Window], overlap_px: int) -> Picture:
    """Put tiles together again; where they overlap, each fades out towards its own border."""
    if len(parts) == 1:
        return parts[0]
    frame = windows[0].frame
    total = np.zeros((*frame, parts[0].shape[2]))
    weights = np.zeros((*frame, 1))
    for part, window in zip(parts, windows, strict=True):
        weight = _fade(window.height, overlap_px)[:, None, None] * _fade(window.width, overlap_px)[None, :, None]
        rows, columns = slice(window.top, window.top + window.height), slice(window.left, window.left + window.width)
        total[rows, columns] += weight * part
        weights[rows, columns] += weight
    return (total / weights).astype(np.float32)


def _starts(side: int, tile: int, overlap: int, multiple: int) -> list[int]:
    """Where tiles begin: as few as have the overlap, spread evenly."""
    if tile >= side:
        return [0]
    # Whole multiples: even steps below it, rounded down one by one, never get further apart than it.
    step = max((tile - overlap) // multiple, 1) * multiple
    count = math.ceil((side - tile) / step)
    return [(side - tile) * i // count // multiple * multiple for i in range(count)] + [side - tile]


def _fade(side: int, overlap: int) -> Float[np.ndarray, " n"]:
    """Raised cosine from nearly 0 at both ends to 1 within the overlap."""
    ramp = max(min(overlap, side // 2), 1)
    near_end = np.minimum(np.arange(side), np.arange(side)[::-1]) + 0.5
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(near_end / ramp, 1))

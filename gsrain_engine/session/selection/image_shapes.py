"""What a hand draws over the picture, as flags of its pixels."""

import math
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int32

Point = tuple[float, float]
"""A place in the picture: pixels to the right and downwards from its upper left corner."""

_SHIFT = 4
"""Bits behind the point in which OpenCV takes coordinates."""

_FARTHEST = 30_000.0
"""Pixels; what lies farther outside is drawn from here: OpenCV's numbers end at 2^31 / 2^4."""


def rectangle(first: Point, second: Point, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels whose centres lie between two opposite corners, in any order."""
    (left, right), (top, bottom) = (sorted(pair) for pair in zip(first, second, strict=True))
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    return np.logical_and.outer((top <= y) & (y <= bottom), (left <= x) & (x <= right))


def polygon(corners: Sequence[Point], width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels whose centres lie inside a closed line, by the even-odd rule."""
    # Each edge turns over everything to its right, in the rows that it crosses.
    turns = np.zeros((height, width + 1), np.uint8)
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        low, high = sorted((y0, y1))
        rows = np.arange(*(min(max(math.ceil(y - 0.5), 0), height) for y in (low, high)))
        if len(rows):
            crossings = x0 + (rows + 0.5 - y0) * ((x1 - x0) / (y1 - y0))
            turns[rows, np.clip(np.ceil(crossings - 0.5), 0, width).astype(np.int64)] ^= 1
    return np.ascontiguousarray(np.bitwise_xor.accumulate(turns, axis=1)[:, :width]).view(np.bool_)


def stroke(points: Sequence[Point], radius_px: float, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Pixels that a disc passes over as it is moved through the points."""
    picture = np.zeros((height, width), np.uint8)
    fixed = _fixed(points)
    radius = max(1, round(radius_px * (1 << _SHIFT)))
    for center in fixed.tolist():
        cv2.circle(picture, center, radius, (1,), cv2.FILLED, shift=_SHIFT)
    for start, end in pairwise(fixed):
        across = _across(start, end, radius)
        if across is not None:
            cv2.fillConvexPoly(picture, across, (1,), shift=_SHIFT)
    return picture.view(np.bool_)


def outlines(pixels: Bool[np.ndarray, "h w"]) -> list[Float64[np.ndarray, "_ 2"]]:
    """Closed lines around what is covered, and around holes in it, to half a pixel."""
    found, _ = cv2.findContours(pixels.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_TC89_L1)
    return [line.reshape(-1, 2) + 0.5 for line in found]


def _fixed(points: Sequence[Point]) -> Int32[np.ndarray, "k 2"]:
    """Places in OpenCV's numbers, where a pixel's centre has whole ones."""
    near = np.clip(np.array(points, np.float64).reshape(-1, 2), -_FARTHEST, _FARTHEST)
    return np.round((near - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _across(start: Int32[np.ndarray, "2"], end: Int32[np.ndarray, "2"], radius: int) -> Int32[np.ndarray, "4 2"] | None:
    """Corners of the band between two discs; None where they are the same."""
    way = (end - start).astype(np.float64)
    length = float(np.hypot(*way))
    if length == 0:
        return None
    side = radius / length * np.array([-way[1], way[0]])
    return np.round([start + side, end + side, end - side, start - side]).astype(np.int32)

"""The measured points of a capture that the viewport shows: a fair choice of them, with colours."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from gsrain_engine.datasets.capture import Capture

MOST_POINTS = 120_000
"""As many as software OpenGL draws in a few milliseconds."""

_PLAIN = (205, 210, 215)


@dataclass(frozen=True, slots=True, eq=False)
class ShownPoints:
    """In the capture's world."""

    positions: Float32[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    total: int
    """How many the capture has."""


def shown_points(capture: Capture) -> ShownPoints | None:
    """Choose points of a capture, at random where there are too many; None where it has none.

    Points with colours keep them; lidar is coloured by height, from blue to red.
    """
    rng = np.random.default_rng(0)
    given = 0 if capture.points_m is None else len(capture.points_m)
    total = given + sum(len(sweep.points_m) for sweep in capture.sweeps)
    if total == 0:
        return None
    share = min(1.0, MOST_POINTS / total)
    positions: list[np.ndarray] = []
    colors: list[np.ndarray] = []
    if capture.points_m is not None and given:
        chosen = _chosen(given, share, rng)
        positions.append(capture.points_m[chosen])
        plain = np.tile(np.array(_PLAIN, np.uint8), (len(chosen), 1))
        colors.append(plain if capture.point_colors is None else capture.point_colors[chosen])
    lidar = [sweep.points_m[_chosen(len(sweep.points_m), share, rng)] for sweep in capture.sweeps]
    if sum(map(len, lidar)):
        measured = np.concatenate(lidar).astype(np.float64)
        positions.append(measured)
        colors.append(_height_colors(measured @ np.asarray(capture.up)))
    return ShownPoints(np.concatenate(positions).astype(np.float32), np.concatenate(colors), total)


def _chosen(count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    return np.arange(count) if share >= 1 else np.sort(rng.choice(count, int(count * share), replace=False))


def _height_colors(heights: Float64[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    low, high = np.percentile(heights, (2, 98))
    shares = np.clip((heights - low) / max(high - low, 1e-9), 0, 1)
    turbo = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    return np.asarray(turbo[np.rint(shares * 255).astype(int)], np.uint8)

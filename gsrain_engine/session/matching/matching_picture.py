"""Correspondences as pictures to lay over the view: the other view warped, the difference, or what became of pixels."""

import matplotlib
import numpy as np
from jaxtyping import Float32, Int64, UInt8

from gsrain_engine.appearance.matching.correspondence import Outcome, warped

from .matched_views import MatchedViews
from .matching_colors import COLORS
from .mode import Mode

_VEIL: dict[Outcome, float] = {Outcome.OUTSIDE: 0.65, Outcome.UNKNOWN: 0.6, Outcome.MATCHED: 0.0}
_OTHER_VEIL = 0.5
_MARK = 0.45
_LARGEST_DIFFERENCE = 0.25
_SHADES = 256
_LINE_STEP_PX = 24


def matching_picture(matched: MatchedViews, mode: Mode) -> UInt8[np.ndarray, "h w 4"]:
    """Draw a correspondence for one mode: display colour, and how much it covers.

    picture: the other view as it is seen from here; unmatched pixels are dimmed, in the colour of their reason.
    difference: from none (black) to a quarter of full scale (white). pixels: only the colours of what became of them.
    """
    found = matched.found
    veils = np.array([_VEIL.get(each, _OTHER_VEIL) for each in Outcome], np.float32)
    colors = np.array([COLORS[each] for each in Outcome], np.float32)
    picture = np.concatenate([colors[found.outcome], veils[found.outcome][..., None]], axis=2)
    valid = found.valid
    if mode == "pixels":
        picture[valid, 3] = _MARK
    else:
        other = warped(matched.to.image, found)
        shown = other if mode == "picture" else _difference(other, matched.of.image)
        picture[valid] = np.concatenate([shown, np.ones_like(shown[..., :1])], axis=2)[valid]
    return np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)


def flow_lines(matched: MatchedViews) -> Float32[np.ndarray, "n 2 2"]:
    """Lines on a grid, from where a matched pixel is to where the other view has it, in shares of each picture."""
    places, valid = matched.found.places, matched.found.valid
    height, width = valid.shape
    rows, columns = (each.ravel() for each in np.mgrid[_middle(height), _middle(width)])
    kept = valid[rows, columns]
    rows, columns = rows[kept], columns[kept]
    start = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], axis=1)
    end = places[rows, columns] / np.array(matched.found.size[::-1], np.float32)
    return np.stack([start, end], axis=1).astype(np.float32)


def shares(matched: MatchedViews) -> dict[Outcome, float]:
    """Share of the picture of each outcome that there is."""
    counts: Int64[np.ndarray, " k"] = np.bincount(matched.found.outcome.ravel(), minlength=len(Outcome))
    return {each: float(counts[each] / counts.sum()) for each in COLORS if counts[each]}


def _middle(size: int) -> slice:
    return slice(size % _LINE_STEP_PX // 2 + _LINE_STEP_PX // 2, size, _LINE_STEP_PX)


def _difference(one: Float32[np.ndarray, "h w 3"], other: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    error = np.abs(one - other).mean(axis=2)
    shades = np.asarray(matplotlib.colormaps["magma"](np.linspace(0, 1, _SHADES)), np.float32)[:, :3]
    return shades[np.rint(np.clip(error / _LARGEST_DIFFERENCE, 0, 1) * (_SHADES - 1)).astype(int)]

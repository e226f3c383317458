"""Finds the pixels of views that show the sky: from the data set where it tells, else by colour, place and lidar."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.ndimage import binary_dilation

from ..capture import View
from .view_rays import elevations

_LOWEST = float(np.sin(np.radians(1.0)))
"""Sine of the elevation above which there may be sky."""
_SMOOTH = 0.03
"""Standard deviation of brightness (0..1) in a small window up to which a surface is smooth."""
_BRIGHT, _DARKEST, _BLUE = 0.62, 0.2, 0.03
_LEAST_OF_BRIGHTEST = 0.5
"""A sky is at least so bright, beside the brightest twentieth of what is above the horizon."""
_LEAST_PART = 0.004
"""Of a picture that a patch of sky must fill unless it touches the upper edge."""
_LIKELY = 0.75
_BINS = 12


def sky_masks(
    views: Sequence[View],
    depths_m: Sequence[Float32[np.ndarray, "_ _"]],
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> list[Bool[np.ndarray, "_ _"]]:
    """Which pixels of each view show the sky; `View.sky` where all views have it.

    Else a first guess, smooth patches above the horizon that are bright or blue and where the lidar saw nothing, tells
    the sky's colours by histogram against those of all else above the horizon; a pixel there whose colour is likelier
    to be sky then counts, through gaps of leaves too. All views together, so that one without sky invents none.

    Args:
        views: Without distortion.
        depths_m: What was measured in each view, 0 where nothing was: no sky is there.
        up: Upward direction in the capture's world.
    """
    told = [view.sky for view in views]
    if all(sky is not None for sky in told):
        return [sky for sky in told if sky is not None]
    guesses: list[Bool[np.ndarray, "_ _"]] = []
    chances: list[Bool[np.ndarray, "_ _"]] = []
    above: list[Bool[np.ndarray, "_ _"]] = []
    bins: list[np.ndarray] = []
    for view, depth in zip(views, depths_m, strict=True):
        image = view.image
        above.append(elevations(view.camera, up) > _LOWEST)
        chance = above[-1] & ~_measured(depth)
        guesses.append(_first_guess(image, chance if view.mask is None else chance & view.mask))
        chances.append(chance)
        bins.append(_color_bins(image))
    likely = _likely_colors(bins, guesses, above)
    if likely is None:
        return [np.zeros_like(guess) for guess in guesses]
    return [
        _tidied((chance & likely[bin_]) | guess) for chance, bin_, guess in zip(chances, bins, guesses, strict=True)
    ]


def _measured(depth: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels near a measured one: beams are several pixels apart."""
    reach = max(depth.shape[1] // 160, 1)
    return binary_dilation(depth > 0, iterations=reach)


def _first_guess(image: UInt8[np.ndarray, "h w 3"], chance: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    color = image.astype(np.float32) / 255
    bright = color.mean(axis=2)
    mean = cv2.blur(bright, (5, 5))
    spread = np.sqrt(np.maximum(cv2.blur(bright * bright, (5, 5)) - mean * mean, 0))
    darkest = max(_DARKEST, _LEAST_OF_BRIGHTEST * float(np.quantile(bright[chance], 0.95))) if chance.any() else 1.0
    blue = (color[..., 2] - color[..., 0] > _BLUE) & (color[..., 2] >= color[..., 1]) & (bright > darkest)
    candidates = chance & (spread < _SMOOTH) & ((bright > _BRIGHT) | blue)
    count, patches = cv2.connectedComponents(candidates.astype(np.uint8), connectivity=4)
    sizes = np.bincount(patches.ravel(), minlength=count)
    large = sizes >= _LEAST_PART * chance.size
    touching = np.zeros(count, np.bool_)
    touching[np.unique(patches[0])] = True
    counts = large | (touching & (sizes >= 0.1 * _LEAST_PART * chance.size))
    counts[0] = False
    return counts[patches]


def _color_bins(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    steps = (image.astype(np.int64) * _BINS) >> 8
    return (steps[..., 0] * _BINS + steps[..., 1]) * _BINS + steps[..., 2]


def _likely_colors(
    bins: Sequence[np.ndarray],
    guesses: Sequence[Bool[np.ndarray, "_ _"]],
    above: Sequence[Bool[np.ndarray, "_ _"]],
) -> Bool[np.ndarray, " b"] | None:
    """Which colours are the sky's rather than those of what else is above the horizon; None where no sky was found."""
    count = _BINS**3
    other = [high & ~guess for high, guess in zip(above, guesses, strict=True)]
    sky = sum((np.bincount(b[g], minlength=count) for b, g in zip(bins, guesses, strict=True)), np.zeros(count))
    rest = sum((np.bincount(b[o], minlength=count) for b, o in zip(bins, other, strict=True)), np.zeros(count))
    if sky.sum() < 0.001 * (sky.sum() + rest.sum()):
        return None
    return sky / np.maximum(sky + rest, 1) > _LIKELY


def _tidied(sky: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Without specks in either."""
    return cv2.medianBlur(sky.astype(np.uint8), 3) > 0

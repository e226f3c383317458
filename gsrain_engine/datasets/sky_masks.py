"""Sky masks of views, from the dataset if available, otherwise from color, position and lidar.

`certain_sky` needs a single image, and marks only certain sky.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8
from scipy.ndimage import binary_dilation

from .capture import CaptureFrame
from .masks import elevations

_LOWEST = float(np.sin(np.radians(1.0)))  # sine of the minimum elevation of sky
_SMOOTH = 0.03  # maximum standard deviation of brightness (0..1) in a small window of a smooth surface
_BRIGHT, _DARKEST, _BLUE = 0.62, 0.2, 0.03
_MIN_OF_BRIGHTEST = 0.5  # minimum brightness of sky relative to the brightest twentieth above the horizon
_MIN_PART = 0.004  # minimum share of the image for a patch of sky that doesn't touch the upper edge
_LIKELY = 0.75
_BINS = 12
_WIDTH = 320
"""Width in pixels of the small image for `certain_sky`; the constants below refer to it, with colors in CIELAB."""

_EVEN, _SOFT = 1.5, 3.5
"""Maximum color step a pixel of an even region, and within one sky: unlike roofs and twigs, clouds have soft edges."""

_BLUE_B, _PAINT_CHROMA, _PALE_CHROMA, _WARM_B, _WARM_LIGHT = -5.0, 62.0, 16.0, 20.0, 85.0
"""Maximum b* of blue, minimum chroma of paint, maximum chroma of white or gray; b* and lightness of a sunset sky."""

_SMALLEST = 0.003  # minimum share of the image for a patch of sky
_TOP, _MIN_TOP = 0.02, 0.02
"""Fraction of the image height that counts as upper edge, and minimum fraction of the edge that a sky fills."""

_LOWEST_ROW = 0.75  # fraction of the image height above which a sky ends; a patch that extends lower includes road
_EVEN_SHARE, _GRAIN = 0.4, 0.8  # minimum share of even pixels in a sky, and its maximum median grain of lightness
_BLUE_PER_SURE, _BRIGHT_PER_SURE, _WORST_LEAD, _WHITE, _FOR_WHITE = 10.0, 8.0, -2.0, 97.0, 0.6
"""Blueness and lead in lightness over the brightest tenth of the rest, each worth one point; minimum points of the lead
(white objects); lightness that counts as white, and the points for it: sensors clip skies first.
"""

_DIM, _BRIGHT_SKY, _FINE_GRAIN, _DEEP_BLUE = 60.0, 80.0, 0.35, 15.0
"""Lightness below which only deep blue is sky, and below which other skies must have fine grain; that grain; blueness
of deep blue.
"""

_COOL, _SUNLIT_WALL = 3.0, 10.0
"""b* below which a sky excludes patches with b* above the second value: those are sunlit walls."""

_SURE = (0.3, 0.9)  # scores from which a patch may be sky, and from which it is certain
_MIN_SURENESS = 0.5
_WIRE, _WIRES = 8, 3
"""Width in pixels of a blurred wire, which may divide a sky, and maximum number of wires one below the other."""

_BODY = 7  # minimum width in pixels of a connection: soft edges of gray trucks and bright ledges of walls are narrower
_MIXED = (0.75, 0.45)
"""Minimum fractions of the surrounding sky's lightness and blue for a mixture of twigs and sky, unlike blue cars."""

_ALIKE = 12.0  # maximum color difference from certain sky of another sky patch at the upper edge
_AMIDST, _SPREAD_PX, _BLUE_ROUNDS, _PALE_ROUNDS, _GAP_DISTANCE, _RIM_DISTANCE = 0.3, 6.0, 8, 2, 9.0, 14.0
"""For gaps between wires or twigs: minimum share of surrounding sky, radius in pixels, rounds for blue and for pale
skies, maximum color difference; last, that difference for the rim lost by smoothing.
"""


class CertainSky(NamedTuple):
    """Certain sky of an image."""

    pixels: Bool[np.ndarray, "h w"]
    sureness: float
    """From 0.5 (just certain enough) to 1, the mean over its patches; 0 without sky."""


def sky_masks(
    views: Sequence[CaptureFrame],
    depths_m: Sequence[Float32[np.ndarray, "_ _"]],
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> list[Bool[np.ndarray, "_ _"]]:
    """Sky pixels of each view; `CaptureFrame.sky` if all views have it.

    Otherwise a first guess (smooth patches above the horizon that are bright or blue and without lidar points) gives
    color histograms of the sky and of everything else above the horizon; pixels there count as sky if their color is
    more likely sky, also in gaps between leaves. The histograms cover all views, so that views without sky get none.

    Args:
        views: Without distortion.
        depths_m: Measured depth in each view, 0 without a measurement; measured pixels are not sky.
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


def certain_sky(image: UInt8[np.ndarray, "h w 3"]) -> CertainSky:
    """Mark the sky of a single image; uncertain sky is not marked.

    A sky is connected with the upper edge by soft color steps (clouds with the blue around them), is even, has no
    grain, and is bluer or brighter than nearly everything else; walls, trucks and lamps lack one of these properties.
    Enclosed gaps between wires and twigs are included if they have the sky's color.

    Args:
        image: Display color (sRGB), upright.
    """
    height, width = image.shape[:2]
    size = (_WIDTH, max(round(height * _WIDTH / width), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if width > _WIDTH else cv2.INTER_LINEAR)
    lab = np.asarray(cv2.cvtColor(small.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)
    soft = np.asarray(cv2.GaussianBlur(lab, (0, 0), 1.0), np.float32)
    step = _color_step(np.asarray(cv2.GaussianBlur(lab, (0, 0), 0.6), np.float32))
    joined = (_sky_like(soft) & (step < _SOFT)).astype(np.uint8)
    window = np.ones((_BODY, _BODY), np.uint8)  # removes connections narrower than that
    parts = cv2.connectedComponents(cv2.morphologyEx(joined, cv2.MORPH_OPEN, window), connectivity=4)
    labels = np.asarray(parts[1], np.int64)
    likely = _from_the_upper_edge(labels, parts[0])
    rest = _NotSky.of(soft[~np.isin(labels, likely)])
    sky, total = np.zeros(labels.shape, np.bool_), 0.0
    for label in likely:
        patch = labels == label
        sureness = _sureness(patch, lab, soft, step, rest)
        if sureness >= _MIN_SURENESS:
            sky |= patch
            total += sureness * float(np.count_nonzero(patch))
    if not sky.any():
        return CertainSky(np.zeros((height, width), np.bool_), 0.0)
    tone = np.median(lab[sky], axis=0)
    for label in likely:  # parts that a pole separates from a certain sky
        patch = labels == label
        if _is_even(patch, lab, soft, step) and np.linalg.norm(np.median(lab[patch], axis=0) - tone) < _ALIKE:
            sky |= patch
    if tone[2] < _COOL:
        for label in likely:
            patch = labels == label
            if np.median(lab[patch][:, 2]) > _SUNLIT_WALL:
                sky &= ~patch
    for _ in range(_WIRES):
        for label in _under_wires(sky, labels, parts[0]):
            patch = labels == label
            sureness = _sureness(patch, lab, soft, step, rest)
            color = np.median(lab[patch], axis=0) - np.median(lab[sky], axis=0)
            if sureness >= _MIN_SURENESS and np.linalg.norm(color) < _GAP_DISTANCE:
                sky |= patch
                total += sureness * float(np.count_nonzero(patch))
    sureness = total / float(np.count_nonzero(sky))
    sky = _with_gaps_and_rim(sky, lab)
    return CertainSky(
        cv2.resize(sky.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5, sureness
    )


class _NotSky(NamedTuple):
    """Statistics of all pixels that can't be sky."""

    brightest: float
    """Lightness that a tenth of the pixels exceeds."""
    blue_cast: float
    """Median b* if blue, otherwise 0: shaded surfaces are lit by the sky."""

    @classmethod
    def of(cls, lab: Float32[np.ndarray, "n 3"]) -> "_NotSky":
        if not len(lab):
            return cls(0.0, 0.0)
        return cls(float(np.quantile(lab[:, 0], 0.9)), min(float(np.median(lab[:, 2])), 0.0))


def _color_step(lab: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Largest color step a pixel, over all directions."""
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *which, scale=1 / 8) for which in ((1, 0), (0, 1)))
    return np.sqrt((np.asarray(across) ** 2 + np.asarray(down) ** 2).sum(axis=-1)).astype(np.float32)


def _sky_like(lab: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Mask of pixels that are blue, cloud-pale or sunset-warm, and not dark relative to the brightest."""
    light, green_red, yellow = (lab[..., i] for i in range(3))
    bright = float(np.quantile(light, 0.95))
    chroma = np.hypot(green_red, yellow)
    blue = (yellow < _BLUE_B) & (green_red < 20) & (chroma < _PAINT_CHROMA) & (light > 30)
    pale = (chroma < _PALE_CHROMA) & (green_red > -13) & (light > max(50, 0.75 * bright))
    warm = (yellow > 0) & (yellow < _WARM_B) & (np.abs(green_red) < 12) & (light > max(_WARM_LIGHT, 0.85 * bright))
    return blue | pale | warm


def _from_the_upper_edge(labels: Int64[np.ndarray, "h w"], count: int) -> list[int]:
    """Labels of sufficiently large patches that begin at the upper edge."""
    rows = max(2, round(_TOP * labels.shape[0]))
    sizes = np.bincount(labels.ravel(), minlength=count)
    return [
        label
        for label in np.unique(labels[:rows]).tolist()
        if label and sizes[label] >= _SMALLEST * labels.size and (labels[:rows] == label).any(axis=0).mean() >= _MIN_TOP
    ]


def _under_wires(sky: Bool[np.ndarray, "h w"], labels: Int64[np.ndarray, "h w"], count: int) -> list[int]:
    """Labels of large patches separated from the sky above by no more than a wire in most columns."""
    sizes = np.bincount(labels.ravel(), minlength=count)
    near = cv2.dilate(sky.astype(np.uint8), np.ones((2 * _WIRE + 1, 1), np.uint8)) > 0
    found: list[int] = []
    for label in np.flatnonzero(sizes >= _SMALLEST * labels.size).tolist():
        patch = labels == label
        if label and not (patch & sky).any():
            columns = np.flatnonzero(patch.any(axis=0))
            if near[patch.argmax(axis=0)[columns], columns].mean() >= 0.5:
                found.append(label)
    return found


def _sureness(
    patch: Bool[np.ndarray, "h w"],
    lab: Float32[np.ndarray, "h w 3"],
    soft: Float32[np.ndarray, "h w 3"],
    step: Float32[np.ndarray, "h w"],
    rest: _NotSky,
) -> float:
    """Rate a patch from 0 to 1: evenness and extent are required, blueness and lightness add up."""
    if not _is_even(patch, lab, soft, step):
        return 0.0
    light, _, yellow = (float(each) for each in np.median(lab[patch], axis=0))
    blueness = rest.blue_cast - yellow
    is_doubtful = light < _BRIGHT_SKY and _grain(patch, lab, soft) > _FINE_GRAIN
    if blueness < _DEEP_BLUE and (light < _DIM or is_doubtful):
        return 0.0
    lead = max((light - rest.brightest) / _BRIGHT_PER_SURE, _WORST_LEAD)
    sure = blueness / _BLUE_PER_SURE + lead + _FOR_WHITE * (light >= _WHITE)
    low, high = _SURE
    return float(np.clip((sure - low) / (high - low), 0, 1))


def _is_even(
    patch: Bool[np.ndarray, "h w"],
    lab: Float32[np.ndarray, "h w 3"],
    soft: Float32[np.ndarray, "h w 3"],
    step: Float32[np.ndarray, "h w"],
) -> bool:
    """Return whether a patch has no grain, mostly soft steps, and ends above the road."""
    if np.flatnonzero(patch.any(axis=1))[-1] > _LOWEST_ROW * patch.shape[0]:
        return False
    return bool((step[patch] < _EVEN).mean() >= _EVEN_SHARE and _grain(patch, lab, soft) <= _GRAIN)


def _grain(
    patch: Bool[np.ndarray, "h w"], lab: Float32[np.ndarray, "h w 3"], soft: Float32[np.ndarray, "h w 3"]
) -> float:
    """Median lightness difference from the surroundings inside a patch; larger for stone than for cloud."""
    inner = cv2.erode(patch.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return float(np.median(np.abs(lab[..., 0] - soft[..., 0])[inner])) if inner.any() else np.inf


def _with_gaps_and_rim(sky: Bool[np.ndarray, "h w"], lab: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Add the sky's border, and gaps between wires and twigs by their color.

    White has few rounds because it may continue as a wall. Deep blue is distinguishable far into a tree, also mixed
    with its twigs; blue paint is excluded because it is even.
    """
    is_blue = np.median(lab[sky][:, 2]) < -_DEEP_BLUE
    twigs = cv2.blur(_color_step(lab), (7, 7)) > _SOFT
    for each in [_GAP_DISTANCE] * (_BLUE_ROUNDS if is_blue else _PALE_ROUNDS) + [_RIM_DISTANCE]:
        color, around = _around(lab, sky)
        shows = np.linalg.norm(lab - color, axis=-1) < each
        if is_blue:
            shows |= twigs & (lab[..., [0, 2]] / color[..., [0, 2]] > _MIXED).all(axis=-1)
        sky = sky | (shows & (around > _AMIDST))
    return sky


def _around(
    lab: Float32[np.ndarray, "h w 3"], sky: Bool[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """Mean color of the sky around each pixel, and its share there."""
    weight = sky.astype(np.float32)
    share = np.asarray(cv2.GaussianBlur(weight, (0, 0), _SPREAD_PX), np.float32)
    color = np.asarray(cv2.GaussianBlur(lab * weight[..., None], (0, 0), _SPREAD_PX))
    return (color / np.maximum(share, 1e-4)[..., None] - np.float32(1e-6)).astype(np.float32), share


def _measured(depth: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels near a measured one, because beams are several pixels apart."""
    reach = max(depth.shape[1] // 160, 1)
    return binary_dilation(depth > 0, iterations=reach)


def _first_guess(image: UInt8[np.ndarray, "h w 3"], chance: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    color = image.astype(np.float32) / 255
    bright = color.mean(axis=2)
    mean = cv2.blur(bright, (5, 5))
    spread = np.sqrt(np.maximum(cv2.blur(bright * bright, (5, 5)) - mean * mean, 0))
    darkest = max(_DARKEST, _MIN_OF_BRIGHTEST * float(np.quantile(bright[chance], 0.95))) if chance.any() else 1.0
    blue = (color[..., 2] - color[..., 0] > _BLUE) & (color[..., 2] >= color[..., 1]) & (bright > darkest)
    candidates = chance & (spread < _SMOOTH) & ((bright > _BRIGHT) | blue)
    count, patches = cv2.connectedComponents(candidates.astype(np.uint8), connectivity=4)
    sizes = np.bincount(patches.ravel(), minlength=count)
    large = sizes >= _MIN_PART * chance.size
    touching = np.zeros(count, np.bool_)
    touching[np.unique(patches[0])] = True
    counts = large | (touching & (sizes >= 0.1 * _MIN_PART * chance.size))
    counts[0] = False
    return counts[patches]


def _color_bins(image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    steps = (image.astype(np.int64) * _BINS) >> 8
    return (steps[..., 0] * _BINS + steps[..., 1]) * _BINS + steps[..., 2]


def _likely_colors(
    bins: Sequence[np.ndarray], guesses: Sequence[Bool[np.ndarray, "_ _"]], above: Sequence[Bool[np.ndarray, "_ _"]]
) -> Bool[np.ndarray, " b"] | None:
    """Mask of colors that are sky rather than anything else above the horizon; None if no sky was found."""
    count = _BINS**3
    other = [high & ~guess for high, guess in zip(above, guesses, strict=True)]
    sky = sum((np.bincount(b[g], minlength=count) for b, g in zip(bins, guesses, strict=True)), np.zeros(count))
    rest = sum((np.bincount(b[o], minlength=count) for b, o in zip(bins, other, strict=True)), np.zeros(count))
    if sky.sum() < 0.001 * (sky.sum() + rest.sum()):
        return None
    return sky / np.maximum(sky + rest, 1) > _LIKELY


def _tidied(sky: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Remove specks from the sky and its complement."""
    return cv2.medianBlur(sky.astype(np.uint8), 3) > 0

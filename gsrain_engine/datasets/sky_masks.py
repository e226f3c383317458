"""Finds the pixels of views that show the sky: from the data set where it tells, else by colour, place and lidar.

`certain_sky` needs nothing but one picture, and marks only what is surely sky.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8
from scipy.ndimage import binary_dilation

from .capture import CaptureFrame
from .masks import elevations

_LOWEST = float(np.sin(np.radians(1.0)))
"""Sine of the elevation above which there may be sky."""

_SMOOTH = 0.03
"""Standard deviation of brightness (0..1) in a small window up to which a surface is smooth."""

_BRIGHT, _DARKEST, _BLUE = 0.62, 0.2, 0.03

_MIN_OF_BRIGHTEST = 0.5
"""A sky is at least so bright, beside the brightest twentieth of what is above the horizon."""

_MIN_PART = 0.004
"""Of a picture that a patch of sky must fill unless it touches the upper edge."""

_LIKELY = 0.75

_BINS = 12

_WIDTH = 320
"""Pixels across the small picture in which `certain_sky` looks; the numbers below are of it, colours in CIELAB."""

_EVEN, _SOFT = 1.5, 3.5
"""Steps of colour a pixel up to which a place is even, and up to which it may belong to one sky: clouds have no hard
edges, roofs and twigs have."""

_BLUE_B, _PAINT_CHROMA, _PALE_CHROMA, _WARM_B, _WARM_LIGHT = -5.0, 62.0, 16.0, 20.0, 85.0
"""b* below which something is blue, chroma from which that is paint, chroma below which something is white or gray;
b* and lightness of a sky at sunset."""

_SMALLEST = 0.003
"""Share of the picture from which a patch may be sky by itself."""

_TOP, _MIN_TOP = 0.02, 0.02
"""Part of the picture's height that counts as its upper edge, and part of the edge that a sky fills."""

_LOWEST_ROW = 0.75
"""Part of the picture's height below which no sky ends: a patch that does has run over into a road."""

_EVEN_SHARE, _GRAIN = 0.4, 0.8
"""Least share of even pixels in a sky, and largest median grain of its lightness."""

_BLUE_PER_SURE, _BRIGHT_PER_SURE, _WORST_LEAD, _WHITE, _FOR_WHITE = 10.0, 8.0, -2.0, 97.0, 0.6
"""Blueness and lead in lightness over the brightest tenth of all else that each make a patch surely sky, the most that
white things can speak against it, and what a patch gets that is as light as can be: sensors clip skies first."""

_DIM, _BRIGHT_SKY, _FINE_GRAIN, _DEEP_BLUE = 60.0, 80.0, 0.35, 15.0
"""Lightness under which only a deep blue is a sky, lightness under which a sky that is not of a deep blue has no more
than the finest grain, and blueness from which that blue is deep."""

_COOL, _SUNLIT_WALL = 3.0, 10.0
"""b* of a sky below which it has no part over the other: that is a wall in the sun."""

_SURE = (0.3, 0.9)
"""Sum of these from which a patch may be sky, and from which it is."""

_MIN_SURENESS = 0.5

_WIRE, _WIRES = 8, 3
"""Pixels across a wire with its blur, which may part a sky in two, and so many of them one under the other."""

_BODY = 7
"""Pixels across what hangs together: the edge of a gray truck is soft for a few, where a cloud of its gray is behind
it, and bright ledges of a wall run out of a sky."""

_MIXED = (0.75, 0.45)
"""Parts of the light and of the blue of the sky around twigs from which a mixture with them shows it; blue cars under a
sky are darker."""

_ALIKE = 12.0
"""Difference of colour from a sure sky up to which another patch at the upper edge is one."""

_AMIDST, _SPREAD_PX, _BLUE_ROUNDS, _PALE_ROUNDS, _GAP_DISTANCE, _RIM_DISTANCE = 0.3, 6.0, 8, 2, 9.0, 14.0
"""Share of sky around a gap between wires or twigs from which it shows the sky too, over how many pixels that is
counted, how often, and how near its colour must be; the same for the rim that the smoothing took."""


class CertainSky(NamedTuple):
    """The part of a picture that is surely sky."""

    pixels: Bool[np.ndarray, "h w"]
    sureness: float
    """From 0.5 (just sure enough) to 1, the mean over its patches; 0 where no sky is marked."""


def sky_masks(
    views: Sequence[CaptureFrame],
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


def certain_sky(image: UInt8[np.ndarray, "h w 3"]) -> CertainSky:
    """Mark the sky of a picture of which nothing else is known; where it is not sure, nothing is marked.

    A sky hangs together with the upper edge over soft steps of colour, clouds with the blue around them, is even and
    without grain, and is bluer or brighter than nearly all else: walls, trucks and lamps miss one of these. Gaps
    between wires and twigs in its midst count if they have its colour.

    Args:
        image: Display colour (sRGB), upright.
    """
    height, width = image.shape[:2]
    size = (_WIDTH, max(round(height * _WIDTH / width), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if width > _WIDTH else cv2.INTER_LINEAR)
    lab = np.asarray(cv2.cvtColor(small.astype(np.float32) / 255, cv2.COLOR_RGB2LAB), np.float32)
    soft = np.asarray(cv2.GaussianBlur(lab, (0, 0), 1.0), np.float32)
    step = _color_step(np.asarray(cv2.GaussianBlur(lab, (0, 0), 0.6), np.float32))
    joined = (_sky_like(soft) & (step < _SOFT)).astype(np.uint8)
    window = np.ones((_BODY, _BODY), np.uint8)  # what hangs together by less than that does not
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
    for label in likely:  # what a pole parts from a sure sky
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
    """All of a picture that can't be its sky."""

    brightest: float
    """Lightness that a tenth of it exceeds."""
    blue_cast: float
    """Its median b* where that is blue, else 0: what stands in the shade is lit by the sky."""

    @classmethod
    def of(cls, lab: Float32[np.ndarray, "n 3"]) -> "_NotSky":
        if not len(lab):
            return cls(0.0, 0.0)
        return cls(float(np.quantile(lab[:, 0], 0.9)), min(float(np.median(lab[:, 2])), 0.0))


def _color_step(lab: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Largest step of colour a pixel, over all directions."""
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *which, scale=1 / 8) for which in ((1, 0), (0, 1)))
    return np.sqrt((np.asarray(across) ** 2 + np.asarray(down) ** 2).sum(axis=-1)).astype(np.float32)


def _sky_like(lab: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Blue, or as pale as cloud, or as warm as a low sun, and not dark beside the brightest of the picture."""
    light, green_red, yellow = (lab[..., i] for i in range(3))
    bright = float(np.quantile(light, 0.95))
    chroma = np.hypot(green_red, yellow)
    blue = (yellow < _BLUE_B) & (green_red < 20) & (chroma < _PAINT_CHROMA) & (light > 30)
    pale = (chroma < _PALE_CHROMA) & (green_red > -13) & (light > max(50, 0.75 * bright))
    warm = (yellow > 0) & (yellow < _WARM_B) & (np.abs(green_red) < 12) & (light > max(_WARM_LIGHT, 0.85 * bright))
    return blue | pale | warm


def _from_the_upper_edge(labels: Int64[np.ndarray, "h w"], count: int) -> list[int]:
    """Labels of patches large enough to be judged that begin at the upper edge."""
    rows = max(2, round(_TOP * labels.shape[0]))
    sizes = np.bincount(labels.ravel(), minlength=count)
    return [
        label
        for label in np.unique(labels[:rows]).tolist()
        if label and sizes[label] >= _SMALLEST * labels.size and (labels[:rows] == label).any(axis=0).mean() >= _MIN_TOP
    ]


def _under_wires(sky: Bool[np.ndarray, "h w"], labels: Int64[np.ndarray, "h w"], count: int) -> list[int]:
    """Labels of large patches that most of their columns part from the sky above by no more than a wire."""
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
    """Rate a patch at the upper edge from 0 to 1: evenness and extent are conditions, blueness and light add up."""
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
    """Whether a patch has no grain, mostly soft steps, and ends above the road."""
    if np.flatnonzero(patch.any(axis=1))[-1] > _LOWEST_ROW * patch.shape[0]:
        return False
    return bool((step[patch] < _EVEN).mean() >= _EVEN_SHARE and _grain(patch, lab, soft) <= _GRAIN)


def _grain(
    patch: Bool[np.ndarray, "h w"], lab: Float32[np.ndarray, "h w 3"], soft: Float32[np.ndarray, "h w 3"]
) -> float:
    """Median difference of lightness from what is around, inside a patch; that of stone is larger than of cloud."""
    inner = cv2.erode(patch.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return float(np.median(np.abs(lab[..., 0] - soft[..., 0])[inner])) if inner.any() else np.inf


def _with_gaps_and_rim(sky: Bool[np.ndarray, "h w"], lab: Float32[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Add what shows the sky between wires and twigs by its colour, and its border.

    White may go on as a wall. A deep blue is told from all else far into a tree, mixed with its twigs too; blue paint
    is even.
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
    """Mean colour of the sky around each pixel, and its share there."""
    weight = sky.astype(np.float32)
    share = np.asarray(cv2.GaussianBlur(weight, (0, 0), _SPREAD_PX), np.float32)
    color = np.asarray(cv2.GaussianBlur(lab * weight[..., None], (0, 0), _SPREAD_PX))
    return (color / np.maximum(share, 1e-4)[..., None] - np.float32(1e-6)).astype(np.float32), share


def _measured(depth: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels near a measured one: beams are several pixels apart."""
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

"""Unlabeled pairs: a real frame of rain beside our rain over another frame of the same place, in random order."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from gsrain_engine.datasets.rainsense import RainSequence
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.sensor import load_sensor

from .comparison import drop_levels, plain_noise, rain_before, slow_light
from .photograph import Window, cropped_camera, photographed, rain_over, rain_shares
from .rain_free import below_black, rain_free_frames
from .streaks import MedianResiduals, median_residuals

PAIRS = 40
PAIR_CROP = (590, 400)
_GAP_PX = 12
_FRAMES = 40
"""Frames in a row: streaks are replaced by pixels of the nearest ones."""
_MIN_STILL = 0.4
_DARK_LEVELS, _MIN_DARK = 96, 0.4
_DRIP_PX = (4.0, 24.0)  # across and along a column of dripping water
_DRIP_FACTOR, _DRIP_DARKER, _MAX_DRIPS = 5.0, 0.2, 0.004
"""Water drips where the third moment of changes is so many times that of other dark places, and that of darker changes
at most such a share of it; largest share of a crop."""
_VEIL_PX = 63
_TRIES = 300
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


class RainyPlace(NamedTuple):
    """One sequence with rain, and our rain in its air."""

    sequence: RainSequence
    rain: RainSettings
    exposure_s: float
    window: Window
    middle_frame: int | None = None


class Pair(NamedTuple):
    """Two crops of the same place, real and ours, in random order."""

    picture: UInt8[np.ndarray, "h w 3"]
    sequence: str
    frame: int
    real_side: str
    """left or right."""


def unlabeled_pairs(places: Sequence[RainyPlace], count: int, seed: int = 0) -> Iterator[Pair]:
    """Make pairs from places in turn, with crops before dark backgrounds, far from one another.

    Ours is rain over a real frame whose streaks are replaced (see `rain_free_frames`), with the noise, the motion and
    the compression of the camera; both halves are compressed once more. No crop shows water that drips from ledges or
    leaves at the same place in many frames: it is no rain. A frame is either shown or gets our rain, and as long as
    there are enough of them in one pair only: no streak is in two pictures.
    """
    rainy = [place for place in places if place.sequence.intensity_mm_h > 0]
    shares = [(count - k + len(rainy) - 1) // len(rainy) for k in range(len(rainy))]
    made = [
        _pairs_of(*each, np.random.default_rng((seed, k))) for k, each in enumerate(zip(rainy, shares, strict=True))
    ]
    for number in range(count):
        yield made[number % len(rainy)][number // len(rainy)]


def _pairs_of(place: RainyPlace, count: int, random: np.random.Generator) -> list[Pair]:
    sequence, window = place.sequence, place.window
    x, y, width, height = window
    part = (slice(y, y + height), slice(x, x + width))
    numbers = _in_a_row(len(sequence), place.middle_frame)
    colors = [np.ascontiguousarray(sequence.picture(k)[part]) for k in numbers]
    found = median_residuals(np.stack([sequence.gray_image(k)[part] for k in numbers]))
    order = random.permutation(len(numbers))
    shown = [int(order[k % (len(order) // 2)]) for k in range(count)]
    behind = [int(order[len(order) // 2 + k % (len(order) // 2)]) for k in range(count)]
    ours = _rainy(place, numbers, colors, found, shown, behind)
    dripping = _dripping(found)
    corners: list[tuple[int, int]] = []
    pairs: list[Pair] = []
    for frame, picture in zip(shown, ours, strict=True):
        corners.append(_dark_corner(found, dripping, corners, random))
        left, top = corners[-1]
        crop = (slice(top, top + PAIR_CROP[1]), slice(left, left + PAIR_CROP[0]))
        real_first = bool(random.integers(2))
        halves = [_stored(colors[frame], place)[crop], picture[crop]][:: 1 if real_first else -1]
        gap = np.full((halves[0].shape[0], _GAP_PX, 3), 255, np.uint8)
        together = np.concatenate([halves[0], gap, halves[1]], axis=1)
        pairs.append(Pair(together, sequence.name, numbers[frame], "left" if real_first else "right"))
    return pairs


def _in_a_row(length: int, middle: int | None) -> range:
    """Numbers of frames around one or the middle of a sequence."""
    count = min(length, _FRAMES)
    first = (length // 2 if middle is None else middle) - count // 2
    first = min(max(first, 0), length - count)
    return range(first, first + count)


def _rainy(
    place: RainyPlace,
    numbers: Sequence[int],
    colors: Sequence[UInt8[np.ndarray, "h w 3"]],
    found: MedianResiduals,
    shown: Sequence[int],
    behind: Sequence[int],
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Render rain at the times of frames that are shown, over other frames."""
    sequence, camera = place.sequence, place.sequence.camera
    drop = drop_levels(sequence, numbers, place.rain, place.window)
    falling = rain_before(camera, place.rain, place.exposure_s)
    sensor = falling.picture_sensor
    visible: Bool[np.ndarray, "h w"] = found.median < drop @ _LUMA
    backgrounds = rain_free_frames(colors, found, slow_light(found.values), behind, visible)
    below, noise = below_black(backgrounds), plain_noise(found, falling, camera.height)
    times = [sequence.times_s[numbers[k]] for k in shown]
    made: list[UInt8[np.ndarray, "h w 3"]] = []
    shares = np.stack(list(rain_shares(cropped_camera(camera, place.window), falling, times)))
    # Rain that is in most frames can't be told from what is behind it: the real frames have it already.
    shares -= cv2.blur(np.median(shares, axis=0), (_VEIL_PX,) * 2)
    for background, share in zip(backgrounds, shares, strict=True):
        levels = background.astype(np.float32)
        rise = rain_over(levels, share, drop, falling.rain, sensor)
        made.append(photographed(np.where(levels <= 0, below, levels), rise, noise, sensor).color)
    return made


def _stored(picture: UInt8[np.ndarray, "h w 3"], place: RainyPlace) -> UInt8[np.ndarray, "h w 3"]:
    """Compress a real frame once more, as ours is."""
    nothing, silent = np.zeros(picture.shape, np.float32), np.zeros(picture.shape[:2], np.float32)
    sensor = None if place.rain.sensor is None else load_sensor(place.rain.sensor)
    return photographed(picture.astype(np.float32), nothing, silent, sensor).color


def _dripping(found: MedianResiduals) -> Bool[np.ndarray, "h w"]:
    """Mark upright columns of still pixels that get bright, and not dark as by leaves, more than other dark pixels."""
    still = found.still.astype(np.float32)
    weights = np.maximum(_along_columns(still), np.float32(1e-6))
    brighter, darker = (
        _along_columns(still * np.mean(np.maximum(sign * found.values, 0) ** 3, axis=0)) / weights for sign in (1, -1)
    )
    dark = found.still & (found.median < _DARK_LEVELS)
    if not dark.any():
        return dark
    often = brighter - darker > _DRIP_FACTOR * np.median((brighter - darker)[dark])
    return dark & often & (darker < _DRIP_DARKER * brighter)


def _along_columns(values: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return cv2.GaussianBlur(values, (0, 0), sigmaX=_DRIP_PX[0], sigmaY=_DRIP_PX[1])


def _dark_corner(
    found: MedianResiduals,
    dripping: Bool[np.ndarray, "h w"],
    former: Sequence[tuple[int, int]],
    random: np.random.Generator,
) -> tuple[int, int]:
    """Upper left corner of a crop with many dark, enough still, no dripping pixels, the farthest from former ones."""
    height, width = found.still.shape
    dark = np.where(found.median < _DARK_LEVELS, np.float32(1), np.float32(0))
    sums = [cv2.integral(each) for each in (found.still.astype(np.float32), dark, dripping.astype(np.float32))]
    w, h = min(PAIR_CROP[0], width), min(PAIR_CROP[1], height)
    tries: list[tuple[bool, float, int, int]] = []
    for _ in range(_TRIES):
        x, y = int(random.integers(width - w + 1)), int(random.integers(height - h + 1))
        still, darkness, drips = (float(s[y + h, x + w] - s[y, x + w] - s[y + h, x] + s[y, x]) / (w * h) for s in sums)
        fits = still >= _MIN_STILL and darkness >= _MIN_DARK and drips <= _MAX_DRIPS
        apart = min((float(np.hypot(x - a, y - b)) for a, b in former), default=0.0)
        tries.append((fits, apart if fits else still + darkness - drips / _MAX_DRIPS, x, y))
    return max(tries)[2:]

"""Camera rain gauge: the rain rate in frames of a static camera, from streaks, focal length and shutter time.

Each streak gives three equations for a drop's diameter D, fall speed V and depth z, as in Allamano, Croci and Laio 2015
("Toward the camera rain gauge", Water Resources Research 51): its width w = f D / z, its length L = f V T / z, and the
law V(D) of falling drops. Streaks wider than a cutoff w_0 are those in the volume up to z = f D / w_0, so that their
number per image area is n = f E[N D^3] / (3 w_0^3): the water in the air, whatever the drop sizes. With the speed of
these drops it is the rain rate. The gauge knows nothing of the scene, the drop sizes or the lens: widths come from the
light of a streak, which blur preserves, and a drop's own light from backgrounds of different brightness. Streaks that
hide each other are corrected for by artificial ones. Only what is above the horizon is measured: below it, drops that
splash on the ground would count as streaks.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from scipy.optimize import least_squares
from scipy.special import ndtr

from gsrain_engine.scene.geometry import LUMINANCE, srgb_to_linear

from .streaks import LINE_PX, MAD_TO_SIGMA, box_with_moments, line_kernels

FallSpeed = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, " n"]]  # m/s of drops with diameters in mm

MIN_FRAMES = 5
_OCTAVES = 4  # each finds streaks of twice the width
_DETECTION_Z = 6.0
"""Threshold on the line response in standard deviations of its noise."""

_CORE_SHARE = 0.4  # of a response's peak, within which a streak's moments are taken
_RESTLESS_LEVELS = 12.0  # larger typical deviations are motion: even the densest rain has less
_SHARE_STEPS = 400.0  # of bytes from which medians are taken
_MIN_WIDTH_PX, _CUTOFFS, _MIN_STREAKS = 1.0, 40, 20
_MAX_BACKGROUND, _OPEN_SHARE = 0.6, 0.95
"""Largest background, as a share of a drop's light, before which streaks are measured, and least share of
such backgrounds around a streak."""

_DARKER_LEVELS = 8.0
"""Pixels that are ever so much darker than their median have moving things: rain in front of what is dark brightens."""

_BLOCK_PX, _BLOCKS, _MOVING_SHARE, _LEAST_CONTRAST = 8, 5, 0.06, 0.15
"""Moving things change the median of 5 x 5 blocks of 8 px by more than this share of the difference between the
brightest light and theirs (0.15 at least); streaks are too narrow."""

_DIAMETERS_MM = np.geomspace(0.3, 8.0, 400)
_TYPICAL_MM, _TYPICAL_SPREAD = 1.3, 0.25
"""Volume-weighted mean diameter E[D^4] / E[D^3] of rain and its relative spread: 1.05 mm at 1.2 mm/h to 1.6 mm at 12
mm/h in the gamma laws fitted to Locarno's Parsivel minutes of 2018 (docs/physics/drops.md)."""

_LIGHT_BLOCK_PX, _BANDS, _MIN_BANDS, _MIN_BLOCKS = 4, 32, 3, 100
"""Blocks over which changes are averaged for the light of drops; bands of 8 gray levels, at least 3 of which have so
many blocks. Rain changes medians: in narrower bands of one wall, brighter blocks would be those with more rain."""

_LIGHTS, _MOMENT_ERROR, _MAX_LIGHT_ERROR, _DRAWS = (0.3, 0.6, 0.9), 0.02, 0.1, 50
"""Starts of its fit, least relative error of a moment, largest one of the light, and draws that give it."""

_MIN_SHARP = 0.5
"""Share of a streak's length that is not blur, at least."""

_SLOWNESS_ERROR = 0.06
"""Relative error of V / D from streaks: V / D hardly depends on D, so that the diameter follows from it to 25 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GaugeReading:
    """Reading of the gauge with the counting error of its streaks."""

    intensity_mm_h: float
    error_mm_h: float
    """Standard error by counting, of real and artificial streaks; those of light and fall speed are not in it."""
    water_g_m3: float
    """Liquid water in the air."""
    diameter_mm: float
    """Of the median streak above the cutoff: weighted by volume, since larger drops are counted farther away."""
    speed_m_s: float
    """Fall speed of such a drop."""
    streaks: int
    """Above the cutoff."""
    cutoff_px: float
    recovered_share: float
    """Of artificial streaks above the cutoff that are found: others hide the rest."""
    drop_light: float
    """Linear luminance of a drop, by the changes in front of dark and bright backgrounds."""
    drop_light_error: float
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class LightResiduals:
    """Linear luminance (1 is white) of a static camera's frames."""

    background: Float32[np.ndarray, "h w"]
    """Temporal median."""
    values: Float32[np.ndarray, "t h w"]
    """Frame minus median."""
    sigma: Float32[np.ndarray, "h w"]
    """Noise: 1.4826 times the median of |value| around a pixel, half a gray level at least."""
    still: Bool[np.ndarray, "h w"]
    """Pixels where only noise and rain change."""


def measure_rain_rate(
    frames: UInt8[np.ndarray, "t h w *c"],
    focal_px: float,
    exposure_s: float,
    fall_speed: FallSpeed,
    horizon_px: int | None = None,
) -> GaugeReading:
    """Read the rain rate from frames of a static, level camera; gray, or RGB in the last axis.

    `focal_px` is the focal length, `exposure_s` the shutter time, `horizon_px` the row of the horizon: that in the
    middle by default. Frames must be far enough apart for other drops to be near: 0.1 s. Raises ValueError for fewer
    than 5 frames, for backgrounds of about one brightness, and for fewer than 20 streaks.
    """
    found = light_residuals(frames[:, : frames.shape[1] // 2 if horizon_px is None else horizon_px])
    in_frames = [GaugedStreaks.of(values, found) for values in found.values]
    if (number := sum(map(len, in_frames))) < _MIN_STREAKS:
        raise ValueError(f"{number} streaks: too few for a rain rate; take more frames or a longer exposure")
    light = drop_light_of(found)
    areas = _OpenAreas(found.still & (found.background < _MAX_BACKGROUND * light.value))
    streaks = GaugedStreaks.joined(in_frames)
    streaks = streaks[areas.are_open(streaks.center_px, streaks.half_box_px)]
    width_px = streaks.width_px(light.value)
    cutoff = _cutoff_px(width_px)
    counted = streaks[width_px > cutoff]
    while (recovery := _recovery(found, in_frames, counted, areas, cutoff, light.value)).share < _MIN_RECOVERED:
        cutoff *= _WIDER
        counted = streaks[width_px > cutoff]
        if len(counted) < _MIN_STREAKS:
            raise ValueError(
                f"only {recovery.share:.0%} of artificial streaks are found in these frames: "
                "streaks are too faint or too dense"
            )
    area = np.array([areas.area_px2(*box) for box in counted.half_box_px.tolist()])
    per_px2 = float(np.mean(1 / area)) * len(counted) / len(frames) / recovery.share
    water = np.pi / 6 * 3 * cutoff**3 / focal_px * per_px2
    slowness = float(np.median(counted.slowness(light.value))) / recovery.slowness / exposure_s
    diameter_mm = _diameter_mm(slowness, fall_speed)
    speed = float(fall_speed(np.array([diameter_mm]))[0])
    rate = 3.6e6 * water * speed
    return GaugeReading(
        intensity_mm_h=rate, error_mm_h=rate * float(np.hypot(1 / np.sqrt(len(counted)), recovery.share_error)),
        water_g_m3=1e6 * water, diameter_mm=diameter_mm, speed_m_s=speed, streaks=len(counted), cutoff_px=cutoff,
        recovered_share=recovery.share, drop_light=light.value, drop_light_error=light.error, frames=len(frames),
    )  # fmt: skip


def light_residuals(frames: UInt8[np.ndarray, "t h w *c"]) -> LightResiduals:
    """Subtract the temporal median in linear light. Raises ValueError for fewer than 5 frames."""
    if len(frames) < MIN_FRAMES:
        raise ValueError(f"{len(frames)} frames: a temporal median free of rain takes at least {MIN_FRAMES}")
    linear = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    values = np.stack([_luminance(linear[frame]) for frame in frames])
    background = np.median(values, axis=0)
    values -= background
    level = _level_of(background)
    spread = MAD_TO_SIGMA * np.median(np.abs(values), axis=0)
    sigma = np.maximum(cv2.blur(spread, (7, 7)), 0.5 * level)
    restless = cv2.blur(spread / level, (7, 7)) > _RESTLESS_LEVELS
    restless |= values.min(axis=0) < -_DARKER_LEVELS * level
    still = cv2.dilate(restless.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    for frame in values:
        still &= ~_moving(frame, background)
    return LightResiduals(background, values, sigma, still)


def _level_of(light: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Difference of linear light between two gray levels."""
    linear = srgb_to_linear(np.arange(256) / 255)
    return np.interp(light, linear, np.gradient(linear)).astype(np.float32)


def _moving(values: Float32[np.ndarray, "h w"], background: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Mask of a frame's blocks that something wider than a streak has changed."""
    height, width = values.shape
    contrast = np.maximum(np.abs(np.quantile(background, 0.99) - background), _LEAST_CONTRAST)
    small = max(width // _BLOCK_PX, 1), max(height // _BLOCK_PX, 1)
    share = cv2.resize((values / contrast).astype(np.float32), small, interpolation=cv2.INTER_AREA)
    bytes_ = np.clip(np.rint(_SHARE_STEPS * share + 128), 0, 255).astype(np.uint8)  # what cv2's median of 5 x 5 takes
    median = (cv2.medianBlur(bytes_, _BLOCKS).astype(np.float32) - 128) / _SHARE_STEPS
    moving = cv2.dilate((np.abs(median) > _MOVING_SHARE).astype(np.uint8), np.ones((_BLOCKS, _BLOCKS), np.uint8))
    return cv2.resize(moving, (width, height), interpolation=cv2.INTER_NEAREST) > 0


def _luminance(linear: Float32[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "h w"]:
    return linear @ LUMINANCE.astype(np.float32) if linear.ndim == 3 else linear


class DropLight(NamedTuple):
    """Linear luminance of a drop, and its standard error."""

    value: float
    error: float


def drop_light_of(found: LightResiduals) -> DropLight:
    """Linear luminance of a drop: that of the background before which rain would be invisible.

    A drop changes a background B by alpha (S - B), S its own light (the photometric constraint of Garg and Nayar 2007).
    Rain has the same alphas before all backgrounds, so that the third central moment of the changes goes with
    (S - B)^3; symmetric noise and constant offsets have none and add nothing to it. S and the factor are fitted to the
    moments of bands of about equal brightness, of means over blocks. Raises `ValueError` if backgrounds are too alike.
    """
    still = _block_means(found.still.astype(np.float32)) > 0.999
    background = _block_means(found.background)[still]
    changes = np.stack([_block_means(values)[still] for values in found.values])
    brightness: list[float] = []
    moments: list[Float64[np.ndarray, " t"]] = []
    for low, high in pairwise(srgb_to_linear(np.linspace(0, 1, _BANDS + 1))):
        band = (background >= low) & (background < high)
        if band.sum() >= _MIN_BLOCKS:
            own = changes[:, band].astype(np.float64)
            brightness.append(float(background[band].mean()))
            moments.append(((own - own.mean()) ** 3).mean(axis=1))
    if len(brightness) >= _MIN_BANDS:
        light = _fitted_light(np.array(brightness), np.array(moments))
        if light.value > 0 and light.error < _MAX_LIGHT_ERROR * light.value:
            return light
    raise ValueError(
        "the light of drops can't be told from these backgrounds: frames need dark and bright ones, as trees and sky"
    )


def _block_means(values: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "rows columns"]:
    height, width = (each // _LIGHT_BLOCK_PX for each in values.shape)
    whole = np.ascontiguousarray(values[: height * _LIGHT_BLOCK_PX, : width * _LIGHT_BLOCK_PX])
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def _fitted_light(background: Float64[np.ndarray, " bands"], moments: Float64[np.ndarray, "bands t"]) -> DropLight:
    """Fit third moments by k (S - B)^3; the error is that of draws of as many frames with replacement."""
    frames = moments.shape[1]
    mean = moments.mean(axis=1)
    scale = max(float(np.abs(mean).max()), 1e-30)
    error = np.hypot(moments.std(axis=1) / np.sqrt(frames), _MOMENT_ERROR * np.abs(mean) + 1e-6 * scale)

    def fit(moment: Float64[np.ndarray, " bands"], start: float) -> tuple[float, float]:
        def misfits(values: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, " bands"]:
            return (values[0] * scale * (values[1] - background) ** 3 - moment) / error

        found = least_squares(misfits, [2.0, start])
        return float(found.cost), float(found.x[1])

    light = min(fit(mean, start) for start in _LIGHTS)[1]
    random = np.random.default_rng(0)
    draws = [moments[:, random.integers(frames, size=frames)].mean(axis=1) for _ in range(_DRAWS)]
    return DropLight(light, float(np.std([fit(moment, light)[1] for moment in draws])))


def _diameter_mm(slowness_per_s: float, fall_speed: FallSpeed) -> float:
    """Diameter of drops that fall so many of their own diameters a second (V / D), given the diameters of rain."""
    per_s = 1e3 * fall_speed(_DIAMETERS_MM) / _DIAMETERS_MM
    logs = np.log(_DIAMETERS_MM)
    misfit = (np.log(per_s / slowness_per_s) / _SLOWNESS_ERROR) ** 2
    misfit += (np.log(_DIAMETERS_MM / _TYPICAL_MM) / _TYPICAL_SPREAD) ** 2
    weights = np.exp(-0.5 * (misfit - misfit.min()))
    return float(np.exp(weights @ logs / weights.sum()))


def _cutoff_px(width_px: Float64[np.ndarray, " n"]) -> float:
    """Width above which all streaks are found: there they follow N(> w) ~ w^-3, the law of a uniform volume.

    The cutoff with the smallest distance (Kolmogorov-Smirnov) between the law and the streaks, as in Clauset, Shalizi
    and Newman 2009 for power laws. Raises ValueError for fewer than 20 streaks.
    """
    rising = np.sort(width_px[width_px > _MIN_WIDTH_PX])
    if len(rising) < _MIN_STREAKS:
        raise ValueError(f"{len(rising)} streaks: too few for a rain rate; take more frames or a longer exposure")
    candidates = rising[np.unique(np.linspace(0, len(rising) - _MIN_STREAKS, _CUTOFFS).astype(int))]
    return float(min(candidates, key=lambda cutoff: _distance_from_law(rising[rising > cutoff] / cutoff)))


def _distance_from_law(ratios: Float64[np.ndarray, " n"]) -> float:
    """Kolmogorov-Smirnov distance of rising ratios above 1 from 1 - ratio^-3."""
    law, n = 1 - ratios**-3.0, len(ratios)
    ranks = np.arange(n)
    return float(np.maximum(np.abs(law - ranks / n), np.abs(law - (ranks + 1) / n)).max())


# Streaks
# Found by line filters at several scales, then measured by aperture photometry as in astronomy: the light within a box
# around the streak, less that of its surroundings.


@dataclass(frozen=True, slots=True)
class _Candidate:
    x: float
    y: float
    angle: float
    """From the vertical, in radians; positive if the lower end is farther right."""
    length: float
    width: float
    response: float


@dataclass(frozen=True, slots=True, eq=False)
class GaugedStreaks:
    """Streaks in px and linear luminance."""

    center_px: Float64[np.ndarray, "n 2"]
    half_box_px: Float64[np.ndarray, "n 2"]
    """Half the width and height of the upright box in which the streak is measured."""
    light_px2: Float64[np.ndarray, " n"]
    """Integral of the luminance that it adds."""
    fall_px: Float64[np.ndarray, " n"]
    """Vertical length: the light over that of a row in the middle, times the cosine of the angle."""
    across_px: Float64[np.ndarray, " n"]
    """Width: the light over that of a column in the middle. Blur adds its square to that, and to the squared length."""
    background: Float64[np.ndarray, " n"]
    """Luminance behind it."""
    angle: Float64[np.ndarray, " n"]
    """From the vertical, in radians."""

    @classmethod
    def of(cls, values: Float32[np.ndarray, "h w"], found: LightResiduals) -> "GaugedStreaks":
        """Find and measure the streaks of one frame, given as its difference to the background."""
        table = np.array(list(_measured(values, found)), np.float64).reshape(-1, 9)
        return cls(table[:, :2], table[:, 2:4], *(np.ascontiguousarray(table[:, k]) for k in range(4, 9)))

    @classmethod
    def joined(cls, parts: Sequence["GaugedStreaks"]) -> "GaugedStreaks":
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    def __len__(self) -> int:
        return len(self.light_px2)

    def width_px(self, drop_light: float) -> Float64[np.ndarray, " n"]:
        """Widths without blur: the light is that of a disk of this diameter."""
        return np.sqrt(4 / np.pi * self.light_px2 / np.maximum(drop_light - self.background, _LEAST_CONTRAST))

    def sharp_fall_px(self, drop_light: float) -> Float64[np.ndarray, " n"]:
        """Vertical lengths without blur."""
        return np.sqrt(np.maximum(self.fall_px**2 - self.blur_px2(drop_light), (_MIN_SHARP * self.fall_px) ** 2))

    def blur_px2(self, drop_light: float) -> Float64[np.ndarray, " n"]:
        """Squared widths of the blur."""
        return np.maximum(self.across_px**2 - self.width_px(drop_light) ** 2, 0)

    def slowness(self, drop_light: float) -> Float64[np.ndarray, " n"]:
        """Lengths over widths: numbers of its own diameters that each drop falls during the exposure."""
        return self.sharp_fall_px(drop_light) / self.width_px(drop_light)

    def __getitem__(self, chosen: Bool[np.ndarray, " n"]) -> "GaugedStreaks":
        return GaugedStreaks(*(getattr(self, each.name)[chosen] for each in fields(self)))


class _OpenAreas:
    """Areas of the positions at which boxes of a size lie within a mask."""

    def __init__(self, usable: Bool[np.ndarray, "h w"]) -> None:
        self._shape = usable.shape
        self._sums = cv2.integral(usable.astype(np.uint8)).astype(np.int64)
        self._areas: dict[tuple[int, int], float] = {}
        self.size_px = np.array(usable.shape[::-1])

    def are_open(
        self, centers: Float64[np.ndarray, "n 2"], half_sizes: Float64[np.ndarray, "n 2"]
    ) -> Bool[np.ndarray, " n"]:
        """Mask of the boxes that lie within the image, and nearly all of each within the mask."""
        low, high = np.rint(centers - half_sizes).astype(int), np.rint(centers + half_sizes).astype(int) + 1
        fits = np.flatnonzero((low >= 0).all(axis=1) & (high <= self._shape[::-1]).all(axis=1))
        (left, top), (right, bottom), s = low[fits].T, high[fits].T, self._sums
        covered = s[bottom, right] - s[top, right] - s[bottom, left] + s[top, left]
        is_open = np.zeros(len(centers), np.bool_)
        is_open[fits] = covered >= _OPEN_SHARE * (right - left) * (bottom - top)
        return is_open

    def area_px2(self, half_width: float, half_height: float) -> float:
        """Number of positions at which `are_open` holds for boxes of about that size (steps of a tenth)."""
        key = round(10 * np.log(max(half_width, 1))), round(10 * np.log(max(half_height, 1)))
        if key not in self._areas:
            w, h = (max(2 * round(np.exp(each / 10)) + 1, 1) for each in key)
            s = self._sums
            if h >= s.shape[0] or w >= s.shape[1]:
                self._areas[key] = 0.0
            else:
                inside = s[h:, w:] - s[:-h, w:] - s[h:, :-w] + s[:-h, :-w]
                self._areas[key] = float((inside >= _OPEN_SHARE * w * h).sum())
        return self._areas[key]


def _measured(values: Float32[np.ndarray, "h w"], found: LightResiduals) -> Iterator[tuple[float, ...]]:
    """Rows of `GaugedStreaks` of one frame."""
    accepted = _without_overlaps(_candidates(np.where(found.still, values / found.sigma, 0)))
    for each in accepted:
        margin = 3 + 1.5 * each.width
        half_length, half_width = each.length / 2 + margin, each.width / 2 + margin
        sine, cosine = np.sin(each.angle), np.cos(each.angle)
        box = half_width * cosine + half_length * abs(sine), half_length * cosine + half_width * abs(sine)
        light, length, across, background = _photometry(values, found.background, each, half_length, half_width)
        if light > 0:
            yield each.x, each.y, *box, light, length * cosine, across, background, each.angle


def _candidates(z: Float32[np.ndarray, "h w"]) -> Iterator[_Candidate]:
    """Streaks in residuals relative to their noise, by line filters; a wide one may come from several octaves."""
    for octave in range(_OCTAVES):
        size = 2**octave
        height, width = z.shape[0] // size, z.shape[1] // size
        if min(height, width) < 2 * LINE_PX:
            return
        means = cv2.resize(z[: height * size, : width * size], (width, height), interpolation=cv2.INTER_AREA)
        response = np.max([cv2.filter2D(means, -1, kernel) for kernel in line_kernels()], axis=0)
        response -= np.median(response)
        response /= max(MAD_TO_SIGMA * float(np.median(np.abs(response))), 1e-6)
        found = (response > _DETECTION_Z).astype(np.uint8)
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(found, connectivity=8)
        for label in range(1, count):
            left, top, w, h = (int(v) for v in boxes[label, :4])
            rows, columns = slice(max(top - 1, 0), top + h + 1), slice(max(left - 1, 0), left + w + 1)
            own = np.where(labels[rows, columns] == label, response[rows, columns], np.float32(0))
            each = _by_moments(own, means[rows, columns], size)
            if each is not None and abs(each.angle) <= np.pi / 4:
                offset = size * np.array([columns.start, rows.start])
                yield replace(each, x=each.x + float(offset[0]), y=each.y + float(offset[1]))


def _by_moments(
    response: Float32[np.ndarray, "h w"], values: Float32[np.ndarray, "h w"], size: int
) -> _Candidate | None:
    """Box with the moments of the values around the peak of a response, in px `size` times as small; None for noise."""
    _, pieces = cv2.connectedComponents((response > _CORE_SHARE * response.max()).astype(np.uint8), connectivity=8)
    peak = (pieces == pieces.flat[int(response.argmax())]).astype(np.uint8)
    core = cv2.dilate(peak, np.ones((3, 3), np.uint8)) > 0
    if (box := box_with_moments(np.maximum(values, 0), core)) is None:
        return None
    x, y, angle_deg, length, width, _ = box
    return _Candidate(
        x=size * (x + 0.5) - 0.5, y=size * (y + 0.5) - 0.5, angle=float(np.radians(angle_deg)),
        length=size * length, width=size * max(width, 1.0), response=float(response.max()),
    )  # fmt: skip


def _without_overlaps(found: Iterable[_Candidate]) -> list[_Candidate]:
    """Candidates, strongest first, but for those that overlap a stronger one: a center of one in the other's box."""
    ranked = sorted(found, key=lambda each: -each.response)
    values = [(each.x, each.y, each.angle, each.length, each.width) for each in ranked]
    x, y, angle, length, width = np.array(values, np.float64).reshape(-1, 5).T
    sine, cosine = np.sin(angle), np.cos(angle)
    reach_along, reach_across = 0.6 * length + 2, 0.5 * width + 1
    accepted = np.zeros(len(ranked), np.bool_)
    for k in range(len(ranked)):
        others = np.flatnonzero(accepted[:k])
        dx, dy = x[others] - x[k], y[others] - y[k]
        overlaps = False
        for box in (k, others):
            along, across = dx * sine[box] + dy * cosine[box], dx * cosine[box] - dy * sine[box]
            is_inside = (np.abs(along) < reach_along[box]) & (np.abs(across) < reach_across[box])
            overlaps |= bool(is_inside.any())
        accepted[k] = not overlaps
    return [each for each, is_apart in zip(ranked, accepted, strict=True) if is_apart]


def _photometry(
    values: Float32[np.ndarray, "h w"], background: Float32[np.ndarray, "h w"], streak: _Candidate,
    half_length: float, half_width: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Light of a streak (px2) less its surroundings at both sides, its length and width (px), and its background."""
    along, across = int(np.ceil(half_length)), int(np.ceil(2 * half_width + 4))
    sine, cosine = np.sin(streak.angle), np.cos(streak.angle)
    axes = np.array([[cosine, sine], [-sine, cosine]])
    corner = np.array([streak.x, streak.y]) - axes @ [across, along]
    matrix, size = np.column_stack([axes, corner]), (2 * across + 1, 2 * along + 1)
    turned = cv2.warpAffine(values, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    inside = np.abs(np.arange(-across, across + 1)) <= half_width
    net = turned[:, inside] - turned[:, ~inside].mean()
    profile = net.sum(axis=1)
    smooth = np.convolve(profile, np.ones(3) / 3, "same")
    third = max(round(streak.length / 6), 1)
    height = float(smooth[max(along - third, 0) : along + third + 1].mean())
    if height <= 0 or (light := float(profile.sum())) <= 0:
        return 0.0, 0.0, 0.0, 0.0
    core = np.abs(np.arange(-across, across + 1)) <= max(streak.width / 2, 1)
    behind = cv2.warpAffine(background, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    middle = slice(max(along - round(streak.length / 2), 0), along + round(streak.length / 2) + 1)
    columns = net[middle].sum(axis=0)
    peak = float(columns[len(columns) // 2 - 1 : len(columns) // 2 + 2].mean())
    across_px = float(columns.sum()) / peak if peak > 0 else 0.0
    return light, light / height, across_px, float(behind[middle][:, core].mean())


# Artificial streaks
# In dense rain streaks hide each other and add to each other's light, as stars in a cluster do. As in the photometry of
# crowded fields (Stetson 1987), artificial ones are added to the frames and measured again: the share that is found is
# known, and so is the change of what is measured.

_PER_FRAME, _SMALLEST, _LARGEST = 200, 0.5, 4.0
"""Artificial streaks tried in a frame, and their range of widths in cutoffs: smaller ones may measure larger."""

_STEEPNESS = 1.5  # artificial streaks above a width are its power of -1.5, and weighted by another to the law's -3

_MIN_RECOVERED, _WIDER = 0.5, 1.15
"""Least share of artificial streaks that is found above a cutoff, and factor by which it is raised until they are."""

_SAME_PLACE = 0.5  # of half a box: centers nearer than that are those of one streak


class _Recovery(NamedTuple):
    """Share of artificial streaks that is counted, its standard error, and measured over true slowness."""

    share: float
    share_error: float
    slowness: float


def _recovery(
    found: LightResiduals, in_frames: Sequence[GaugedStreaks], shapes: GaugedStreaks, areas: _OpenAreas, cutoff: float,
    drop_light: float,
) -> _Recovery:  # fmt: skip
    """Add artificial streaks to each frame and count those that are found above the cutoff.

    Their shapes are those of measured streaks, larger or smaller: an image of a drop at half the distance is twice as
    wide, long and blurred. Their widths follow the law of a uniform volume.
    """
    random = np.random.default_rng(len(shapes))
    weights: list[float] = []
    larger: list[bool] = []
    counted: list[bool] = []
    slowness: list[float] = []
    for values, before in zip(found.values, in_frames, strict=True):
        added = _artificial(random, shapes, areas, cutoff, drop_light)
        changed = values.copy()
        for each in added:
            each.draw(changed, found.background, drop_light)
        after = GaugedStreaks.of(changed, found)
        is_open, width_px = areas.are_open(after.center_px, after.half_box_px), after.width_px(drop_light)
        ratio = after.slowness(drop_light)
        for each in added:
            weights.append((each.width_px / cutoff) ** (_STEEPNESS - 3))
            larger.append(each.width_px > cutoff)
            at = each.found_in(after, before)
            counted.append(at is not None and bool(is_open[at]) and bool(width_px[at] > cutoff))
            if at is not None and counted[-1]:
                slowness.append(float(ratio[at]) / each.slowness)
    weight, is_larger, is_counted = np.array(weights), np.array(larger), np.array(counted)
    expected, counts = weight * is_larger, weight * is_counted
    share = float(counts.sum() / max(expected.sum(), 1e-9))
    spread = counts - share * expected
    share_error = float(np.sqrt((spread**2).sum()) / max(counts.sum(), 1e-9))
    return _Recovery(share, share_error, float(np.median(slowness)) if slowness else 1.0)


@dataclass(frozen=True, slots=True)
class _ArtificialStreak:
    """Uniform streak of a drop during the exposure, blurred by a Gaussian."""

    x: float
    y: float
    width_px: float
    fall_px: float
    """Vertical length, without blur."""
    blur_px: float
    """Width of the blur: its light over that of a line in its middle."""
    angle: float
    box_px: tuple[float, float]
    """Half the width and height of the box in which it would be measured."""

    @property
    def slowness(self) -> float:
        return self.fall_px / self.width_px

    @property
    def light_px2(self) -> float:
        """Integral of alpha."""
        return np.pi / 4 * self.width_px**2

    def draw(
        self, values: Float32[np.ndarray, "h w"], background: Float32[np.ndarray, "h w"], drop_light: float
    ) -> None:
        """Add its light to a frame's difference to the background."""
        half_width, half_height = (int(np.ceil(each)) + 1 for each in self.box_px)
        left, top = max(round(self.x) - half_width, 0), max(round(self.y) - half_height, 0)
        part = slice(top, round(self.y) + half_height + 1), slice(left, round(self.x) + half_width + 1)
        height, width = values[part].shape
        y, x = np.mgrid[:height, :width].astype(np.float64)
        dx, dy = x + left - self.x, y + top - self.y
        sine, cosine = np.sin(self.angle), np.cos(self.angle)
        across, along = dx * cosine - dy * sine, dx * sine + dy * cosine
        half = self.fall_px / cosine / 2
        blur = max(self.blur_px, 1.0) / np.sqrt(2 * np.pi)
        sigma = np.sqrt(self.width_px**2 / (2 * np.pi) + blur**2)
        profile = np.exp(-0.5 * (across / sigma) ** 2) * (ndtr((along + half) / blur) - ndtr((along - half) / blur))
        alpha = np.minimum(self.light_px2 / profile.sum() * profile, 1.0)
        values[part] += (alpha * (drop_light - background[part] - values[part])).astype(np.float32)

    def found_in(self, after: GaugedStreaks, before: GaugedStreaks) -> int | None:
        """Index of the streak that is found in its place; None if there is none, or a brighter one was there before."""
        if (at := _index_at(np.array([self.x, self.y]), self.box_px, after)) is None:
            return None
        other = _index_at(after.center_px[at], self.box_px, before)
        own = after.light_px2[at] / 2  # the brighter half is counted
        return None if other is not None and before.light_px2[other] >= own else at


def _index_at(center_px: Float64[np.ndarray, "2"], box_px: tuple[float, float], streaks: GaugedStreaks) -> int | None:
    """Index of the streak with the nearest center, in units of half a box; None if it is not the same place."""
    if not len(streaks):
        return None
    distance = np.abs((streaks.center_px - center_px) / box_px).max(axis=1)
    nearest = int(distance.argmin())
    return nearest if distance[nearest] < _SAME_PLACE else None


def _artificial(
    random: np.random.Generator, shapes: GaugedStreaks, areas: _OpenAreas, cutoff: float, drop_light: float
) -> list[_ArtificialStreak]:
    """Draw streaks that lie in the open and apart from each other."""
    width_px, fall_px = shapes.width_px(drop_light), shapes.sharp_fall_px(drop_light)
    blur_px = np.sqrt(shapes.blur_px2(drop_light))
    added: list[_ArtificialStreak] = []
    for _ in range(_PER_FRAME):
        shape = int(random.integers(len(shapes)))
        low, high = _SMALLEST**-_STEEPNESS, _LARGEST**-_STEEPNESS
        own = cutoff * (low + (high - low) * float(random.random())) ** (-1 / _STEEPNESS)
        scale = own / float(width_px[shape])
        box = scale * shapes.half_box_px[shape]
        place = random.random(2) * areas.size_px
        if not areas.are_open(place[None], box[None])[0]:
            continue
        if any(np.all(np.abs(place - (each.x, each.y)) < box + each.box_px) for each in added):
            continue
        added.append(_ArtificialStreak(
            x=float(place[0]), y=float(place[1]), width_px=own, fall_px=scale * float(fall_px[shape]),
            blur_px=scale * float(blur_px[shape]), angle=float(shapes.angle[shape]),
            box_px=(float(box[0]), float(box[1])),
        ))  # fmt: skip
    return added

"""Camera rain gauge: the rain rate in frames of a static camera, from streaks, focal length and shutter time.

Each streak gives three equations for a drop's diameter D, fall speed V and depth z, as in Allamano, Croci and Laio 2015
("Toward the camera rain gauge", Water Resources Research 51): its width w = f D / z, its length L = f V T / z, and the
law V(D) of falling drops. Streaks wider than a cutoff w_0 are those in the volume up to z = f D / w_0, so that their
number per image area is n = f E[N D^3] / (3 w_0^3): the water in the air, whatever the drop sizes. With the speed of
these drops it is the rain rate. The gauge knows nothing of the scene, the drop sizes or the lens: widths come from the
light of a streak, which blur preserves, and a drop's own light from the sky in the frames.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from ..scene.geometry import LUMINANCE, srgb_to_linear
from .streaks import LINE_PX, MAD_TO_SIGMA, box_with_moments, line_kernels

FallSpeed = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, " n"]]  # m/s of drops with diameters in mm

MIN_FRAMES = 5
_OCTAVES = 4  # each finds streaks of twice the width
_DETECTION_Z = 6.0
"""Threshold on the line response in standard deviations of its noise."""

_CORE_SHARE = 0.4  # of a response's peak, within which a streak's moments are taken
_RESTLESS_LEVELS = 12.0  # larger typical deviations are motion: even the densest rain has less
_MIN_WIDTH_PX, _CUTOFFS, _MIN_STREAKS = 1.0, 40, 20
_MAX_BACKGROUND, _OPEN_SHARE = 0.6, 0.95
"""Largest background, as a share of a drop's light, before which streaks are measured, and least share of
such backgrounds around a streak."""

_MIN_SKY_SHARE, _DARKEST_SKY = 0.01, 0.15  # of all pixels; linear luminance, gray 108 of 255
_SKY_SHARE = 0.9  # of the brightest light, above which a pixel is of an overcast sky: light walls are darker

_DIAMETERS_MM = np.geomspace(0.3, 8.0, 400)
_TYPICAL_MM, _TYPICAL_SPREAD = 1.3, 0.25
"""Volume-weighted mean diameter E[D^4] / E[D^3] of rain and its relative spread: 1.05 mm at 1.2 mm/h to 1.6 mm at 12
mm/h in the gamma laws fitted to Locarno's Parsivel minutes of 2018 (docs/physics.md)."""

_MIN_SHARP = 0.5
"""Share of a streak's length that is not blur, at least."""

_SLOWNESS_ERROR = 0.06
"""Relative error of V / D from streaks: V / D hardly depends on D, so that the diameter follows from it to 25 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GaugeReading:
    """Reading of the gauge with the counting error of its streaks."""

    intensity_mm_h: float
    error_mm_h: float
    """Standard error by counting; the fall speed's is not in it."""
    water_g_m3: float
    """Liquid water in the air."""
    diameter_mm: float
    """Of the median streak above the cutoff: weighted by volume, since larger drops are counted farther away."""
    speed_m_s: float
    """Fall speed of such a drop."""
    streaks: int
    """Above the cutoff."""
    cutoff_px: float
    drop_light: float
    """Linear luminance of a drop, by the visible sky."""
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
    frames: UInt8[np.ndarray, "t h w *c"], focal_px: float, exposure_s: float, fall_speed: FallSpeed
) -> GaugeReading:
    """Read the rain rate from frames of a static, level camera; gray, or RGB in the last axis.

    `focal_px` is the focal length, `exposure_s` the shutter time. Frames must be far enough apart for other drops to be
    near: 0.1 s. Raises ValueError for fewer than 5 frames, without sky at their top, and for fewer than 20 streaks.
    """
    found = light_residuals(frames)
    drop_light = drop_light_of(found, focal_px)
    streaks = _Streaks.of(found)
    areas = _OpenAreas(found.still & (found.background < _MAX_BACKGROUND * drop_light))
    streaks = streaks[areas.are_open(streaks.center_px, streaks.half_box_px)]
    width_px = np.sqrt(4 / np.pi * streaks.light_px2 / (drop_light - streaks.background))
    cutoff = _cutoff_px(width_px)
    counted = width_px > cutoff
    area = np.array([areas.area_px2(*box) for box in streaks.half_box_px[counted].tolist()])
    water = np.pi / 6 * 3 * cutoff**3 / focal_px * float(np.mean(1 / area)) * len(area) / len(frames)
    blur_px2 = np.maximum(streaks.across_px**2 - width_px**2, 0)
    fall_px = np.sqrt(np.maximum(streaks.fall_px**2 - blur_px2, (_MIN_SHARP * streaks.fall_px) ** 2))
    slowness = float(np.median(fall_px[counted] / width_px[counted])) / exposure_s
    diameter_mm = _diameter_mm(slowness, fall_speed)
    speed = float(fall_speed(np.array([diameter_mm]))[0])
    rate = 3.6e6 * water * speed
    return GaugeReading(
        intensity_mm_h=rate, error_mm_h=rate / np.sqrt(len(area)), water_g_m3=1e6 * water, diameter_mm=diameter_mm,
        speed_m_s=speed, streaks=len(area), cutoff_px=cutoff, drop_light=drop_light, frames=len(frames),
    )  # fmt: skip


def light_residuals(frames: UInt8[np.ndarray, "t h w *c"]) -> LightResiduals:
    """Subtract the temporal median in linear light. Raises ValueError for fewer than 5 frames."""
    if len(frames) < MIN_FRAMES:
        raise ValueError(f"{len(frames)} frames: a temporal median free of rain takes at least {MIN_FRAMES}")
    linear = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    values = np.stack([_luminance(linear[frame]) for frame in frames])
    background = np.median(values, axis=0)
    values -= background
    level = np.interp(background, linear, np.gradient(linear)).astype(np.float32)  # of a gray level, in linear light
    spread = MAD_TO_SIGMA * np.median(np.abs(values), axis=0)
    sigma = np.maximum(cv2.blur(spread, (7, 7)), 0.5 * level)
    restless = (cv2.blur(spread / level, (7, 7)) > _RESTLESS_LEVELS).astype(np.uint8)
    still = cv2.dilate(restless, np.ones((7, 7), np.uint8)) == 0
    return LightResiduals(background, values, sigma, still)


def _luminance(linear: Float32[np.ndarray, "h w *c"]) -> Float32[np.ndarray, "h w"]:
    return linear @ LUMINANCE.astype(np.float32) if linear.ndim == 3 else linear


def drop_light_of(found: LightResiduals, focal_px: float) -> float:
    """Linear luminance of a drop: the mean radiance of the sky, which it refracts (Garg and Nayar 2007).

    The sky is what is bright and connected to the top of the frames. An overcast sky's radiance is linear in the sine
    of the elevation (CIE: 1 + 2 sin e); the line fitted to the visible part is taken at its mean over the hemisphere,
    sin e = 1/2. Raises `ValueError` if hardly any sky is there.
    """
    background = found.background
    height, width = background.shape
    darkest = max(_SKY_SHARE * float(np.quantile(background, 0.99)), _DARKEST_SKY)
    _, labels = cv2.connectedComponents((background > darkest).astype(np.uint8))
    sky = (labels > 0) & np.isin(labels, np.unique(labels[0]))
    if sky.mean() < _MIN_SKY_SHARE:
        raise ValueError("no sky at the top of the frames: the light of drops can't be read from them")
    y, x = np.nonzero(sky)
    up = (height - 1) / 2 - y
    sine = up / np.sqrt(up**2 + (x - (width - 1) / 2) ** 2 + focal_px**2)
    slope, offset = np.polyfit(sine, background[sky], 1)
    return float(min(offset + 0.5 * max(slope, 0.0), 1.0))


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
class _Streaks:
    """Streaks of all frames, in px and linear luminance."""

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

    @classmethod
    def of(cls, found: LightResiduals) -> "_Streaks":
        rows = [row for values in found.values for row in _measured(values, found)]
        table = np.array(rows, np.float64).reshape(-1, 8)
        return cls(table[:, :2], table[:, 2:4], *(np.ascontiguousarray(table[:, k]) for k in range(4, 8)))

    def __getitem__(self, chosen: Bool[np.ndarray, " n"]) -> "_Streaks":
        return _Streaks(*(getattr(self, each.name)[chosen] for each in fields(self)))


class _OpenAreas:
    """Areas of the positions at which boxes of a size lie within a mask."""

    def __init__(self, usable: Bool[np.ndarray, "h w"]) -> None:
        self._shape = usable.shape
        self._sums = cv2.integral(usable.astype(np.uint8)).astype(np.int64)
        self._areas: dict[tuple[int, int], float] = {}

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
    """Rows of `_Streaks` of one frame."""
    accepted: list[_Candidate] = []
    for each in sorted(_candidates(np.where(found.still, values / found.sigma, 0)), key=lambda each: -each.response):
        if not any(_overlap(each, other) for other in accepted):
            accepted.append(each)
    for each in accepted:
        margin = 3 + 1.5 * each.width
        half_length, half_width = each.length / 2 + margin, each.width / 2 + margin
        sine, cosine = np.sin(each.angle), np.cos(each.angle)
        box = half_width * cosine + half_length * abs(sine), half_length * cosine + half_width * abs(sine)
        light, length, across, background = _photometry(values, found.background, each, half_length, half_width)
        if light > 0:
            yield each.x, each.y, *box, light, length * cosine, across, background


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


def _overlap(one: _Candidate, other: _Candidate) -> bool:
    """Return whether the center of one lies in the box of the other."""
    for box, point in ((one, other), (other, one)):
        dx, dy = point.x - box.x, point.y - box.y
        along = dx * np.sin(box.angle) + dy * np.cos(box.angle)
        across = dx * np.cos(box.angle) - dy * np.sin(box.angle)
        if abs(along) < 0.6 * box.length + 2 and abs(across) < 0.5 * box.width + 1:
            return True
    return False


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

"""Curves as SVG, in the colours of the page that they stand in."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from .templates import rendered

WIDTH, HEIGHT = 520, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 14, 40
_POINTS = 240
"""More points than this are drawn as the mean and the span of groups of neighbours."""

_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


def chart(
    x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"], x_title: str, y_title: str, is_logarithmic: bool = False
) -> Markup:
    """Draw y over x as an SVG element; points that are not finite are left out, as are those <= 0 on a log axis."""
    shown = np.isfinite(x) & np.isfinite(y) & ((y > 0) | (not is_logarithmic))
    x, y = x[shown], y[shown]
    if len(x) == 0:
        return rendered("chart.svg")
    if is_logarithmic:
        y_ticks = [float(np.log10(value)) for value in _decade_ticks(y.min(), y.max())]
        y = np.log10(y)
    else:
        y_ticks = list(ticks(y.min(), y.max(), 5))
    low, high = min(y.min(), *y_ticks), max(y.max(), *y_ticks)
    margin = 0.0 if high > low else max(abs(low), 1.0) / 2  # a level line runs through the middle
    across = _Axis(float(x.min()), float(x.max()), _LEFT, WIDTH - _RIGHT)
    upward = _Axis(float(low - margin), float(high + margin), HEIGHT - _BOTTOM, _TOP)
    groups = np.array_split(np.arange(len(x)), min(len(x), _POINTS))
    middle = [(across(float(x[g].mean())), upward(float(y[g].mean()))) for g in groups]
    highest = [(at, upward(float(y[g].max()))) for (at, _), g in zip(middle, groups, strict=True)]
    lowest = [(at, upward(float(y[g].min()))) for (at, _), g in zip(middle, groups, strict=True)]
    return rendered(
        "chart.svg",
        width=WIDTH,
        height=HEIGHT,
        left=_LEFT,
        right=WIDTH - _RIGHT,
        bottom=HEIGHT - _BOTTOM,
        x_title=x_title,
        y_title=y_title,
        ticks_x=[(across(value), number(value)) for value in ticks(x.min(), x.max(), 6)],
        ticks_y=[(upward(value), number(10**value if is_logarithmic else value)) for value in y_ticks],
        span=_points(highest + lowest[::-1]) if len(x) > _POINTS else "",
        line=_points(middle),
        points=middle if len(x) <= 40 else (),
    )


def ticks(low: float, high: float, wanted: int) -> Iterator[float]:
    """Yield round numbers within a range, about as many as wanted and at least one."""
    if high <= low:
        yield low
        return
    rough = (high - low) / wanted
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(power * each for each in _STEPS if power * each >= rough * 0.999)
    for index in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1):
        yield float(index * step)


def _decade_ticks(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 of each power of ten within a range and its rounding outwards; of many, only the powers."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    several = [10.0**power * each for power in powers for each in ((1, 2, 5) if len(powers) <= 4 else (1,))]
    return [each for each in several if low * 0.999 <= each <= high * 1.001] or [low, high]


def number(value: float) -> str:
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.1e}".replace("e-0", "e-")
    if abs(value) >= 1e6:
        return f"{value / 1e6:.4g} M"
    return f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


class _Axis:
    def __init__(self, low: float, high: float, start: float, end: float) -> None:
        self._low, self._start = low, start
        self._scale = (end - start) / (high - low) if high > low else 0.0

    def __call__(self, value: float) -> float:
        return round(self._start + (value - self._low) * self._scale, 1)


def _points(pairs: list[tuple[float, float]]) -> str:
    return " ".join(f"{a},{b}" for a, b in pairs)

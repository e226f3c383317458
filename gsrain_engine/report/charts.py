"""Images and charts of reports: SVG curves, image comparisons, data URIs, curve styles, and templates."""

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from ..safe_io.text_files import escape_invisible

WIDTH, HEIGHT = 520, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 14, 40
_POINTS = 240  # larger numbers of points are grouped and drawn as mean and range
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


def svg_chart(
    x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"], x_title: str, y_title: str, is_logarithmic: bool = False
) -> Markup:
    """Draw y over x as an SVG element without non-finite points, and without values <= 0 on a log axis."""
    drawn = np.isfinite(x) & np.isfinite(y) & ((y > 0) | (not is_logarithmic))
    x, y = x[drawn], y[drawn]
    if len(x) == 0:
        return rendered("chart.svg")
    if is_logarithmic:
        y_ticks = [float(np.log10(value)) for value in _decade_ticks(y.min(), y.max())]
        y = np.log10(y)
    else:
        y_ticks = list(axis_ticks(y.min(), y.max(), 5))
    low, high = min(y.min(), *y_ticks), max(y.max(), *y_ticks)
    margin = 0.0 if high > low else max(abs(low), 1.0) / 2  # centers a constant line
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
        ticks_x=[(across(value), format_number(value)) for value in axis_ticks(x.min(), x.max(), 6)],
        ticks_y=[(upward(value), format_number(10**value if is_logarithmic else value)) for value in y_ticks],
        span=_points(highest + lowest[::-1]) if len(x) > _POINTS else "",
        line=_points(middle),
        points=middle if len(x) <= 40 else (),
    )


def axis_ticks(low: float, high: float, count: int) -> Iterator[float]:
    """Yield round numbers within a range, about `count` and at least one."""
    if high <= low:
        yield low
        return
    rough = (high - low) / count
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(power * each for each in _STEPS if power * each >= rough * 0.999)
    for index in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1):
        yield float(index * step)


def _decade_ticks(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 times each power of ten within a range; only the powers for a wide range."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    several = [10.0**power * each for power in powers for each in ((1, 2, 5) if len(powers) <= 4 else (1,))]
    return [each for each in several if low * 0.999 <= each <= high * 1.001] or [low, high]


def format_number(value: float) -> str:
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


# Image comparison


@dataclass(frozen=True, slots=True, eq=False)
class ImageComparison:
    """Comparison of one view: images at most 640 px wide, metrics at full size."""

    name: str
    rendered: UInt8[np.ndarray, "h w 3"]
    truth: UInt8[np.ndarray, "h w 3"]
    error: Float32[np.ndarray, "h w"]
    """Mean absolute difference of the channels, 0..1; NaN outside the mask."""
    psnr_db: float
    ssim: float
    lpips: float | None = None


_SHEET_ROWS, _SHEET_WIDTH_PX = 4, 640


def comparison_sheet(comparisons: Sequence[ImageComparison]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the first views below each other, each rendered on the left and true on the right."""
    rows: list[UInt8[np.ndarray, "h w 3"]] = []
    for each in comparisons[:_SHEET_ROWS]:
        pair = np.concatenate([each.rendered, each.truth], axis=1)
        height = max(round(pair.shape[0] * 2 * _SHEET_WIDTH_PX / pair.shape[1]), 1)
        rows.append(cv2.resize(pair, (2 * _SHEET_WIDTH_PX, height), interpolation=cv2.INTER_AREA).astype(np.uint8))
    return np.concatenate(rows) if rows else np.zeros((1, 2 * _SHEET_WIDTH_PX, 3), np.uint8)


# Data URIs and the error color scale

LARGEST_ERROR = 0.25  # upper end of the error color scale (of 1), the same in all reports for comparability
_LEFT_OUT = (128, 128, 128)
_SHADES = 256


def jpeg_data_uri(image: UInt8[np.ndarray, "h w 3"]) -> str:
    return _data_uri(image, "jpeg", [cv2.IMWRITE_JPEG_QUALITY, 88])


def png_data_uri(image: UInt8[np.ndarray, "h w 3"]) -> str:
    return _data_uri(image, "png")


def error_map_uri(error: Float32[np.ndarray, "h w"]) -> str:
    """Return the colors of an error map as a data URI; gray for NaN."""
    shares = np.nan_to_num(np.clip(error / LARGEST_ERROR, 0, 1))
    colors = _shades()[np.rint(shares * (_SHADES - 1)).astype(int)]
    colors[np.isnan(error)] = _LEFT_OUT
    return jpeg_data_uri(colors)


def color_bar_uri() -> str:
    """Return the color scale from no error to the largest, left to right, as a data URI."""
    return png_data_uri(_shades()[None])


def _shades() -> UInt8[np.ndarray, "shades 3"]:
    from matplotlib import colormaps  # slow to import, and rarely needed

    colors = colormaps["magma"](np.linspace(0, 1, _SHADES))
    return np.rint(255 * np.asarray(colors)[:, :3]).astype(np.uint8)


def _data_uri(image: UInt8[np.ndarray, "h w 3"], kind: str, options: Sequence[int] = ()) -> str:
    _, encoded = cv2.imencode(f".{kind}", np.ascontiguousarray(image[..., ::-1]), options)
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode()}"


# Curve styles

_LINES: tuple[str | tuple[int, tuple[float, ...]], ...] = (
    "-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip
_MARKERS = ("o", "s", "^", "D", "v", "P")
_LIGHTEST = 0.3  # place of the lightest shade in its color map: lighter ones are hardly visible on white
Color = tuple[float, ...]


class SeriesStyle(NamedTuple):
    """Style of one curve."""

    color: Color
    line: str | tuple[int, tuple[float, ...]]
    """A dash pattern as in Matplotlib's `linestyle`; format strings do not support custom patterns."""
    marker: str
    band: float
    """Opacity of the band around it; lower for many curves, so that bands do not hide them."""


def series_styles(count: int) -> list[SeriesStyle]:
    """Return styles of `count` curves: ten colors, repeated with other dashes and markers; the first 300 differ."""
    from matplotlib import colormaps  # slow to import, and rarely needed

    styles: list[SeriesStyle] = []
    for place in range(count):
        turn, color = divmod(place, 10)
        line, marker = _LINES[turn % len(_LINES)], _MARKERS[turn % len(_MARKERS)]
        styles.append(SeriesStyle(tuple(colormaps["tab10"](color)), line, marker, min(0.18, 1.3 / count)))
    return styles


def shades(count: int) -> list[Color]:
    """Return `count` colors from light to dark, for ordered curves."""
    from matplotlib import colormaps  # slow to import, and rarely needed

    places = np.linspace(_LIGHTEST, 1, count) if count > 1 else np.array([(_LIGHTEST + 1) / 2])
    return [tuple(colormaps["Blues"](each)) for each in places]


# Templates of pages and charts


def rendered(template: str, **values: object) -> Markup:
    """Fill a template of this folder; all values are escaped, and invisible characters are written out."""
    return Markup(_TEMPLATES.get_template(template).render(values))


def _visible(value: object) -> object:
    return value if isinstance(value, Markup) else escape_invisible(str(value))


_TEMPLATES = Environment(
    loader=PackageLoader(__package__ or "", ""),
    autoescape=True,
    finalize=_visible,
    trim_blocks=True,
    lstrip_blocks=True,
)

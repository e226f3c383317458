"""Figure of a fitted calibration: spectra with fits, fall speed, number, sizes, flux closure, axis ratio."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ..rain.calibration import Interval, atlas_velocity, load_calibration
from ..rain.properties import DropSizes
from ..rain.settings import LARGEST_MM, SMALLEST_MM
from ..safe_io.files import whole_file
from ..safe_io.text_files import figure_words
from .fit_models import AxisRatios, FittedCalibration, FittedRow

_SIZE_INCHES, _DPI = (13.0, 7.6), 150
_MAX_SPECTRA = 6
_INK, _FIT, _OTHER, _FAINT = "#222222", "#c4442b", "#2b6cb0", "#9aa3ad"
_WITHOUT_DATE: dict[str, dict[str, None]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Figure formats, each with the metadata to omit so that equal fits give byte-identical files."""

_STYLE: dict[str, Any] = {"fontsize": 8, "frameon": False}
_BARS: dict[str, Any] = {"fmt": "o", "ms": 4, "color": _INK, "ecolor": _FAINT, "elinewidth": 1}


def write_plot(fitted: FittedCalibration, path: Path | str) -> None:
    """Draw a figure and write it atomically. Raises `ValueError` for a file name that `check_plot_name` rejects."""
    path = Path(path)
    kind = check_plot_name(path)
    with whole_file(path) as beside, rc_context({"svg.hashsalt": "gsrain"}):
        draw_calibration(fitted).savefig(beside, format=kind, dpi=_DPI, metadata=_WITHOUT_DATE[kind])


def check_plot_name(path: Path) -> str:
    """Return the figure format of a file name: png, pdf or svg. Raises `ValueError` for others."""
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _WITHOUT_DATE:
        raise ValueError(f"{path}: expected a name that ends with .{', .'.join(_WITHOUT_DATE)}")
    return kind


def draw_calibration(fitted: FittedCalibration) -> Figure:
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    with_shape = fitted.axis_ratios is not None
    grid = figure.add_gridspec(2, 6)
    _draw_spectra(figure.add_subplot(grid[0, :2] if with_shape else grid[0, :3]), fitted)
    _draw_speeds(figure.add_subplot(grid[0, 2:4] if with_shape else grid[0, 3:]), fitted)
    if fitted.axis_ratios is not None:
        _draw_axis_ratio(figure.add_subplot(grid[0, 4:]), fitted.axis_ratios)
    _draw_number(figure.add_subplot(grid[1, :2]), fitted)
    _draw_sizes(figure.add_subplot(grid[1, 2:4]), fitted)
    _draw_closure(figure.add_subplot(grid[1, 4:]), fitted)
    panels = [axes for axes in figure.axes if axes.get_title()]
    for letter, axes in zip("abcdef", panels, strict=False):
        axes.set_title(f"({letter}) {axes.get_title()}", loc="left", fontsize=10)
        axes.set_title("")
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    figure.suptitle(_headline(fitted), fontsize=11)
    return figure


def _headline(fitted: FittedCalibration) -> str:
    provenance = fitted.calibration.provenance
    instrument = f"{figure_words(provenance.instrument)}, " if provenance else ""
    name = figure_words(fitted.calibration.name)
    return f"{name}: {instrument}{fitted.records_used:,} of {fitted.records:,} records in rows"


def _draw_spectra(axes: Axes, fitted: FittedCalibration) -> None:
    rows = _spread(fitted.rows)
    edges = fitted.diameter_edges_mm
    middles = 0.5 * (edges[:-1] + edges[1:])
    intensities = [each.row.intensity_mm_h for each in fitted.rows]
    colors, norm = colormaps["viridis_r"], LogNorm(0.6 * intensities[0], 1.1 * intensities[-1])
    d = np.linspace(SMALLEST_MM, LARGEST_MM, 400)
    largest = max(float(np.nanmax(each.spectrum_m3_mm)) for each in rows)
    seen = [middles[each.spectrum_m3_mm > 0].max(initial=1.0) for each in rows]
    for each in rows:
        color = colors(norm(each.row.intensity_mm_h))
        measured = each.spectrum_m3_mm > 0
        axes.plot(middles[measured], each.spectrum_m3_mm[measured], "o", ms=3.5, color=color)
        axes.plot(d, _law(each, d), "-", lw=1.4, color=color, label=f"{each.row.intensity_mm_h:.3g} mm/h")
    axes.set(yscale="log", ylim=(1e-6 * largest, 3 * largest), xlim=(0, min(LARGEST_MM, 1.05 * max(seen))))
    axes.set(xlabel="diameter D (mm)", ylabel="N(D) (m$^{-3}$ mm$^{-1}$)")
    axes.set(title="Drop spectra (points) and gamma fits (lines)")
    axes.legend(title="mean intensity", title_fontsize=8, **_STYLE)


def _law(each: FittedRow, d: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """N p(D) of the gamma law truncated to [0.1, 8] mm, in 1/(m^3 mm)."""
    return each.row.density_m3 * DropSizes(each.row.shape, each.row.scale_mm).probability_per_mm(d)


def _spread(rows: tuple[FittedRow, ...]) -> list[FittedRow]:
    """Pick a few rows from the first to the last; more spectra would be indistinguishable."""
    picked = np.unique(np.rint(np.linspace(0, len(rows) - 1, min(len(rows), _MAX_SPECTRA))).astype(int))
    return [rows[i] for i in picked]


def _draw_speeds(axes: Axes, fitted: FittedCalibration) -> None:
    velocity = fitted.calibration.velocity
    edges, reach = fitted.diameter_edges_mm, LARGEST_MM
    if fitted.speeds is not None:
        used = fitted.speeds.fitted
        middles = 0.5 * (edges[:-1] + edges[1:])
        speeds, deviations = fitted.speeds.mean_m_s[used], fitted.speeds.deviation_m_s[used]
        axes.errorbar(middles[used], speeds, deviations, label="class means, ± 1 s.d. of drops", **_BARS)
        reach = min(LARGEST_MM, 1.15 * float(middles[used].max()))
    d = np.linspace(0.1, reach, 200)
    a, b, c = velocity.coefficients
    formula = f"$V = {a:.3f} D^2 {b:+.3f} D {c:+.3f}$"
    quality = "" if velocity.r2 is None else f", $R^2$ = {velocity.r2:.3f}"
    axes.plot(d, velocity(d), color=_FIT, lw=1.8, label=formula + quality)
    axes.plot(d, atlas_velocity(d), "--", color=_OTHER, lw=1.2, label="Atlas et al. (1973)")
    axes.set(xlim=(0, reach), ylim=(0, None))
    axes.set(xlabel="diameter D (mm)", ylabel="fall speed V (m/s)", title="Fall speed")
    axes.legend(loc="lower right", **_STYLE)


def _draw_axis_ratio(axes: Axes, ratios: AxisRatios) -> None:
    middle, (low, high) = ratios.medians, ratios.quartiles
    axes.errorbar(ratios.diameters_mm, middle, [middle - low, high - middle], label="medians, quartiles", **_BARS)
    d = np.linspace(1.0, max(2.0, float(ratios.diameters_mm.max())), 50)
    line = f"${ratios.offset:.3f} {ratios.slope_per_mm:+.3f} D$"
    axes.plot(d, ratios.offset + ratios.slope_per_mm * d, color=_FIT, lw=1.8, label=f"{line}, $R^2$ = {ratios.r2:.3f}")
    axes.plot(d, 1.07 - 0.07 * d, "--", color=_OTHER, lw=1.2, label="$1.07 - 0.07 D$ (paper, eq. 4)")
    axes.set(xlabel="diameter D (mm)", ylabel="axis ratio, height / width", ylim=(0.45, 1.15), title="Axis ratio")
    axes.legend(loc="lower left", **_STYLE)


def _draw_number(axes: Axes, fitted: FittedCalibration) -> None:
    x = _intensities(fitted)
    y = np.array([each.row.density_m3 for each in fitted.rows])
    _points(axes, x, y, [_of(each, "density_m3") for each in fitted.rows], _INK, "rows")
    slope, offset = np.polyfit(np.log(x), np.log(y), 1)
    axes.plot(x, np.exp(offset) * x**slope, color=_FIT, lw=1.4, label=f"{np.exp(offset):.0f} $R^{{{slope:.2f}}}$")
    table = load_calibration("published").rows
    published = [row.intensity_mm_h for row in table], [row.density_m3 for row in table]
    axes.plot(*published, "s", ms=4, mfc="none", color=_OTHER, label="paper, table III")
    _log_intensity(axes, x)
    axes.set_yscale("log")
    _plain_decades(axes.yaxis)
    axes.set(ylabel="drops in the air N (m$^{-3}$)", title="Number density")
    axes.legend(loc="upper left", **_STYLE)


def _draw_sizes(axes: Axes, fitted: FittedCalibration) -> None:
    x = _intensities(fitted)
    scale_axes = axes.twinx()
    for side, name, color, symbol in ((axes, "shape", _INK, "µ"), (scale_axes, "scale_mm", _FIT, "θ")):
        values = np.array([getattr(each.row, name) for each in fitted.rows])
        moments = np.array([getattr(each, f"moments_{name}") for each in fitted.rows])
        title = name.partition("_")[0]
        _points(side, x, values, [_of(each, name) for each in fitted.rows], color, f"{title} {symbol}")
        side.plot(x, moments, "x", ms=5, color=color, alpha=0.5, label=f"{title} by moments")
        tops = [limits[1] for limits in (_of(each, name) for each in fitted.rows) if limits is not None]
        side.set_ylim(0, 1.35 * max(float(values.max()), float(moments.max()), *tops))
    _log_intensity(axes, x)
    axes.set_ylabel("shape µ")
    scale_axes.set_ylabel("scale θ (mm)", color=_FIT)
    scale_axes.tick_params(labelsize=8, colors=_FIT)
    scale_axes.spines[["top", "left", "bottom"]].set_visible(False)
    axes.set_title("Gamma law")
    axes.legend(loc="upper left", **_STYLE)
    scale_axes.legend(loc="upper right", **_STYLE)


def _draw_closure(axes: Axes, fitted: FittedCalibration) -> None:
    x = _intensities(fitted)
    axes.axhline(1, color=_INK, lw=0.8)
    own = fitted.minute_reported_mm_h
    both = (own > 0) & (fitted.minute_rate_mm_h > 0)
    if both.any():
        ratio = fitted.minute_rate_mm_h[both] / own[both]
        axes.plot(own[both], ratio, ".", ms=2, color=_FAINT, rasterized=True, label="minutes: counted over reported")
    implied = np.array([each.implied_mm_h for each in fitted.rows]) / x
    moments = np.array([each.moments_implied_mm_h for each in fitted.rows]) / x
    axes.plot(x, implied, "o", ms=5, color=_FIT, label="rows: implied by the fit over R")
    axes.plot(x, moments, "x", ms=6, color=_OTHER, label="rows: implied by moments over R")
    _log_intensity(axes, x)
    axes.set_ylim(min(0.6, 0.9 * float(min(implied.min(), moments.min()))), 1.6)
    axes.set_ylabel("ratio of rain rates")
    axes.set_title("Flux closure, implied: $6\\cdot10^{-4}\\,\\pi\\,N\\,E[V D^3]$")
    axes.legend(loc="upper left", **_STYLE)


def _intensities(fitted: FittedCalibration) -> Float64[np.ndarray, " rows"]:
    return np.array([each.row.intensity_mm_h for each in fitted.rows])


def _of(each: FittedRow, name: str) -> Interval | None:
    return None if each.row.confidence is None else getattr(each.row.confidence, name)


def _points(
    axes: Axes,
    x: Float64[np.ndarray, " rows"],
    y: Float64[np.ndarray, " rows"],
    limits: list[Interval | None],
    color: str,
    label: str,
) -> None:
    whiskers = ", 95 %" if any(limits) else ""
    bars = [
        (0.0, 0.0) if each is None else (max(v - each[0], 0), max(each[1] - v, 0))
        for v, each in zip(y, limits, strict=True)
    ]
    axes.errorbar(x, y, np.array(bars).T, fmt="o", ms=4, color=color, elinewidth=1, capsize=2, label=label + whiskers)


def _log_intensity(axes: Axes, x: Float64[np.ndarray, " rows"]) -> None:
    axes.set(xscale="log", xlim=(0.6 * x[0], 1.6 * x[-1]), xlabel="intensity R (mm/h)")
    _plain_decades(axes.xaxis)


def _plain_decades(axis: Axis) -> None:
    """Set ticks at 1, 2, 5, 10, ..., labeled as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())

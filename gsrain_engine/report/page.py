"""HTML report of a run: figures, curves, images, tables and settings."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import nan
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8
from markupsafe import Markup

from ..render.renderer import describe_machine
from ..safe_io.files import whole_file
from . import charts
from .charts import ImageComparison
from .table import Table, columns

MAX_IMAGES = 24  # maximum number of views: the best, the worst and evenly spaced ones between; the table lists all

# Report contents


@dataclass(frozen=True, slots=True, eq=False)
class ReportCurve:
    """A value over the course of a run."""

    name: str
    steps: Int64[np.ndarray, " n"]
    values: Float64[np.ndarray, " n"]
    times_s: Float64[np.ndarray, " n"] | None = None
    """Since the start."""
    unit: str = ""
    is_logarithmic: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ReportFigure:
    """A drawing or an image with a caption."""

    title: str
    pixels: UInt8[np.ndarray, "h w 3"]
    caption: str = ""
    is_photograph: bool = False
    """Allow JPEG compression; drawings are stored losslessly."""


@dataclass(frozen=True, slots=True, eq=False)
class RunReport:
    """Content of a run's page."""

    title: str
    settings: Mapping[str, object]
    """By name with unit, in display order."""
    curves: tuple[ReportCurve, ...] = ()
    comparisons: tuple[ImageComparison, ...] = ()
    """Held-out views, or other images if `held_out` is False."""
    timings: Mapping[str, float] = field(default_factory=dict[str, float])
    """Seconds of each part of the run."""
    headlines: Mapping[str, str] = field(default_factory=dict[str, str])
    """Figures to show first, next to the means over the views, such as {"Gaussians": "212,400"}."""
    problems: tuple[str, ...] = ()
    """Parts of the capture that were skipped, with reasons."""
    machine: Mapping[str, object] = field(default_factory=describe_machine)
    notes: tuple[str, ...] = ()
    """Remarks for readers of the figures, a sentence each."""
    held_out: bool = True
    """True if the comparisons are held-out views; otherwise they are labeled as images."""
    figures: tuple[ReportFigure, ...] = ()
    tables: tuple[Table, ...] = ()


def report_page(report: RunReport) -> str:
    """Return the whole page, byte-identical for the same run: it has no date. All text is escaped."""
    pictures = report.comparisons
    if len(pictures) > MAX_IMAGES:
        ranked = sorted(pictures, key=lambda each: -each.psnr_db)
        pictures = [ranked[i] for i in np.linspace(0, len(ranked) - 1, MAX_IMAGES).round().astype(int)]
    return charts.rendered(
        "page.html",
        report=report,
        tiles={**_means(report.comparisons, "held-out " if report.held_out else ""), **report.headlines},
        pictures=pictures,
        scores=_scores(report.comparisons),
        charts=[_charts(curve) for curve in report.curves],
        longest_s=max(*report.timings.values(), 1e-9) if report.timings else 1.0,
        duration=_duration,
        largest_error=charts.LARGEST_ERROR,
        photograph=charts.jpeg_data_uri,
        drawing=charts.png_data_uri,
        error_picture=charts.error_map_uri,
        color_bar=charts.color_bar_uri,
    )


def _means(comparisons: tuple[ImageComparison, ...], which: str) -> dict[str, str]:
    if not comparisons:
        return {}
    rows = {
        f"{which}PSNR": f"{_mean(each.psnr_db for each in comparisons):.2f} dB",
        f"{which}SSIM": f"{_mean(each.ssim for each in comparisons):.3f}",
    }
    distances = [each.lpips for each in comparisons if each.lpips is not None]
    if distances:
        rows[f"{which}LPIPS"] = f"{_mean(distances):.3f}"
    return {**rows, f"{which}views" if which else "pictures": str(len(comparisons))}


def _scores(comparisons: tuple[ImageComparison, ...]) -> Table:
    """Table of all views, with means."""
    titled = {"PSNR (dB)": ".2f", "SSIM": ".4f", "LPIPS": ".4f", "mean |difference|": ".4f"}
    values: dict[str, list[float]] = {
        "PSNR (dB)": [each.psnr_db for each in comparisons],
        "SSIM": [each.ssim for each in comparisons],
        "LPIPS": [nan if each.lpips is None else each.lpips for each in comparisons],
        "mean |difference|": [
            float(np.nanmean(each.error)) if np.isfinite(each.error).any() else nan for each in comparisons
        ],
    }
    if all(each.lpips is None for each in comparisons):
        del values["LPIPS"]
    rows = list(zip((each.name for each in comparisons), *values.values(), strict=True))
    titles = columns({"view": ""} | {name: titled[name] for name in values})
    return Table("Views", titles, rows, foot=[("mean", *map(_mean, values.values()))])


def _charts(curve: ReportCurve) -> Mapping[str, object]:
    """A curve over steps and, if its times are known, over time."""

    def over(values: Float64[np.ndarray, " n"], unit: str) -> Markup:
        return charts.svg_chart(values, curve.values, unit, curve.name, curve.is_logarithmic)

    last = charts.format_number(float(curve.values[-1])) if len(curve.values) else ""
    found = {"curve": curve, "last": last, "by_step": over(curve.steps.astype(np.float64), "step")}
    if curve.times_s is None:
        return found
    in_minutes = len(curve.times_s) > 0 and curve.times_s.max() > 300
    return {**found, "by_time": over(curve.times_s / 60, "minutes") if in_minutes else over(curve.times_s, "seconds")}


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.3g} s" if seconds < 9.95 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


# Report file


def write_report(file: Path, report: RunReport) -> None:
    """Write a self-contained HTML page with style, curves and images, atomically, creating missing folders."""
    page = report_page(report)
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as temporary:
        temporary.write_text(page, encoding="utf-8")

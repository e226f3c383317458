"""HTML page of a run: its results first, its settings last."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from .charts import chart, number
from .comparison import Comparison
from .pictures import LARGEST_ERROR, color_bar, drawing, error_picture, photograph
from .run_report import Curve, RunReport
from .templates import rendered

MOST_PICTURES = 24
"""Of more views the best, the worst and those evenly between are shown; the table has them all."""


def report_page(report: RunReport) -> str:
    """Return the whole page, the same bytes for the same run: it has no date. All text in it is escaped."""
    return rendered(
        "report.html",
        report=report,
        tiles={**_means(report.comparisons, "held-out " if report.held_out else ""), **report.headlines},
        pictures=_chosen(report.comparisons),
        scores=_scores(report.comparisons),
        charts=[_charts(curve) for curve in report.curves],
        longest_s=max(*report.timings.values(), 1e-9) if report.timings else 1.0,
        duration=_duration,
        largest_error=LARGEST_ERROR,
        photograph=photograph,
        drawing=drawing,
        error_picture=error_picture,
        color_bar=color_bar,
    )


def _means(comparisons: tuple[Comparison, ...], which: str) -> dict[str, str]:
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


def _chosen(comparisons: tuple[Comparison, ...]) -> list[Comparison]:
    if len(comparisons) <= MOST_PICTURES:
        return list(comparisons)
    ranked = sorted(comparisons, key=lambda each: -each.psnr_db)
    return [ranked[i] for i in np.linspace(0, len(ranked) - 1, MOST_PICTURES).round().astype(int)]


def _scores(comparisons: tuple[Comparison, ...]) -> Mapping[str, object]:
    """Columns, rows and means of the table of all views."""
    columns: dict[str, list[float]] = {
        "PSNR (dB)": [each.psnr_db for each in comparisons],
        "SSIM": [each.ssim for each in comparisons],
        "LPIPS": [float("nan") if each.lpips is None else each.lpips for each in comparisons],
        "mean |difference|": [_error(each) for each in comparisons],
    }
    if all(each.lpips is None for each in comparisons):
        del columns["LPIPS"]
    rows = list(zip((each.name for each in comparisons), *columns.values(), strict=True))
    return {"columns": ["view", *columns], "rows": rows, "means": ["mean", *map(_mean, columns.values())]}


def _error(comparison: Comparison) -> float:
    return float(np.nanmean(comparison.error)) if np.isfinite(comparison.error).any() else float("nan")


def _charts(curve: Curve) -> Mapping[str, object]:
    """A curve over steps and, where its times are known, over time."""

    def over(values: Float64[np.ndarray, " n"], unit: str) -> Markup:
        return chart(values, curve.values, unit, curve.name, curve.is_logarithmic)

    last = number(float(curve.values[-1])) if len(curve.values) else ""
    charts = {"curve": curve, "last": last, "by_step": over(curve.steps.astype(np.float64), "step")}
    if curve.times_s is None:
        return charts
    in_minutes = len(curve.times_s) > 0 and curve.times_s.max() > 300
    return {**charts, "by_time": over(curve.times_s / 60, "minutes") if in_minutes else over(curve.times_s, "seconds")}


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.3g} s" if seconds < 9.95 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")

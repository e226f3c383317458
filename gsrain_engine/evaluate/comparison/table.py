"""The rows of a comparison: as Markdown for a paper or an issue, as CSV, and as plain values."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from typing import Any

from gsrain_engine.evaluate.consistency.warp_error import Agreement
from gsrain_engine.evaluate.distribution.comparison import DistributionDistance

Value = str | int | float | None

_KERNEL_SCALE = 1000
_LEVELS = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRow:
    """What is known of one method."""

    name: str
    method: str
    distance: DistributionDistance
    pairs: int = 0
    everywhere: Agreement | None = None
    """Of neighbouring views; None where nobody knows where they were taken, or none show the same place."""
    outside_film: Agreement | None = None
    seconds: float | None = None
    """Of its transfer, when it ran."""

    @property
    def values(self) -> dict[str, Value]:
        """Return the table's columns, units in the names.

        The Frechet distance (>= 0, 0 is best) is called FID of Inception's features alone, else FD- and the
        extractor; the kernel distance (0 is best) KID or KD-, times 1000. "low" and "high" are ends of their 95 %
        intervals, "same" what the Frechet distance would be of two sets so large of one distribution. Errors are the
        root of the mean square between neighbouring views warped onto each other, in levels of 255 (0 is best), and
        "ratio" after over before (1 changes nothing), also "per contrast", for a transfer that greys everything lowers
        errors, and outside the water film ("dry"). Sources: `evaluate.distribution` and `evaluate.consistency`.
        """
        distance, kernel = self.distance, f"{self.distance.kernel_metric} x1000"
        low, high = (_KERNEL_SCALE * each for each in distance.kernel_interval)
        return {
            "method": self.name,
            "N": distance.fake_pictures,
            "N real": distance.real_pictures,
            distance.metric: distance.frechet,
            f"{distance.metric} low": distance.frechet_interval.low,
            f"{distance.metric} high": distance.frechet_interval.high,
            "same": distance.same.mean,
            kernel: _KERNEL_SCALE * distance.kernel,
            f"{kernel} low": low,
            f"{kernel} high": high,
            "pairs": self.pairs,
            "error before": _error(self.everywhere, of_clear=True),
            "error after": _error(self.everywhere, of_clear=False),
            "ratio": _ratio(self.everywhere),
            "per contrast": _contrast_ratio(self.everywhere),
            "dry ratio": _ratio(self.outside_film),
            "seconds": self.seconds,
        }


def markdown(rows: Sequence[ComparedRow]) -> str:
    """Write a table in Markdown: intervals in brackets behind their values, the best distance in bold."""
    distance = rows[0].distance
    kernel = f"{distance.kernel_metric} x1000"
    titles = ["method", "N", f"{distance.metric} [95 %]", "same", f"{kernel} [95 %]", "error before", "error after",
              "ratio", "per contrast", "dry ratio", "seconds"]  # fmt: skip
    best = min(row.distance.frechet for row in rows)
    lines = [_line(titles), _line(["---", *["---:"] * (len(titles) - 1)])]
    for row in rows:
        values = row.values
        frechet = _within(values, distance.metric)
        cells = [row.name, str(values["N"]), f"**{frechet}**" if row.distance.frechet == best else frechet]
        cells += [_said(values["same"]), _within(values, kernel)]
        cells += [_said(values[each]) for each in titles[5:]]
        lines.append(_line(cells))
    real = distance.real_pictures
    lines += [
        "",
        f'Compared with {real} real pictures; features: {distance.extractor}. "same": the distance of two sets',
    ]
    lines[-1] += (
        " so large of one distribution. Errors of warped neighbouring views in levels of 255; dry: outside water."
    )
    return "\n".join(lines) + "\n"


def comma_separated(rows: Sequence[ComparedRow]) -> str:
    """Write all columns as CSV, in full precision; what is not known is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows[0].values)
    writer.writerows(row.values.values() for row in rows)
    return text.getvalue()


def plain(row: ComparedRow) -> dict[str, Any]:
    """Return a row for JSON, with its extractor and what is to be said about it."""
    distance = row.distance
    return {
        "name": row.name,
        "method": row.method,
        "metric": distance.metric,
        "kernel_metric": distance.kernel_metric,
        "extractor": distance.extractor,
        "real_pictures": distance.real_pictures,
        "fake_pictures": distance.fake_pictures,
        "frechet": distance.frechet,
        "frechet_interval": list(distance.frechet_interval),
        "same": {"mean": distance.same.mean, "interval": list(distance.same.interval)},
        "kernel": distance.kernel,
        "kernel_interval": list(distance.kernel_interval),
        "pairs": row.pairs,
        "rmse_before": _rmse(row.everywhere, of_clear=True),
        "rmse_after": _rmse(row.everywhere, of_clear=False),
        "ratio": _ratio(row.everywhere),
        "contrast_ratio": _contrast_ratio(row.everywhere),
        "dry_ratio": _ratio(row.outside_film),
        "seconds": row.seconds,
        "warnings": list(distance.warnings),
    }


def _rmse(agreement: Agreement | None, *, of_clear: bool) -> float | None:
    if agreement is None:
        return None
    error = agreement.before if of_clear else agreement.after
    return None if error is None else error.rmse


def _error(agreement: Agreement | None, *, of_clear: bool) -> float | None:
    rmse = _rmse(agreement, of_clear=of_clear)
    return None if rmse is None else _LEVELS * rmse


def _ratio(agreement: Agreement | None) -> float | None:
    return None if agreement is None or isnan(agreement.ratio) else agreement.ratio  # JSON has no NaN


def _contrast_ratio(agreement: Agreement | None) -> float | None:
    return None if agreement is None or isnan(agreement.contrast_ratio) else agreement.contrast_ratio


def _within(values: dict[str, Value], name: str) -> str:
    return f"{_said(values[name])} [{_said(values[f'{name} low'])}, {_said(values[f'{name} high'])}]"


def _said(value: Value) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"

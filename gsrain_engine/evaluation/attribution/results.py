"""Results of an attribution: shares with intervals over seeds, as JSON, CSV, report table and figure."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...safe_io.files import whole_file
from ...safe_io.text_files import figure_words
from ..report import ReportTable
from ..report_charts import series_styles
from .factors import RainFactors, title_of
from .shapley import Coalition, Values, shapley_shares, student_interval


class Measure(NamedTuple):
    """A number that is attributed."""

    name: str
    title: str
    """For tables and figures, with its unit."""
    object: str | None = None
    """Labeled object that it is about; None for all."""


class ShareInterval(NamedTuple):
    """A mean over the seeds with its 95 % interval; its ends are NaN for one seed."""

    mean: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        return (self.high - self.low) / 2


@dataclass(frozen=True, eq=False)
class Attribution:
    """Shares of the factors in what rain does to one measure of one subject."""

    subject: Mapping[str, str]
    """Names of what is measured, such as the detector, by column."""
    intensity_mm_h: float
    measure: Measure
    factors: tuple[str, ...]
    coalitions: int
    """Evaluated coalitions of each seed."""
    seeds: tuple[int, ...]
    without: Float64[np.ndarray, " n"]
    """Value of each seed without rain."""
    rainy: Float64[np.ndarray, " n"]
    """Value of each seed with all factors."""
    by_seed: Float64[np.ndarray, "n k"]
    """Share of each factor for each seed; a seed's sum to its whole effect."""

    @property
    def whole(self) -> ShareInterval:
        """Effect of all factors together."""
        return ShareInterval(*student_interval(self.rainy - self.without))

    @property
    def shares(self) -> dict[str, ShareInterval]:
        """Share of each factor, over the seeds."""
        return {
            name: ShareInterval(*student_interval(own)) for name, own in zip(self.factors, self.by_seed.T, strict=True)
        }

    @property
    def title(self) -> str:
        return ", ".join((*self.subject.values(), f"{self.intensity_mm_h:g} mm/h"))

    @property
    def plain(self) -> dict[str, Any]:
        """Values for JSON."""
        whole = self.whole
        shares = [
            {"factor": name, **_finite(each), "part_of_whole": each.mean / whole.mean if whole.mean else None}
            for name, each in self.shares.items()
        ]
        return {
            **self.subject, "intensity_mm_h": self.intensity_mm_h, "measure": self.measure.name,
            "title": self.measure.title, "object": self.measure.object, "seeds": list(self.seeds),
            "coalitions": self.coalitions, "without_rain": float(self.without.mean()),
            "in_rain": float(self.rainy.mean()), "whole": _finite(whole), "shares": shares,
        }  # fmt: skip


def _finite(interval: ShareInterval) -> dict[str, float | None]:
    return {name: None if value != value else value for name, value in interval._asdict().items()}


def attributions(
    subject: Mapping[str, str],
    intensity_mm_h: float,
    factors: RainFactors,
    measures: Sequence[Measure],
    values: Mapping[int, Values],
) -> list[Attribution]:
    """Attribute the effect on each measure; `values` has, by seed, the measures of each evaluated coalition."""
    seeds = tuple(sorted(values))
    shares = np.stack([
        shapley_shares(factors.names, {each: values[seed][same] for each, same in factors.coalitions.items()})
        for seed in seeds
    ])  # fmt: skip
    none: Coalition = frozenset()
    without, rainy = (np.stack([values[seed][each] for seed in seeds]) for each in (none, frozenset(factors.names)))
    return [
        Attribution(
            subject, intensity_mm_h, measure, factors.names, len(factors.evaluated), seeds,
            without[:, m], rainy[:, m], shares[:, :, m],
        )
        for m, measure in enumerate(measures)
    ]  # fmt: skip


# Tables

WHOLE = "whole effect"


def share_rows(found: Iterable[Attribution]) -> list[tuple[str | float | None, ...]]:
    """Return a row per factor, and one for the whole effect, of each attribution: see `share_table`."""
    rows: list[tuple[str | float | None, ...]] = []
    for each in found:
        whole = each.whole
        for name, own in (*((title_of(name), own) for name, own in each.shares.items()), (WHOLE, whole)):
            part = 100 * own.mean / whole.mean if whole.mean else None
            words = each.measure.title, each.measure.object or ""
            ends = [None if end != end else end for end in (own.low, own.high)]
            rows.append((*each.subject.values(), f"{each.intensity_mm_h:g}", *words, name, own.mean, *ends, part))
    return rows


_SHAPLEY = (
    "Shapley shares: the change when a factor is added, in the mean over the orders in which factors can be added; "
    "they sum to the whole effect, the difference between this rain and the clear scene. "
)
OVER = (
    "Intervals: Student's, 95 %, over the seeds, which pair; they cover the variation of the drops, not other places."
)


def share_table(found: Sequence[Attribution]) -> ReportTable:
    """Return the table of all shares for a report."""
    columns = (*found[0].subject, "mm/h", "measure", "object", "factor", "share", "95 % from", "95 % to", "% of whole")
    caption = _SHAPLEY + method_of(found[0].plain) + OVER
    return ReportTable("Shares of the factors", columns, tuple(share_rows(found)), 4, caption)


def method_of(attribution: Mapping[str, Any]) -> str:
    """Return a sentence on how shares were computed, from an attribution's plain values."""
    seeds = len(attribution["seeds"])
    return f"{seeds} seed{'' if seeds == 1 else 's'}, {attribution['coalitions']} coalitions a seed. "


def write_share_csv(file: Path, found: Sequence[Attribution]) -> None:
    """Write the share of each factor for each seed, and the values without rain and with all of it."""
    with whole_file(file) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header = "intensity_mm_h", "measure", "object", "seed", "without_rain", "in_rain", "factor", "share"
        writer.writerow((*found[0].subject, *header))
        for each in found:
            for n, seed in enumerate(each.seeds):
                shared = each.intensity_mm_h, each.measure.name, each.measure.object or "", seed
                ends = float(each.without[n]), float(each.rainy[n])
                for k, name in enumerate(each.factors):
                    writer.writerow((*each.subject.values(), *shared, *ends, name, float(each.by_seed[n, k])))


# Figure

_DPI = 150
_PANEL_WIDTH_IN, _ROW_IN = 4.3, 0.34
_MAX_SERIES = 6


def share_figure(found: Sequence[Attribution]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the shares as bars with their intervals: a panel per measure, a color per subject and intensity.

    The whole effect is the lowest bar, apart. The same shares give byte-identical images.
    """
    measures = list(dict.fromkeys(each.measure for each in found))
    titles = list(dict.fromkeys(each.title for each in found))[:_MAX_SERIES]
    names = list(dict.fromkeys(name for each in found for name in each.factors))
    rows = len(names) + 1.4
    height = max(2.2, _ROW_IN * rows * max(1.0, 0.55 * len(titles))) + 0.75 + 0.2 * len(titles)
    figure = Figure(figsize=(_PANEL_WIDTH_IN * len(measures) + 0.9, height), layout="constrained", dpi=_DPI)
    panels: list[Axes] = list(np.ravel(figure.subplots(1, len(measures), sharey=True)))
    thick = 0.8 / len(titles)
    places = [-float(k) for k in range(len(names))]
    for panel, measure in zip(panels, measures, strict=True):
        for number, (title, style) in enumerate(zip(titles, series_styles(len(titles)), strict=True)):
            own = next((each for each in found if each.measure == measure and each.title == title), None)
            if own is None:
                continue
            aside = thick * ((len(titles) - 1) / 2 - number)
            drawn = [(places[names.index(name)] + aside, each) for name, each in own.shares.items()]
            drawn.append((1 - rows + aside, own.whole))
            y, spans = [place for place, _ in drawn], [each for _, each in drawn]
            half = [0.0 if each.half_width != each.half_width else each.half_width for each in spans]
            panel.barh(
                y, [each.mean for each in spans], 0.9 * thick, color=style.color, xerr=half,
                error_kw={"elinewidth": 1.1, "capsize": 2.5, "ecolor": "0.25"}, label=figure_words(title, 48),
            )  # fmt: skip
        panel.axvline(0, color="0.3", lw=0.8)
        panel.axhline(0.5 - len(names), color="0.75", lw=0.8)
        panel.set_xlabel(f"change of {measure.title}")
        panel.set_yticks([*places, 1 - rows], [*map(title_of, names), WHOLE])
        panel.locator_params(axis="x", nbins=6)  # labels have room
        panel.grid(alpha=0.3, axis="x")
        panel.spines[["top", "right", "left"]].set_visible(False)
        panel.tick_params(axis="y", length=0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, fontsize=8, ncols=min(2, len(labels)))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()

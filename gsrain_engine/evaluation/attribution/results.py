"""Results of an attribution: shares with intervals over seeds, as JSON, CSV, report table and figure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...report.charts import series_styles
from ...report.interval import Interval
from ...report.table import Cell, Column, Table, columns
from ...safe_io.text_files import figure_words
from .factors import RainFactors, title_of
from .shapley import Coalition, Values, shapley_shares


class Measure(NamedTuple):
    """A number that is attributed."""

    name: str
    title: str
    """For tables and figures, with its unit."""
    object: str | None = None
    """Labeled object that it is about; None for all."""


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
    def whole(self) -> Interval:
        """Effect of all factors together."""
        return Interval.student(self.rainy - self.without, "rain seeds")

    @property
    def shares(self) -> dict[str, Interval]:
        """Share of each factor, over the seeds."""
        by_factor = zip(self.factors, self.by_seed.T, strict=True)
        return {name: Interval.student(own, "rain seeds") for name, own in by_factor}

    @property
    def title(self) -> str:
        return ", ".join((*self.subject.values(), f"{self.intensity_mm_h:g} mm/h"))

    @property
    def plain(self) -> dict[str, Any]:
        """Values for JSON."""
        whole = self.whole
        shares = [
            {"factor": name, **each.plain, "part_of_whole": each.value / whole.value if whole.value else None}
            for name, each in self.shares.items()
        ]
        return {
            **self.subject, "intensity_mm_h": self.intensity_mm_h, "measure": self.measure.name,
            "title": self.measure.title, "object": self.measure.object, "seeds": list(self.seeds),
            "coalitions": self.coalitions, "without_rain": float(self.without.mean()),
            "in_rain": float(self.rainy.mean()), "whole": whole.plain, "shares": shares,
        }  # fmt: skip


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


_SHAPLEY = (
    "Shapley shares: the change when a factor is added, in the mean over the orders in which factors can be added; "
    "they sum to the whole effect, the difference between this rain and the clear scene. "
)
OVER = (
    "Intervals: Student's, 95 %, over the seeds, which pair; they cover the variation of the drops, not other places."
)


def share_table(found: Sequence[Attribution]) -> Table:
    """Return the table of all shares."""
    titled = columns({**dict.fromkeys(found[0].subject, ""), "mm/h": "g", "measure": "", "object": "", "factor": ""})
    rows: list[tuple[Cell, ...]] = []
    for each in found:
        whole = each.whole
        for name, own in (*((title_of(name), own) for name, own in each.shares.items()), (WHOLE, whole)):
            part = own.value / whole.value if whole.value else None
            about = each.intensity_mm_h, each.measure.title, each.measure.object or "", name
            rows.append((*each.subject.values(), *about, own, part))
    shares = Column("change", "+.4f"), Column("part", ".0%")
    return Table("Shares of the factors", (*titled, *shares), rows, _SHAPLEY + method_of(found[0]) + OVER)


def method_of(attribution: Attribution) -> str:
    """Return a sentence on how shares were computed."""
    seeds = len(attribution.seeds)
    return f"{seeds} seed{'' if seeds == 1 else 's'}, {attribution.coalitions} coalitions a seed. "


def seed_table(found: Sequence[Attribution]) -> Table:
    """Return the share of each factor for each seed, with the values without rain and with all of it."""
    header = "intensity_mm_h", "measure", "object", "seed", "without_rain", "in_rain", "factor", "share"
    rows = [
        (
            *each.subject.values(), each.intensity_mm_h, each.measure.name, each.measure.object or "", seed,
            float(each.without[n]), float(each.rainy[n]), name, float(each.by_seed[n, k]),
        )
        for each in found for n, seed in enumerate(each.seeds) for k, name in enumerate(each.factors)
    ]  # fmt: skip
    return Table("Shares by seed", columns((*found[0].subject, *header)), rows)


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
                y, [each.value for each in spans], 0.9 * thick, color=style.color, xerr=half,
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

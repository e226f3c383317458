"""Attribution of what rain does to detectors: conditions of all coalitions of its factors, and shares of each.

Also comparisons of drop sizes at equal rain rate.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from msgspec import structs

from ...rain.calibration import load_calibration
from ...rain.properties import rain_properties
from ...rain.settings import RainSettings
from ...report.charts import series_styles
from ...report.interval import Interval
from ...report.table import Table, columns
from ...safe_io.text_files import figure_words
from ...scene.scene import Scene
from ...water.spray import has_fast_vehicles
from ..attribution.factors import LIGHT, RainFactors, factor_names, on_wet_ground, title_of
from ..attribution.results import Attribution, Measure, attributions
from ..attribution.shapley import Coalition
from .figures import figure_pixels
from .run import Condition, DetectionResult, RainVariant, object_rows
from .summary import FOUND_FROM, confidence_change, few_objects

NONE = "none"
"""Name of the variant without any factor."""


@dataclass(frozen=True, eq=False)
class RainAttribution:
    """Factors of the rain at one intensity, and the condition of each coalition."""

    intensity_mm_h: float
    factors: RainFactors
    seeds: tuple[int, ...]
    in_front: bool
    """True for rain in front of photographs, which themselves are the coalition of no factor."""

    def condition(self, present: Coalition, seed: int) -> Condition:
        """Condition of a coalition; with all factors, that of the evaluation itself."""
        names = self.factors.names
        if present == frozenset(names):
            return Condition("rainy", self.intensity_mm_h, (seed,))
        if not present and self.in_front:
            return Condition("original", 0.0, self.seeds)
        if not present:  # only a sensor's noise depends on the seed
            return Condition("clear", 0.0, self.seeds if self.factors.rain.sensor is None else (seed,), NONE)
        return Condition("rainy", self.intensity_mm_h, (seed,), "+".join(name for name in names if name in present))

    @property
    def conditions(self) -> list[Condition]:
        """Conditions of all coalitions and seeds, each once, and those of `steps`."""
        each = [self.condition(present, seed) for seed in self.seeds for present in self.factors.evaluated]
        return list(dict.fromkeys([*each, *(condition for _, condition in self.steps)]))

    @property
    def steps(self) -> list[tuple[str, Condition]]:
        """Conditions of the first seed in which one factor after the other is added, with titles."""
        names = self.factors.names
        titles = ["without rain", *(f"+ {title_of(each)}" for each in names)]
        return [(title, self.condition(frozenset(names[:k]), self.seeds[0])) for k, title in enumerate(titles)]

    def variants(self, own: RainVariant, twin: RainVariant | None) -> dict[str, RainVariant]:
        """Rain and scene of each variant; `own` is the evaluation's, `twin` has the scene with the light alone."""
        found: dict[str, RainVariant] = {}
        for present in self.factors.evaluated:
            name = self.condition(present, self.seeds[0]).variant
            if name:
                weather = self.factors.weather(present)
                place = twin if weather.in_twin and twin is not None else own
                found[name] = place._replace(rain=weather.rain, without=weather.without)
        return found

    def attributed(self, results: Sequence[DetectionResult]) -> list[Attribution]:
        """Attribute the change of confidence and recall, of all objects together and of each one."""
        found: list[Attribution] = []
        for detector, by_condition in _by_detector(results).items():
            base = by_condition[self.condition(frozenset(), self.seeds[0])]
            objects = {truth.id: truth.class_name for result in base for truth in result.truths}
            if not objects:
                continue
            measures = [
                Measure("confidence", "confidence"),
                Measure("recall", f"recall@{FOUND_FROM:g}"),
                *(Measure("confidence", "confidence", f"{name} ({kind})") for name, kind in objects.items()),
            ]
            values = {
                seed: {
                    present: _values(by_condition[self.condition(present, seed)], objects)
                    for present in self.factors.evaluated
                }
                for seed in self.seeds
            }
            found += attributions({"detector": detector}, self.intensity_mm_h, self.factors, measures, values)
        return found


def rain_attributions(
    rain: RainSettings,
    names: Sequence[str],
    scene_name: str | None,
    scene: Scene,
    intensities_mm_h: Iterable[float],
    seeds: Sequence[int],
    *,
    in_front: bool,
    softens_light: bool = False,
) -> list[RainAttribution]:
    """Take the rain apart at each intensity above 0.

    `names`, `scene_name` as for `RainFactors.of`; `softens_light` where photographs may be under clouds. Raises
    ValueError for factors that are unknown or that the scene lacks, and for a rain without any.
    """
    lacking: set[str] = set()
    if in_front:
        lacking = set(factor_names()) - {"streaks", "medium", "glass"} - ({LIGHT} if softens_light else set())
    elif not scene.has_wet_colors:
        lacking = set(on_wet_ground())
    else:
        lacking = {"mirror"} if scene.water is None else set()
        lacking |= set() if has_fast_vehicles(scene) else {"spray"}
    found: list[RainAttribution] = []
    for intensity in intensities_mm_h:
        if intensity > 0:
            at = structs.replace(rain, intensity_mm_h=intensity)
            factors = RainFactors.of(at, names, scene_name, tuple(lacking))
            if not factors.names:
                raise ValueError(f"attribute: at {intensity:g} mm/h this rain has no factors")
            found.append(RainAttribution(intensity, factors, tuple(seeds), in_front))
    if not found:
        raise ValueError("attribute: expected a --rain above 0 mm/h")
    return found


def _by_detector(results: Sequence[DetectionResult]) -> dict[str, dict[Condition, list[DetectionResult]]]:
    found: dict[str, dict[Condition, list[DetectionResult]]] = defaultdict(lambda: defaultdict(list))
    for each in results:
        found[each.detector][each.trial].append(each)
    return found


def _values(results: Sequence[DetectionResult], objects: Iterable[str]) -> Float64[np.ndarray, " m"]:
    """Mean confidence, with misses as 0, recall, and the mean confidence of each object."""
    of: dict[str, list[float]] = {name: [] for name in objects}
    for result in results:
        for truth, match in zip(result.truths, result.matches, strict=True):
            of[truth.id].append(match.confidence)
    every = np.array([confidence for own in of.values() for confidence in own])
    return np.array([every.mean(), np.mean(every >= FOUND_FROM), *(np.mean(own) for own in of.values())])


# Drop sizes at equal rain rate


def size_variant(scale: float) -> str:
    """Name of the variant whose drops have scaled diameters."""
    return f"x{scale:g}"


@dataclass(frozen=True, slots=True)
class DropSizeScore:
    """Scores of a detector in rain of one rate whose diameters are scaled."""

    detector: str
    intensity_mm_h: float
    diameter_scale: float
    mean_diameter_mm: float
    drops_per_m3: float
    extinction_per_m: float
    confidence: Interval
    """Mean over objects, 0..1, missed ones as 0."""
    recall: Interval
    change: Interval
    """Change of the mean confidence from the scene without rain, by object and seed."""

    @property
    def plain(self) -> dict[str, Any]:
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: each.plain if isinstance(each, Interval) else each for name, each in values.items()}


def drop_size_scores(
    results: Sequence[DetectionResult], rain: RainSettings, conditions: Mapping[float, Sequence[Condition]]
) -> list[DropSizeScore]:
    """Score detectors by drop size; `conditions` has, by scale, those of all intensities and seeds."""
    found: list[DropSizeScore] = []
    calibration = load_calibration(rain.calibration)
    for detector, by_condition in _by_detector(results).items():
        bases = [each for each in by_condition if each.kind != "rainy" and not each.variant]
        base = next((each for each in bases if each.kind == "clear"), bases[0])
        objects = dict.fromkeys(truth.id for result in by_condition[base] for truth in result.truths)
        if not objects:
            continue
        without = [row for result in by_condition[base] for row in object_rows(result)]
        for intensity in sorted({each.intensity_mm_h for own in conditions.values() for each in own}):
            for scale, own in conditions.items():
                at = [each for each in own if each.intensity_mm_h == intensity]
                values = np.array([_values(by_condition[each], objects)[:2] for each in at])
                pairs = {
                    (seed := each.seeds[0]): (
                        [row for result in by_condition[each] for row in object_rows(result)],
                        [row for row in without if row.seed == seed],
                    )
                    for each in at
                }
                state = rain_properties(
                    structs.replace(rain, intensity_mm_h=intensity, diameter_scale=scale), calibration
                )
                found.append(
                    DropSizeScore(
                        detector, intensity, scale, state.mean_diameter_mm, state.density_m3, state.extinction_per_m,
                        Interval.spread(values[:, 0], "rain seeds"), Interval.spread(values[:, 1], "rain seeds"),
                        confidence_change(pairs),
                    )
                )  # fmt: skip
    return found


def drop_size_table(scores: Sequence[DropSizeScore]) -> Table:
    """Table of the scores by drop size."""
    titled = {
        "detector": "", "mm/h": "g", "diameters x": "g", "mean diameter (mm)": ".2f", "drops per m³": ",.0f",
        "extinction (1/km)": ".3f", "confidence": ".3f", "change": "+.3f", f"recall@{FOUND_FROM:g}": ".0%",
    }  # fmt: skip
    rows = [
        (
            each.detector, each.intensity_mm_h, each.diameter_scale, each.mean_diameter_mm, each.drops_per_m3,
            1000 * each.extinction_per_m, each.confidence.value, each.change, each.recall.value,
        )
        for each in scores
    ]  # fmt: skip
    caption = "Rain of equal mm/h whose diameters are multiplied; means over objects and rain seeds, misses as 0."
    return Table("Drop sizes", columns(titled), rows, caption + few_objects(each.change for each in scores))


def drop_size_figure(scores: Sequence[DropSizeScore]) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the change of confidence over the mean diameter, with its intervals; a curve for each rate."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    panel: Axes = figure.subplots()
    groups = list(dict.fromkeys((each.detector, each.intensity_mm_h) for each in scores))
    for style, (detector, intensity) in zip(series_styles(len(groups)), groups, strict=True):
        own = [each for each in scores if (each.detector, each.intensity_mm_h) == (detector, intensity)]
        x, means = [each.mean_diameter_mm for each in own], [each.change.value for each in own]
        sides = [(each.value - each.low, each.high - each.value) for each in (score.change for score in own)]
        half = np.nan_to_num(np.transpose(sides))
        panel.errorbar(
            x, means, half, color=style.color, linestyle=style.line, marker=style.marker, markersize=4, capsize=2.5,
            label=f"{figure_words(detector, 28)}, {intensity:g} mm/h",
        )  # fmt: skip
    panel.axhline(0, color="0.3", lw=0.8)
    panel.set_xscale("log")
    diameters = sorted({round(each.mean_diameter_mm, 2) for each in scores})
    panel.set_xticks(diameters, [f"{each:g}" for each in diameters])
    panel.minorticks_off()
    panel.set_xlabel("mean diameter of the drops (mm)")
    panel.set_ylabel("change of confidence from the clear scene")
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False, fontsize=8)
    return figure_pixels(figure)

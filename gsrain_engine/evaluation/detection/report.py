"""Results of an evaluation of detectors: numbers, tables, figures, and a folder of all."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ...rain.properties import extinction_note
from ...render.images import write_image
from ...render.photograph import light_words
from ...report.numbers import command_line, finite_numbers, version_of, write_json
from ...report.page import ReportFigure, RunReport, write_report
from ...report.table import Table
from ..attribution.results import OVER, Attribution, method_of, seed_table, share_figure, share_table
from . import summary
from .attribution import DropSizeScore, drop_size_figure, drop_size_table
from .figures import figure_pixels, object_figure, precision_figure
from .ground_truth import MIN_HEIGHT_PX, MIN_VISIBILITY
from .metrics import Robustness
from .run import DetectionResult, ObjectRow, object_rows
from .sources import EvaluatedViews

PACKAGES = ("gsrain", "onnxruntime", "numpy", "numba", "opencv-python-headless")
"""Packages that affect images and detections."""

_BANDS = (
    "A point is the mean over frames and seeds; a band reaches from the lowest to the highest seed. Crosses: the "
    "pictures as they were taken, where the scene is a reconstruction."
)

Sheet = UInt8[np.ndarray, "h w 3"]


class SampleView(NamedTuple):
    """Pictures of one view for the output folder."""

    name: str
    sheet: Sheet
    """The view in each condition, with the detections."""
    truth: Sheet
    """The view as taken, else without rain, with its ground truth."""


@dataclass(frozen=True, slots=True, eq=False)
class DetectionReport:
    """Results of an evaluation: rows of objects, scores, tables, figures and sample views."""

    rows: list[ObjectRow]
    scores: list[summary.ScoreByIntensity]
    distances: list[summary.DistanceScore]
    robustness: dict[str, Robustness]
    settings: dict[str, Any]
    not_named: dict[str, dict[str, int]]
    """Number of objects by detector and class that the detector can't name; they are not scored."""
    silent: list[str]
    """Detectors that found nothing in any image without rain."""
    shares: Sequence[Attribution] = ()
    """Shares of the factors of the rain, if it was taken apart."""
    drop_sizes: Sequence[DropSizeScore] = ()
    """Scores by drop size, if several were compared."""
    samples: Sequence[SampleView] = ()
    steps: Sheet | None = None
    """The first view while the parts of the rain are added one by one, if it was taken apart."""

    @property
    def table(self) -> Table:
        """Scores of each detector by intensity."""
        return summary.scores_table(self.scores)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Scores, then the shares of the factors, drop sizes and recall by distance, where there are some."""
        found = [self.table]
        found += [share_table(self.shares)] if self.shares else []
        found += [drop_size_table(self.drop_sizes)] if self.drop_sizes else []
        found += [summary.distance_table(self.distances)] if self.distances else []
        return tuple(found)

    @property
    def printed(self) -> tuple[Table, ...]:
        """The tables for a terminal: without the shares of each object, and without distances."""
        own = [each for each in self.shares if each.measure.object is None]
        return replace(self, shares=own, distances=[]).tables

    @property
    def figure(self) -> Image.Image:
        """Confidence by intensity, of each object."""
        return Image.fromarray(figure_pixels(object_figure(self.rows, "confidence")))

    @property
    def notes(self) -> list[str]:
        """A sentence for each detector that finds nothing or lacks a class, and one on the light of photographs."""
        silent = [
            f"Warning: {name} finds nothing in any clear picture (confidence of {summary.FOUND_FROM:g} or more): its "
            "description may be wrong in channels, scale, mean, deviation, fit or padding."
            for name in self.silent
        ]
        light = self.settings["light"]
        silent += [f"light of the photographs: {light_words(light)}"] if light else []
        return silent + [
            f"Not asked of {name}, which has no word for them: {_listed(each)}."
            for name, each in self.not_named.items()
            if each
        ]

    @property
    def plain(self) -> dict[str, Any]:
        attribution = {"attribution": [each.plain for each in self.shares]} if self.shares else {}
        sizes = {"drop_sizes": [each.plain for each in self.drop_sizes]} if self.drop_sizes else {}
        return self._own | attribution | sizes

    @property
    def _own(self) -> dict[str, Any]:
        return {
            "settings": self.settings,
            "robustness": finite_numbers({name: asdict(each) for name, each in self.robustness.items()}),
            "not_named": self.not_named,
            "finds_nothing": self.silent,
            "scores": [summary.plain(each) for each in self.scores],
            "recall_by_distance": [summary.plain(each) for each in self.distances],
            "rows": finite_numbers([row.plain() for row in self.rows]),
        }

    def save(self, folder: Path | str) -> list[str]:
        """Write tables, figures, the report page and numbers into a folder; returns the names of the files."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        written = ["rows.csv", "detection.json"]
        summary.write_csv(folder / "rows.csv", self.rows)
        if summary.write_parquet(folder / "rows.parquet", self.rows):
            written.append("rows.parquet")
        write_json(folder / "detection.json", self.plain)
        figures = {
            "confidence.png": ReportFigure("Confidence", figure_pixels(object_figure(self.rows, "confidence")), _BANDS),
            "iou.png": ReportFigure("Overlap of boxes", figure_pixels(object_figure(self.rows, "iou")), _BANDS),
            "precision.png": ReportFigure("Average precision", figure_pixels(precision_figure(self.scores)), _BANDS),
        }
        figures = _attribution_figures(self) | figures
        if self.shares:
            seed_table(self.shares).write_csv(folder / "attribution.csv")
            written.append("attribution.csv")
        caption = "Full lines: found. Dashed: labelled, red where it was missed."
        for number, sample in enumerate(self.samples):
            figures[f"view_{number}.png"] = ReportFigure(sample.name, sample.sheet, caption, is_photograph=True)
        truths = {f"truth_{number}.png": sample.truth for number, sample in enumerate(self.samples)}
        for name, pixels in ({name: figure.pixels for name, figure in figures.items()} | truths).items():
            write_image(folder / name, Image.fromarray(pixels))
        write_report(folder / "report.html", _page(self, list(figures.values())))
        return [*written, *figures, *truths, "report.html"]


@dataclass(frozen=True, eq=False)
class RainShares:
    """Shares of the parts of the rain in what it does to detectors."""

    report: DetectionReport
    """Of the evaluation that they are computed from."""

    @property
    def shares(self) -> Sequence[Attribution]:
        """Shares in the change of confidence and recall, of all objects together."""
        return [each for each in self.report.shares if each.measure.object is None]

    @property
    def table(self) -> Table:
        """The share of each part, with its interval over the seeds."""
        return share_table(self.shares)

    @property
    def figure(self) -> Image.Image:
        """The shares as bars."""
        return Image.fromarray(share_figure(self.shares))

    def save(self, folder: Path | str) -> list[str]:
        """Write all of the evaluation into a folder; returns the names of the files."""
        return self.report.save(folder)


def detection_report(
    judgements: Sequence[DetectionResult],
    views: EvaluatedViews,
    facts: Mapping[str, Any],
) -> DetectionReport:
    """Compute the numbers of the evaluation's own conditions; `facts` are further settings of the report.

    Raises ValueError if no view shows a detectable object.
    """
    judgements = [each for each in judgements if not each.trial.variant]
    rows = [row for each in judgements for row in object_rows(each)]
    not_named = _not_named(judgements)
    if not rows and any(not_named.values()):
        words = "; ".join(f"{name} has no word for {_listed(each)}" for name, each in not_named.items() if each)
        raise ValueError(f"{views.name}: nothing there can be named: {words}")
    if not rows:
        raise ValueError(
            f"{views.name}: none of {len(views.frames)} views shows an object of {MIN_HEIGHT_PX:g} px or more, "
            f"{MIN_VISIBILITY:.0%} visible; choose others by --frames, --from, --to, --cameras or --width"
        )
    scored = summary.scores(rows, judgements)
    camera = views.frames[0].shot.camera
    rain = msgspec.to_builtins(views.pictures.rain)
    del rain["intensity_mm_h"], rain["seed"]
    settings = {
        "source": views.name,
        "command": command_line(),
        "frames": [each.name for each in views.frames],
        "size_px": [camera.width, camera.height],
        "rain": rain,
        "extinction": extinction_note(
            msgspec.structs.replace(views.pictures.rain, intensity_mm_h=each.intensity_mm_h) for each in scored
        ),
        "rain_before_pictures": views.pictures.photos is not None,
        "light": views.pictures.lights(views.frames, max(row.intensity_mm_h for row in rows)),
        "pictures": {
            f"{intensity:g} mm/h": msgspec.to_builtins(views.pictures.provenance(views.frames[0], intensity))
            for intensity in sorted({row.intensity_mm_h for row in rows if row.picture == "rainy"})
        },
        "least_iou": 0.5,
        "found_from_confidence": summary.FOUND_FROM,
        "least_height_px": MIN_HEIGHT_PX,
        "least_visibility": MIN_VISIBILITY,
        "versions": {name: version_of(name) for name in PACKAGES},
        **facts,
    }
    distances, robustness = summary.distance_scores(rows), summary.robustness_of(scored)
    return DetectionReport(
        rows, scored, distances, robustness, settings, not_named, summary.silent_detectors(judgements)
    )


def _not_named(judgements: Sequence[DetectionResult]) -> dict[str, dict[str, int]]:
    found: dict[str, set[tuple[str, str, str]]] = {each.detector: set() for each in judgements}
    for each in judgements:
        found[each.detector] |= {(each.frame, truth.id, truth.class_name) for truth in each.not_named}
    return {
        name: dict(sorted(Counter(class_name for _, _, class_name in objects).items()))
        for name, objects in found.items()
    }


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())


# Page


def _attribution_figures(numbers: DetectionReport) -> dict[str, ReportFigure]:
    figures: dict[str, ReportFigure] = {}
    if numbers.shares:
        every = [each for each in numbers.shares if each.measure.object is None]
        figures["attribution.png"] = ReportFigure(
            "Shares of the factors", share_figure(every), method_of(every[0]) + OVER
        )
    if numbers.steps is not None:
        added = "The heaviest rain with the first seed, while its factors are added one by one."
        figures["attribution_steps.png"] = ReportFigure("Factors of the rain", numbers.steps, added, is_photograph=True)
    if numbers.drop_sizes:
        pixels = drop_size_figure(numbers.drop_sizes)
        words = "At equal mm/h: larger drops are fewer. Intervals: bootstrap over objects and rain seeds, 95 %."
        figures["drop_sizes.png"] = ReportFigure("Drop sizes", pixels, words)
    return figures


def _page(numbers: DetectionReport, figures: list[ReportFigure]) -> RunReport:
    settings = numbers.settings
    headlines = {
        "objects": str(len({row.object for row in numbers.rows})),
        "views": str(len(settings["frames"])),
        "seeds": str(len(settings["seeds"])),
    }
    for name, each in numbers.robustness.items():
        headlines[f"rPC of {name} (mAP in rain over mAP without)"] = "-" if each.rpc != each.rpc else f"{each.rpc:.2f}"
    return RunReport(
        title=f"Detection in rain: {settings['source']}",
        settings={name: _output_words(value) for name, value in settings.items()},
        figures=tuple(figures),
        notes=tuple(numbers.notes),
        tables=numbers.tables,
        headlines=headlines,
    )


def _output_words(value: Any) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_output_words(each)}" for name, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else value

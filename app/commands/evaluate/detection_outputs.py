"""The files of `gsrain evaluate detection`: tables, figures, the report page, the video."""

import json
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.evaluate.detection.curves import object_figure, pixels, precision_figure
from gsrain_engine.evaluate.detection.sheet import detection_sheet
from gsrain_engine.evaluate.detection.sweep import JudgedPicture, Judgement
from gsrain_engine.evaluate.detection.table import write_csv, write_parquet
from gsrain_engine.evaluate.report.report_file import write_report
from gsrain_engine.evaluate.report.run_report import Figure, ReportTable, RunReport
from gsrain_engine.render.video import VideoWriter
from gsrain_engine.scene.atomic_files import whole_file

from .detection_numbers import DetectionNumbers, told_not_named

_SAMPLES = 4
"""Views that the report shows."""
_BANDS = (
    "A point is the mean over frames and seeds; a band reaches from the lowest to the highest seed. Crosses: the "
    "pictures as they were taken, where the scene is a reconstruction."
)

_Sheet = UInt8[np.ndarray, "h w 3"]


class DetectionVideo:
    """Takes judged pictures as they come: keeps what was judged and some views to show, and writes the video.

    A frame of the video is a view in all its weathers, those of the first seed.
    """

    def __init__(self, file: Path | None, fps: float) -> None:
        """`file` is the video, if one is wanted."""
        self.judgements: list[Judgement] = []
        self.samples: list[tuple[str, _Sheet]] = []
        self.frames = 0
        self._file, self._fps = file, fps
        self._video: VideoWriter | None = None
        self._view: list[JudgedPicture] = []

    def take(self, picture: JudgedPicture) -> None:
        """Take the next picture; those of a view come one after the other."""
        self.judgements += picture.judgements.values()
        if self._view and self._view[0].frame is not picture.frame:
            self._finish_view()
        if picture.trial.seeds[0] == 0:
            self._view.append(picture)

    def __enter__(self) -> "DetectionVideo":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._finish_view()
        if self._video is not None:
            self._video.close()

    def _finish_view(self) -> None:
        view, self._view = self._view, []
        if not view or (self._file is None and len(self.samples) >= _SAMPLES):
            return
        sheet = detection_sheet(view)
        if len(self.samples) < _SAMPLES:
            self.samples.append((view[0].frame.name, sheet))
        if self._file is not None:
            if self._video is None:
                self._size = sheet.shape[:2]
                self._video = VideoWriter(self._file, sheet.shape[1], sheet.shape[0], self._fps)
            if sheet.shape[:2] == self._size:  # cameras of other proportions have no place in one video
                self._video.write(sheet)
                self.frames += 1


def write_outputs(folder: Path, numbers: DetectionNumbers, samples: list[tuple[str, _Sheet]]) -> list[str]:
    """Write tables, figures and the report into a folder; returns the names of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = ["rows.csv", "detection.json"]
    write_csv(folder / "rows.csv", numbers.rows)
    if write_parquet(folder / "rows.parquet", numbers.rows):
        written.append("rows.parquet")
    with whole_file(folder / "detection.json") as beside:
        beside.write_text(json.dumps(numbers.plain, indent=1) + "\n", encoding="utf-8")
    figures = {
        "confidence.png": ("Confidence", pixels(object_figure(numbers.rows, "confidence")), _BANDS),
        "iou.png": ("Overlap of boxes", pixels(object_figure(numbers.rows, "iou")), _BANDS),
        "precision.png": ("Average precision", pixels(precision_figure(numbers.scores)), _BANDS),
    }
    for name, (_, image, _) in figures.items():
        _write_png(folder / name, image)
    for number, (_, sheet) in enumerate(samples):
        _write_png(folder / f"view_{number}.png", sheet)
    shown = [Figure(title, image, caption) for title, image, caption in figures.values()]
    shown += [
        Figure(name, sheet, "Full lines: found. Dashed: labelled, red where it was missed.", is_photograph=True)
        for name, sheet in samples
    ]
    write_report(folder / "report.html", _report(numbers, shown))
    return [*written, *figures, *(f"view_{number}.png" for number in range(len(samples))), "report.html"]


def _report(numbers: DetectionNumbers, figures: list[Figure]) -> RunReport:
    left = {
        f"rPC of {name} (mAP in rain over mAP without)": "-" if each.rpc != each.rpc else f"{each.rpc:.2f}"
        for name, each in numbers.robustness.items()
    }
    objects = {row.object for row in numbers.rows}
    settings = numbers.settings
    return RunReport(
        title=f"Detection in rain: {settings['source']}",
        settings={name: _words(value) for name, value in settings.items()},
        figures=tuple(figures),
        notes=tuple(told_not_named(numbers)),
        tables=(_scores_table(numbers), _distance_table(numbers)),
        headlines={
            "objects": str(len(objects)),
            "views": str(len(settings["frames"])),
            "seeds": str(len(settings["seeds"])),
            **left,
        },
    )


def _scores_table(numbers: DetectionNumbers) -> ReportTable:
    return ReportTable(
        "Scores",
        ("detector", "picture", "mm/h", "objects", "confidence", "lowest seed", "highest seed", "change", "95 % from",
         "95 % to", "IoU", "recall", "flips", "mAP50", "mAP"),
        tuple(
            (
                each.detector, each.picture, f"{each.intensity_mm_h:g}", each.objects,
                each.confidence.mean, each.confidence.low, each.confidence.high,
                *((None, None, None) if each.change is None else (each.change.mean, each.change.low, each.change.high)),
                each.iou.mean, each.recall.mean, each.flips.mean, each.map50.mean, each.map.mean,
            )
            for each in numbers.scores
        ),
        caption="Means over objects and seeds, misses counted as 0. Change: of the confidence from the same views "
        "without rain, paired by seed, with Student's interval over the seeds: it tells how much drops matter, not how "
        "other streets would fare.",
    )  # fmt: skip


def _distance_table(numbers: DetectionNumbers) -> ReportTable:
    return ReportTable(
        "Recall by distance",
        ("detector", "picture", "mm/h", "distance (m)", "objects", "found", "recall", "95 % from", "95 % to"),
        tuple(
            (
                each.detector, each.picture, f"{each.intensity_mm_h:g}",
                f"{each.recall.from_m:g} to {each.recall.to_m:g}", each.recall.objects, each.recall.found,
                each.recall.recall, *each.recall.interval,
            )
            for each in numbers.distances
        ),
        caption="Wilson's interval; frames of one drive and seeds of one view are not independent, it is too narrow.",
    )  # fmt: skip


def _words(value: Any) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(each)}" for name, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else value


def _write_png(file: Path, image: UInt8[np.ndarray, "h w 3"]) -> None:
    with whole_file(file) as beside:
        Image.fromarray(image).save(beside, format="PNG")

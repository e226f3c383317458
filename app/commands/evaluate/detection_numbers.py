"""The numbers of `gsrain evaluate detection`: rows, scores, where they come from; on the screen and as JSON."""

import hashlib
import shlex
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.evaluate.detection.detector import Detector
from gsrain_engine.evaluate.detection.robustness import Robustness
from gsrain_engine.evaluate.detection.summary import (
    FOUND_FROM,
    DistanceScore,
    Spread,
    WeatherScore,
    distance_scores,
    plain,
    robustness_of,
    scores,
)
from gsrain_engine.evaluate.detection.sweep import Judgement, Row, rows_of
from gsrain_engine.evaluate.detection.truth import LEAST_HEIGHT_PX, LEAST_VISIBILITY
from gsrain_engine.untrusted.limits import open_file

from ...console import Console, Table
from .detection_source import PreparedSource
from .run_facts import version_of

_PACKAGES = ("gsrain", "onnxruntime", "numpy", "numba", "opencv-python-headless")


@dataclass(frozen=True, slots=True, eq=False)
class DetectionNumbers:
    """Everything that the command reports."""

    rows: list[Row]
    scores: list[WeatherScore]
    distances: list[DistanceScore]
    robustness: dict[str, Robustness]
    settings: dict[str, Any]
    not_named: dict[str, dict[str, int]]
    """By detector and class, objects in views that it has no word for: neither found nor missed."""

    @property
    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        left = {name: asdict(each) for name, each in self.robustness.items()}
        return {
            "settings": self.settings,
            "robustness": {n: {k: None if v != v else v for k, v in each.items()} for n, each in left.items()},
            "not_named": self.not_named,
            "scores": [plain(each) for each in self.scores],
            "recall_by_distance": [plain(each) for each in self.distances],
            "rows": [row.plain() for row in self.rows],
        }


def detection_numbers(
    judgements: Sequence[Judgement],
    detectors: Sequence[Detector],
    files: Sequence[Path],
    backend: str,
    source: PreparedSource,
    seeds: int,
) -> DetectionNumbers:
    """Work out all numbers. Raises ValueError where no view shows anything that could be found."""
    rows = [row for each in judgements for row in rows_of(each)]
    not_named = _not_named(judgements)
    if not rows and any(not_named.values()):
        words = "; ".join(f"{name} has no word for {_listed(each)}" for name, each in not_named.items() if each)
        raise ValueError(f"{source.name}: nothing there can be named: {words}")
    if not rows:
        raise ValueError(
            f"{source.name}: none of {len(source.frames)} views shows an object of {LEAST_HEIGHT_PX:g} px or more, "
            f"{LEAST_VISIBILITY:.0%} visible; choose others by --frames, --from, --to, --cameras or --width"
        )
    scored = scores(rows, judgements)
    camera = source.frames[0].shot.camera
    settings = {
        "source": source.name,
        "command": shlex.join(["gsrain", *sys.argv[1:]]),
        "detectors": {
            each.name: {"file": file.name, "sha256": _sha256(file)} for each, file in zip(detectors, files, strict=True)
        },
        "inputs": source.inputs,
        "frames": [each.name for each in source.frames],
        "size_px": [camera.width, camera.height],
        "seeds": list(range(seeds)),
        "rain": {
            name: value
            for name, value in msgspec.to_builtins(source.pictures.rain).items()
            if name not in ("intensity_mm_h", "seed")
        },
        "rain_before_pictures": source.pictures.is_in_front,
        "least_iou": 0.5,
        "found_from_confidence": FOUND_FROM,
        "least_height_px": LEAST_HEIGHT_PX,
        "least_visibility": LEAST_VISIBILITY,
        "backend": backend,
        "versions": package_versions(),
    }
    return DetectionNumbers(rows, scored, distance_scores(rows), robustness_of(scored), settings, not_named)


def _not_named(judgements: Sequence[Judgement]) -> dict[str, dict[str, int]]:
    found: dict[str, set[tuple[str, str, str]]] = {each.detector: set() for each in judgements}
    for each in judgements:
        found[each.detector] |= {(each.frame, truth.id, truth.class_name) for truth in each.not_named}
    return {
        name: dict(sorted(Counter(class_name for _, _, class_name in objects).items()))
        for name, objects in found.items()
    }


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())


def told_not_named(numbers: DetectionNumbers) -> list[str]:
    """Return a sentence for each detector that has no word for some of the objects."""
    return [
        f"Not asked of {name}, which has no word for them: {_listed(each)}."
        for name, each in numbers.not_named.items()
        if each
    ]


def package_versions() -> dict[str, str | None]:
    """Versions of what pictures and detections hang on."""
    return {name: version_of(name) for name in _PACKAGES}


def print_scores(scored: Sequence[WeatherScore], console: Console) -> None:
    """Print one line for each detector and weather: means over seeds, and the lowest and highest seed."""
    table = Table("detector", "picture", "mm/h", box=None)
    for title in ("objects", "confidence", "change", f"recall@{FOUND_FROM:g}", "IoU", "flips", "mAP50", "mAP"):
        table.add_column(title, justify="right")
    for each in scored:
        table.add_row(
            each.detector,
            each.picture,
            f"{each.intensity_mm_h:g}",
            str(each.objects),
            _spread(each.confidence),
            "" if each.change is None else _change(each.change.mean, each.change.low, each.change.high),
            f"{each.recall.mean:.0%}",
            f"{each.iou.mean:.2f}",
            f"{each.flips.mean:.0%}",
            f"{each.map50.mean:.3f}",
            f"{each.map.mean:.3f}",
        )
    console.print(table)
    console.print(
        "Means over objects and seeds, misses as 0 (lowest..highest seed); change from without rain, 95 % over seeds."
    )


def _spread(spread: Spread) -> str:
    return f"{spread.mean:.3f} ({spread.low:.3f}..{spread.high:.3f})"


def _change(mean: float, low: float, high: float) -> str:
    return f"{mean:+.3f}" if low != low else f"{mean:+.3f} ({low:+.3f}..{high:+.3f})"


def _sha256(file: Path) -> str:
    with open_file(file) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

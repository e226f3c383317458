"""Summary of detection in rain: scores by rain rate and distance, robustness, and CSV and Parquet tables."""

import csv
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from ...safe_io.files import whole_file
from .ground_truth import is_same_class
from .metrics import DistanceRecall, Robustness, average_precision, recall_by_distance, robustness
from .run import DetectionResult, Kind, ObjectRow

FOUND_FROM = 0.25  # confidence from which an object counts as found in the recalls
DISTANCES_M = (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 100.0)


@dataclass(frozen=True, slots=True)
class SeedSpread:
    """A number over the seeds: its mean, and the lowest and highest seed."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Iterable[float]) -> "SeedSpread":
        array = np.array(list(values), np.float64)
        return cls(float(array.mean()), float(array.min()), float(array.max()))


@dataclass(frozen=True, slots=True)
class SeedChange:
    """Per-seed difference between two conditions: mean and 95 % confidence interval (Student's t)."""

    mean: float
    low: float
    high: float
    """NaN both for a single seed and without rain. The interval covers the variation of drops, not of other streets."""

    @classmethod
    def of(cls, differences: Sequence[float]) -> "SeedChange":
        values, n = np.asarray(differences, np.float64), len(differences)
        if n < 2:
            return cls(float(values.mean()), float("nan"), float("nan"))
        half = float(stdtrit(n - 1, 0.975) * values.std(ddof=1) / np.sqrt(n))
        return cls(float(values.mean()), float(values.mean()) - half, float(values.mean()) + half)


@dataclass(frozen=True, slots=True)
class ScoreByIntensity:
    """Scores of a detector in one condition."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    objects: int
    """Evaluated objects over all frames; the same for each seed."""
    confidence: SeedSpread
    """Mean over objects, 0..1, missed ones as 0."""
    iou: SeedSpread
    """Mean over objects, 0..1, missed ones as 0."""
    recall: SeedSpread
    """Share of objects found with a confidence of 0.25 or more; 0..1."""
    flips: SeedSpread
    """Share of all objects detected as another class with a confidence of 0.25 or more; 0..1."""
    map: SeedSpread
    """COCO average precision (IoU 0.5 to 0.95), 0..1: see `AveragePrecision`."""
    map50: SeedSpread
    change: SeedChange | None
    """Change of the mean confidence relative to the image without rain; None for that one."""


@dataclass(frozen=True, slots=True)
class DistanceScore:
    """Recall of a detector in one condition between two distances, over all seeds."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    recall: DistanceRecall


_Weather = tuple[str, Kind, float]
_WITHOUT_RAIN: dict[Kind, tuple[Kind, ...]] = {"rainy": ("clear", "original"), "clear": ("original",), "original": ()}


def scores(rows: Sequence[ObjectRow], judgements: Sequence[DetectionResult]) -> list[ScoreByIntensity]:
    """Score each detector in each condition, detector by detector, without rain first."""
    pictures: dict[_Weather, dict[int, list[DetectionResult]]] = defaultdict(lambda: defaultdict(list))
    for each in judgements:
        for seed in each.trial.seeds:
            pictures[each.detector, each.trial.kind, each.trial.intensity_mm_h][seed].append(each)
    lines: dict[_Weather, dict[int, list[ObjectRow]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        lines[row.detector, row.picture, row.intensity_mm_h][row.seed].append(row)
    found: list[ScoreByIntensity] = []
    detectors = list(dict.fromkeys(each.detector for each in judgements))
    for weather, by_seed in sorted(pictures.items(), key=lambda each: (detectors.index(each[0][0]), each[0][2])):
        own = lines[weather]
        if not own:
            continue
        precision = [
            average_precision([each.truths for each in images], [each.detections for each in images])
            for images in by_seed.values()
        ]
        bases: list[_Weather] = [(weather[0], each, 0.0) for each in _WITHOUT_RAIN[weather[1]]]
        base = next((each for each in bases if each in pictures), None)  # the condition that differs least
        change = None
        if base is not None:
            changes = [_mean(each, "confidence") - _mean(lines[base][seed], "confidence") for seed, each in own.items()]
            change = SeedChange.of(changes if weather[1] == "rainy" else changes[:1])
        found.append(
            ScoreByIntensity(
                *weather,
                objects=len(next(iter(own.values()))),
                confidence=SeedSpread.of(_mean(each, "confidence") for each in own.values()),
                iou=SeedSpread.of(_mean(each, "iou") for each in own.values()),
                recall=SeedSpread.of(
                    float(np.mean([r.confidence >= FOUND_FROM for r in each])) for each in own.values()
                ),
                flips=SeedSpread.of(float(np.mean([is_misclassified(r) for r in each])) for each in own.values()),
                map=SeedSpread.of(each.map for each in precision),
                map50=SeedSpread.of(each.map50 for each in precision),
                change=change,
            )
        )
    return found


def robustness_of(scored: Sequence[ScoreByIntensity]) -> dict[str, Robustness]:
    """Return mPC and rPC of each detector's mAP over the rain rates; detectors without rainy images are omitted."""
    found: dict[str, Robustness] = {}
    for detector in dict.fromkeys(each.detector for each in scored):
        own = [each for each in scored if each.detector == detector]
        rainy = [each.map.mean for each in own if each.picture == "rainy"]
        clear = [each.map.mean for each in own if each.picture == "clear"]
        clear = clear or [each.map.mean for each in own if each.picture == "original"]
        if rainy and clear:
            found[detector] = robustness(clear[0], rainy)
    return found


def distance_scores(rows: Sequence[ObjectRow]) -> list[DistanceScore]:
    """Recall by distance of each detector in each condition, over all seeds; bins without objects are omitted."""
    by_weather: dict[_Weather, list[ObjectRow]] = defaultdict(list)
    for row in rows:
        if row.distance_m is not None and (row.picture == "rainy" or row.seed == rows[0].seed):
            by_weather[row.detector, row.picture, row.intensity_mm_h].append(row)
    found: list[DistanceScore] = []
    detectors = list(dict.fromkeys(row.detector for row in rows))
    for weather, own in sorted(by_weather.items(), key=lambda each: (detectors.index(each[0][0]), each[0][2])):
        distances, confidences = _array(own, "distance_m"), _array(own, "confidence")
        bins = recall_by_distance(distances, confidences, DISTANCES_M, FOUND_FROM)
        found += [DistanceScore(*weather, each) for each in bins if each.objects]
    return found


def plain(score: ScoreByIntensity | DistanceScore) -> dict[str, Any]:
    """Return a score as plain values for JSON, NaN as None."""
    return {name: _finite(value) for name, value in asdict(score).items()}


def silent_detectors(judgements: Sequence[DetectionResult]) -> list[str]:
    """Detectors that found nothing with a confidence of 0.25 or more in any image without rain, if there are any."""
    found: dict[str, bool] = {}
    for each in judgements:
        if each.trial.kind != "rainy":
            sure = [*(one.confidence for one in each.detections), *(one.confidence_any_class for one in each.matches)]
            found[each.detector] = found.get(each.detector, False) or max(sure, default=0.0) >= FOUND_FROM
    return [name for name, anything in found.items() if not anything]


def is_misclassified(row: ObjectRow) -> bool:
    """Return whether an object was found with another class than its own, such as a car as a truck."""
    is_other = row.class_seen is not None and not is_same_class(row.class_seen, row.class_name)
    return is_other and row.confidence_any_class >= FOUND_FROM


def _mean(rows: Sequence[ObjectRow], name: str) -> float:
    return float(_array(rows, name).mean())


def _array(rows: Sequence[ObjectRow], name: str) -> Float64[np.ndarray, " n"]:
    return np.array([getattr(each, name) for each in rows], np.float64)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    return None if isinstance(value, float) and np.isnan(value) else value


# Result tables


def write_csv(file: Path, rows: Sequence[ObjectRow]) -> None:
    """Write rows as CSV with a header; a miss has a confidence of 0, unknown values are empty."""
    with whole_file(file) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0].plain()) if rows else [])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: round(v, 6) if isinstance(v, float) else v for k, v in row.plain().items()})


def write_parquet(file: Path, rows: Sequence[ObjectRow]) -> bool:
    """Write rows as Parquet; returns False without writing if pyarrow is not installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        return False
    table: Any = pyarrow.Table.from_pylist([row.plain() for row in rows])
    with whole_file(file) as temporary:
        parquet.write_table(table, temporary)
    return True

"""Summary of detection in rain: scores by rain rate and distance, robustness, and CSV and Parquet tables."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from ...report.interval import FEW_OBJECTS, Interval
from ...report.table import Column, Table, columns, table_of
from ...safe_io.files import whole_file
from .ground_truth import is_same_class
from .metrics import AveragePrecision, DistanceRecall, Robustness, average_precision, recall_by_distance, robustness
from .run import DetectionResult, Kind, ObjectRow

FOUND_FROM = 0.25  # confidence from which an object counts as found in the recalls
DISTANCES_M = (0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 100.0)


@dataclass(frozen=True, slots=True)
class ScoreByIntensity:
    """Scores of a detector in one condition."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    objects: int
    """Evaluated objects over all frames; the same for each seed."""
    confidence: Interval
    """Mean over objects, 0..1, missed ones as 0."""
    iou: Interval
    """Mean over objects, 0..1, missed ones as 0."""
    recall: Interval
    """Share of objects found with a confidence of 0.25 or more; 0..1."""
    flips: Interval
    """Share of all objects detected as another class with a confidence of 0.25 or more; 0..1."""
    map: Interval
    """COCO average precision (IoU 0.5 to 0.95), 0..1: see `AveragePrecision`."""
    map50: Interval
    change: Interval | None
    """Change of the mean confidence from the images without rain, by object and seed; None for those."""


@dataclass(frozen=True, slots=True)
class DistanceScore:
    """Recall of a detector in one condition between two distances, over all seeds."""

    detector: str
    picture: Kind
    intensity_mm_h: float
    recall: DistanceRecall


_Weather = tuple[str, Kind, float]
_WITHOUT_RAIN: dict[Kind, tuple[Kind, ...]] = {"rainy": ("clear", "original"), "clear": ("original",), "original": ()}


def scores(
    rows: Sequence[ObjectRow], judgements: Sequence[DetectionResult], scenes: Mapping[str, str] | None = None
) -> list[ScoreByIntensity]:
    """Score each detector in each condition, detector by detector, without rain first.

    `scenes` has the scene of each frame; without it, all are of one.
    """
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
            if all(each.has_boxes for each in images)
            else AveragePrecision(nan, nan)
            for images in by_seed.values()
        ]
        bases: list[_Weather] = [(weather[0], each, 0.0) for each in _WITHOUT_RAIN[weather[1]]]
        base = next((each for each in bases if each in pictures), None)  # the condition that differs least
        change = None
        if base is not None:
            first = next(iter(own))
            seeds = own if weather[1] == "rainy" else {first: own[first]}
            change = confidence_change({seed: (each, lines[base][seed]) for seed, each in seeds.items()}, scenes)
        found.append(
            ScoreByIntensity(
                *weather,
                objects=len(next(iter(own.values()))),
                confidence=_spread(_mean(each, "confidence") for each in own.values()),
                iou=_spread(_mean(each, "iou") for each in own.values()),
                recall=_spread(float(np.mean([r.confidence >= FOUND_FROM for r in each])) for each in own.values()),
                flips=_spread(float(np.mean([is_misclassified(r) for r in each])) for each in own.values()),
                map=_spread(each.map for each in precision),
                map50=_spread(each.map50 for each in precision),
                change=change,
            )
        )
    return found


def robustness_of(scored: Sequence[ScoreByIntensity]) -> dict[str, Robustness]:
    """Return mPC and rPC of each detector's mAP over the rain rates; detectors without rainy images are omitted."""
    found: dict[str, Robustness] = {}
    for detector in dict.fromkeys(each.detector for each in scored):
        own = [each for each in scored if each.detector == detector]
        rainy = [each.map.value for each in own if each.picture == "rainy"]
        clear = [each.map.value for each in own if each.picture == "clear"]
        clear = clear or [each.map.value for each in own if each.picture == "original"]
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
    values = {each.name: getattr(score, each.name) for each in fields(score)}
    return {name: _plain(value) for name, value in values.items()}


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


def _spread(values: Iterable[float]) -> Interval:
    return Interval.spread(list(values), "rain seeds")


def confidence_change(
    by_seed: Mapping[int, tuple[Sequence[ObjectRow], Sequence[ObjectRow]]], scenes: Mapping[str, str] | None = None
) -> Interval:
    """Change of the mean confidence, from each seed's rows in rain and without it; `scenes` as for `scores`."""
    scene_of = scenes or {}
    keys = dict.fromkeys((scene_of.get(row.frame, ""), row.object) for rows, _ in by_seed.values() for row in rows)
    places = {key: place for place, key in enumerate(keys)}
    totals, counts = np.zeros((2, len(places), len(by_seed)))
    for column, (rainy, without) in enumerate(by_seed.values()):
        for row in rainy:
            totals[places[scene_of.get(row.frame, ""), row.object], column] += row.confidence
            counts[places[scene_of.get(row.frame, ""), row.object], column] += 1
        for row in without:
            totals[places[scene_of.get(row.frame, ""), row.object], column] -= row.confidence
    return Interval.over_objects(totals, counts, [scene for scene, _ in places])


def _plain(value: Any) -> Any:
    if isinstance(value, Interval):
        return value.plain
    return asdict(value) if isinstance(value, DistanceRecall) else value


# Result tables


def scores_table(scored: Sequence[ScoreByIntensity]) -> Table:
    """Table of the scores: means over objects and seeds."""
    titled = {
        "detector": "", "picture": "", "mm/h": "g", "objects": "", "confidence": ".3f", "change": "+.3f",
        f"recall@{FOUND_FROM:g}": ".0%", "IoU": ".2f", "wrong class": ".0%", "mAP50": ".3f", "mAP": ".3f",
    }  # fmt: skip
    rows = [
        (
            each.detector, each.picture, each.intensity_mm_h, each.objects, each.confidence, each.change,
            *(mean.value for mean in (each.recall, each.iou, each.flips, each.map50, each.map)),
        )
        for each in scored
    ]  # fmt: skip
    caption = "Means over objects and seeds, misses as 0. Change: of the confidence, from the same views without rain."
    return Table("Scores", columns(titled), rows, caption + few_objects(each.change for each in scored))


def few_objects(changes: Iterable[Interval | None]) -> str:
    """Return a sentence for a caption if changes are of few objects, else nothing."""
    fewest = min((each.n for each in changes if each is not None), default=FEW_OBJECTS)
    if fewest >= FEW_OBJECTS:
        return ""
    return f" Fewer than {FEW_OBJECTS} objects ({fewest}): the intervals of changes say little about others."


def distance_table(distances: Sequence[DistanceScore]) -> Table:
    """Table of the recall by distance."""
    titled = columns({"detector": "", "picture": "", "mm/h": "g", "distance (m)": "", "objects": "", "found": ""})
    rows = [
        (
            each.detector, each.picture, each.intensity_mm_h, f"{each.recall.from_m:g} to {each.recall.to_m:g}",
            each.recall.objects, each.recall.found, each.recall.interval,
        )
        for each in distances
    ]  # fmt: skip
    caption = "Frames of one drive and seeds of one view are not independent: the intervals are too narrow."
    return Table("Recall by distance", (*titled, Column("recall", ".3f")), rows, caption)


def write_csv(file: Path, rows: Sequence[ObjectRow]) -> None:
    """Write rows as CSV with a header; a miss has a confidence of 0, unknown values are empty."""
    plain = [{k: round(v, 6) if isinstance(v, float) else v for k, v in row.plain().items()} for row in rows]
    table_of("", plain[0] if plain else (), plain).write_csv(file)


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

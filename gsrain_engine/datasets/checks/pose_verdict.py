"""What a check of poses found, and how it is judged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

Verdict = Literal["fits", "wrong", "doubtful"]
_Each = TypeVar("_Each")


@dataclass(frozen=True, slots=True)
class PoseCheck:
    """What one check says about the poses of one camera."""

    sensor: str
    by: Literal["matches", "lidar"]
    verdict: Verdict
    """`wrong`: a usual mistake explains it. `doubtful`: these poses don't fit, and no usual mistake does."""
    figure: float
    """Share of matches explained; or standard deviations above turned poses."""
    expected: float
    """The least that a right pose has."""
    told: str
    """The finding as one sentence with its figures."""


def judged(figure: float, expected: float, others: Mapping[str, float], convincing: float) -> tuple[Verdict, str]:
    """Whether poses fit, and the end of the sentence: which of the usual mistakes explains it if they don't.

    `others` are the figures under each mistake; one that reaches `convincing` is believed.
    """
    if figure >= expected:
        return "fits", "."
    best = max(others, key=lambda told: others[told])
    if others[best] >= max(convincing, figure):
        return "wrong", f": {best}."
    return "doubtful", ": the poses or the calibration are wrong, and no usual mistake explains it."


def spread(row: Sequence[_Each], at_most: int) -> list[_Each]:
    """Choose some of a row, evenly."""
    if not row:
        return []
    places = np.linspace(0, len(row) - 1, min(at_most, len(row))).round().astype(np.int64)
    return [row[k] for k in dict.fromkeys(places.tolist())]

"""Which classes of a Parsivel spectrum hold rain: a table of 32 x 32 zeros and ones, as PyDSD's conditional matrix."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool

from gsrain_engine.rain.disdrometer.contents import read_contents
from gsrain_engine.rain.disdrometer.parsivel_classes import CLASSES
from gsrain_engine.rain.disdrometer.reading import DisdrometerFileError


def is_class_mask(lines: list[str]) -> bool:
    """Whether every row has 32 numbers that are 0 or 1."""
    rows = _rows(lines)
    return len(rows) == CLASSES and all(len(row) == CLASSES and set(row) <= {"0", "1"} for row in rows)


def read_class_mask(path: Path) -> Bool[np.ndarray, "diameters velocities"]:
    """Read a table of one row a speed, one column a diameter, into the order of `DropSpectra.counts`.

    Raises `DisdrometerFileError` where it is not 32 x 32 zeros and ones.
    """
    lines = read_contents(path).lines
    if not is_class_mask(lines):
        raise DisdrometerFileError(path, f"a mask of classes is {CLASSES} rows of {CLASSES} zeros and ones")
    return np.array([[value == "1" for value in row] for row in _rows(lines)]).T


def _rows(lines: list[str]) -> list[list[str]]:
    return [
        [value.strip() for value in line.strip().removesuffix(",").split(",")]
        for line in lines[: CLASSES + 2]
        if line.strip()
    ]

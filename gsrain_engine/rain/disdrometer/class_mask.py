"""Which classes of a Parsivel spectrum hold rain: a table of 32 x 32 zeros and ones, as PyDSD's conditional matrix."""

from gsrain_engine.rain.disdrometer.parsivel_classes import CLASSES


def is_class_mask(lines: list[str]) -> bool:
    """Whether every row has 32 numbers that are 0 or 1."""
    rows = _rows(lines)
    return len(rows) == CLASSES and all(len(row) == CLASSES and set(row) <= {"0", "1"} for row in rows)


def _rows(lines: list[str]) -> list[list[str]]:
    return [
        [value.strip() for value in line.strip().removesuffix(",").split(",")]
        for line in lines[: CLASSES + 2]
        if line.strip()
    ]

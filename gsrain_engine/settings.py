"""Base of the settings structs: the constructor checks the bounds that `Meta` declares."""

import math
from functools import cache
from typing import Any

import msgspec

from .fields import Field, field_of, fields_of


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Base of the settings structs.

    msgspec checks bounds in `convert` only; this checks those of numbers, and of numbers in tuples, in the constructor
    and in `msgspec.structs.replace`, too. A `__post_init__` of a subclass calls this one first.
    """

    def __post_init__(self) -> None:
        for name, default, low, high in _bounded(type(self)):
            value = getattr(self, name)
            if value is not default and not _is_within(value, low, high):
                raise ValueError(f"{name} must be {field_of(type(self), name).allowed}, got {value}")


def _is_within(value: Any, low: float, high: float) -> bool:
    """Return whether a number, all of a tuple, or None is within bounds; numbers may be those of other libraries."""
    if isinstance(value, tuple):
        return all(low <= float(each) <= high for each in value)
    return value is None or low <= float(value) <= high


@cache
def _bounded(kind: type[Settings]) -> tuple[tuple[str, Any, float, float], ...]:
    """Return name, default, lowest and highest value of each field that has bounds."""
    bounded = [each for each in fields_of(kind) if each.bounds != (None, None)]
    return tuple((each.name, each.default, _closed(each, 0, -math.inf), _closed(each, 1, math.inf)) for each in bounded)


def _closed(field: Field, end: int, infinity: float) -> float:
    """Return a bound, or the number next to it if it is not allowed itself."""
    bound = field.bounds[end]
    if bound is None:
        return infinity
    return math.nextafter(bound, -infinity) if field.is_open[end] else bound

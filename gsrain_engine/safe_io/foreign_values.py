"""Numbers, paths and arrays of other libraries, such as NumPy's scalars and tensors, as those of Python and NumPy."""

import operator
import os
import reprlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

_CONVERSIONS: tuple[tuple[str, Callable[[Any], Any]], ...] = (
    ("tolist", operator.methodcaller("tolist")),
    ("__index__", operator.index),
    ("__float__", float),
    ("__fspath__", os.fspath),
)
"""Methods that show that a value is an array or a scalar of one, a whole number, a number, or a path."""

_SHORT = reprlib.Repr()
_SHORT.maxother = _SHORT.maxstring = 80


def as_plain(value: Any) -> Any:
    """Return the number, text or list that a value of another library is; a plain value is returned as it is.

    Raises `ValueError` for a value that is none of these.
    """
    if value is None or type(value) in (bool, int, float, str):
        return value
    for method, convert in _CONVERSIONS:
        if hasattr(type(value), method):
            try:
                return convert(value)
            except Exception:  # whatever another library raises: it is no such value
                break
    raise ValueError(f"{type(value).__name__} {short_repr(value)}: expected a number, a text, a path or an array")


def as_plain_values(values: Any) -> Any:
    """Return settings with everything in them converted by `as_plain`; what is no such value stays as it is."""
    if isinstance(values, dict):
        return {name: as_plain_values(each) for name, each in values.items()}
    if isinstance(values, list | tuple):
        return [as_plain_values(each) for each in values]
    try:
        return as_plain(values)
    except ValueError:
        return values  # the conversion to the settings' types names it


def as_array(value: object, dtype: DTypeLike, name: str) -> np.ndarray:
    """Return an array, tensor or nested list as an array of NumPy; one of that type is returned itself.

    Raises `ValueError`, which begins with `name`, for what holds no numbers or rows of unequal length.
    """
    if type(value) is np.ndarray and value.dtype == dtype:
        return value
    try:
        found = np.asarray(value.detach().cpu() if hasattr(type(value), "detach") else value)  # pyright: ignore
        if found.dtype.kind in "biuf":
            return found.astype(dtype, copy=False)
    except Exception:  # whatever another library raises: it is no array
        pass
    raise ValueError(f"{name} {short_repr(value)}: expected an array of numbers")


def short_repr(value: object) -> str:
    """Return the beginning of a value's representation, in one line."""
    try:
        return " ".join(_SHORT.repr(value).split())[:80]
    except Exception:  # of a class of somebody else
        return f"of type {type(value).__name__}"

"""Pickles that any NumPy can read: their streams name `numpy` and nothing inside it.

NumPy 2 pickles its arrays by a name in `numpy._core`, which NumPy 1 has not: a client that runs UniAD's numpy 1.22
could not read a single message.
"""

import io
import pickle
from typing import Any

import numpy as np

_PROTOCOL = 4
"""Python 3.4's: of all that clients run."""


class _OldPickler(pickle.Pickler):
    def reducer_override(self, obj: Any, /) -> Any:
        if isinstance(obj, np.ndarray):
            if obj.dtype.hasobject:
                raise TypeError(f"an array of {obj.dtype} has no bytes to send")
            # A bytearray, not bytes: an array made of it can be written to.
            array: np.ndarray = np.ascontiguousarray(obj)
            return np.ndarray, (obj.shape, array.dtype.str, bytearray(array.data.cast("B") if array.size else b""))
        if isinstance(obj, np.generic):
            scalar = obj.item()
            return type(scalar), (scalar,)
        return NotImplemented


def old_pickle(value: Any) -> memoryview:
    """Pickle plain values, NumPy arrays and NumPy scalars among them; scalars arrive as Python's own.

    Raises TypeError for an array of objects.
    """
    stream = io.BytesIO()
    _OldPickler(stream, _PROTOCOL).dump(value)
    return stream.getbuffer()

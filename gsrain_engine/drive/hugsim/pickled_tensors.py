"""PyTorch tensors on the CPU out of somebody's pickle, without PyTorch: VAD's client answers with one.

Such a pickle holds the tensor's storage as a file of `torch.save` in its old form: five pickles, then how many numbers
there are (64 bits), then they.
"""

import io
import pickletools
from typing import Any

import numpy as np

from .pickled_arrays import checked_shape

_STORAGES = {
    "torch FloatStorage": "<f4", "torch DoubleStorage": "<f8", "torch HalfStorage": "<f2", "torch LongStorage": "<i8",
    "torch IntStorage": "<i4",
}  # fmt: skip
_PICKLES = 5
"""A magic number, the protocol, the machine, the storage's description, its keys."""


class PickledTensor:
    """Stands for `torch.Tensor`: a storage and how to walk through it, looked at when the stream was read."""

    __slots__ = ("_first", "_raw", "_shape", "_steps")

    def __init__(self, raw: Any, first: Any = 0, shape: Any = (), steps: Any = (), *_: Any) -> None:
        """Take what the pickle says; `raw` is the storage's file."""
        self._raw, self._first, self._shape, self._steps = raw, first, shape, steps

    def real(self) -> np.ndarray:
        """Return the tensor as an array; raises ValueError where it does not fit into its storage."""
        values = _storage_values(self._raw)
        shape, steps = checked_shape(self._shape), checked_shape(self._steps)
        if len(shape) != len(steps):
            raise ValueError("it holds a tensor with more axes than steps")
        places = np.full(shape, int(self._first), np.int64)
        for axis, (side, step) in enumerate(zip(shape, steps, strict=True)):
            along = [1] * len(shape)
            along[axis] = side
            places += (step * np.arange(side)).reshape(along)
        if places.size and not 0 <= places.min() <= places.max() < len(values):
            raise ValueError(f"it holds a tensor of shape {shape} in a storage of {len(values)}")
        return values[places]


def _storage_values(raw: Any) -> np.ndarray:
    """Return all numbers of a storage, from its file; nothing in it is run."""
    if not isinstance(raw, bytes | bytearray):
        raise ValueError("it holds a tensor without a storage")
    stream, kinds = io.BytesIO(raw), set[str]()
    for _ in range(_PICKLES):
        for opcode, argument, _place in pickletools.genops(stream):
            if opcode.name == "GLOBAL":
                kinds.add(str(argument))
    if len(kinds) != 1 or not kinds <= set(_STORAGES):
        raise ValueError(f"it holds a tensor of {', '.join(sorted(kinds)) or 'nothing'}, not of numbers"[:120])
    dtype = np.dtype(_STORAGES[kinds.pop()])
    count = int.from_bytes(stream.read(8), "little")
    values = stream.read()
    if count * dtype.itemsize != len(values):
        raise ValueError(f"it holds a storage of {count} numbers in {len(values)} bytes")
    return np.frombuffer(values, dtype)


def _storage(raw: Any) -> Any:
    return raw


def _hooks(*_: Any) -> None:
    """What is to be called when gradients flow: none do."""


TORCH_NAMES = {
    ("torch._utils", "_rebuild_tensor_v2"): PickledTensor,
    ("torch.storage", "_load_from_bytes"): _storage,
    ("collections", "OrderedDict"): _hooks,
}
"""What pickles of tensors call, by module and name."""

"""Reads pickles that hold nothing but NumPy arrays in dictionaries, lists and tuples: no code of theirs can run."""

import pickle
from pathlib import Path
from typing import Any

_MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
_ALLOWED = {("numpy", "ndarray"), ("numpy", "dtype"), *((module, "_reconstruct") for module in _MULTIARRAY)}


class _ArrayUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is not an array")
        return super().find_class(module.replace("numpy.core.", "numpy._core."), name)


def read_array_pickle(path: Path) -> Any:
    """Return the arrays of a pickle in their containers.

    Raises ValueError, with the file's name, for a pickle that holds or calls anything else, or is cut off.
    """
    try:
        with path.open("rb") as file:
            return _ArrayUnpickler(file).load()
    except (pickle.UnpicklingError, EOFError, AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a pickle of arrays: {error}") from error

"""Weights of networks in files: arrays by name, read without running anything that a file holds."""

import hashlib
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.datasets.files.safe_pickle import read_pickle
from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.array_archives import read_archive
from gsrain_engine.untrusted.limits import check_file, open_file
from gsrain_engine.untrusted.printable import printable

SUFFIXES = (".npz", ".safetensors", ".ckpt", ".pth", ".pt")

ARRAY_SUFFIXES = (".safetensors", ".npz")
"""Endings of files that are written."""

Arrays = Mapping[str, np.ndarray]


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a file: .npz, .safetensors, torch's .pth or .pt (weights only), nested pickled arrays (.ckpt).

    Raises FileNotFoundError, and ValueError with the file's name where it can't be read or holds more than arrays.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.suffix == ".npz":
        try:
            return read_archive(path)
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: not a readable .npz: {printable(error)}") from None
    if path.suffix == ".safetensors":
        return _safetensors(path)
    if path.suffix == ".ckpt":
        return dict(_flat(read_pickle(path)))
    return _torch_state(path)


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays as .npz or .safetensors; the same arrays give the same bytes, and the file appears whole.

    Raises ValueError for another ending, and where writing it takes a package that is missing.
    """
    contiguous: dict[str, Any] = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    if path.suffix not in ARRAY_SUFFIXES:
        raise ValueError(f"{path}: expected a name that ends with .safetensors or .npz")
    save = None if path.suffix == ".npz" else _safetensors_module(path).save_file
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        if save is not None:
            save(contiguous, str(beside))
        else:
            with beside.open("wb") as file:  # by a path, NumPy would add an ending of its own
                np.savez(file, **contiguous)


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _safetensors_module(path: Path) -> Any:
    try:
        return import_module("safetensors.numpy")
    except ModuleNotFoundError as error:
        raise ValueError(f"{path}: this takes safetensors: pip install safetensors") from error


def _safetensors(path: Path) -> dict[str, np.ndarray]:
    load: Any = _safetensors_module(path).load_file
    check_file(path)
    try:
        return load(path)
    except Exception as error:  # its error class is not public
        raise ValueError(f"{path}: not a readable .safetensors: {printable(error)}") from None


def _torch_state(path: Path) -> dict[str, np.ndarray]:
    try:
        torch: Any = import_module("torch")
    except ModuleNotFoundError as error:
        raise ValueError(f"{path}: reading it takes torch: pip install 'gsrain[jobs]'") from error
    try:
        with open_file(path) as stream:
            state: Mapping[str, Any] = torch.load(stream, map_location="cpu", weights_only=True)
        return {name: tensor.float().numpy() for name, tensor in state.items()}
    except Exception as error:  # torch fails in many ways; its words are the finding
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{path}: not a readable file of torch weights: {printable(first)}") from None


def _flat(tree: Any, prefix: str = "") -> list[tuple[str, np.ndarray]]:
    """Arrays of nested dictionaries by dotted names, kernels turned from (kh kw in out) to (out in kh kw)."""
    if isinstance(tree, Mapping):
        items: Mapping[str, Any] = tree
        return [pair for name, value in items.items() for pair in _flat(value, f"{prefix}.{name}" if prefix else name)]
    array = np.asarray(tree)
    return [(prefix, array.transpose(3, 2, 0, 1) if array.ndim == 4 else array)]

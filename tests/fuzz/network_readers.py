"""Rows of the table: weights of networks, states of trainings, and detectors."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lpips_weights import read_arrays, write_arrays
from gsrain_engine.recolor.result import read_recolored, write_recolored
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.training.settings import TrainingSettings
from gsrain_engine.training.train import CHECKPOINTS, TrainingHeader
from tests.evaluation.detection.tiny_onnx import NAMES, write_red_finder

from .mutations import damaged_bytes, inside_zip
from .reader import Reader, one_file

_ARRAYS = {"a.weight": np.ones((2, 3, 3, 3), np.float32), "a.bias": np.zeros(2, np.float32), "n": np.array(3)}
_ZIP = inside_zip(lambda _: damaged_bytes)


def _read_arrays(path: Path) -> None:
    for name, array in read_arrays(path).items():
        assert isinstance(name, str) and isinstance(array, np.ndarray) and not array.dtype.hasobject


def _torch_state(path: Path) -> None:
    import torch

    torch.save({name: torch.from_numpy(array) for name, array in _ARRAYS.items()}, path)


def _training_state(path: Path) -> None:
    arrays = {"means": np.ones((4, 3), np.float32), "moments": np.zeros((4, 3), np.float32)}
    header = TrainingHeader(step=7, seconds=1.5, capture="views", settings=TrainingSettings())
    CHECKPOINTS.write(path, header, arrays)


def _detect(path: Path) -> None:
    detector = open_detector(path)
    for found in detector.detect(np.full((48, 64, 3), 100, np.uint8)):
        assert np.isfinite(found.box_xyxy).all() and np.isfinite(found.confidence)


def _row(
    name: str,
    file: str,
    write: Callable[[Path], Any],
    read: Callable[[Path], Any],
    error: type[Exception] = ValueError,
    damage: Any = damaged_bytes,
) -> Reader:
    return Reader(name, one_file(file, write), read, error, (("*", damage),))


_PICKLED = pickle.dumps({"net": {"kernel": np.ones((3, 3, 2, 4), np.float32), "bias": np.zeros(4)}})
_COLORS = {"layers/road": np.ones((3, 4, 3), np.float32)}
_EMPTY_HEADER = TrainingHeader(capture="views", settings=TrainingSettings())

NETWORK_READERS = (
    _row("weights-npz", "a.npz", lambda path: write_arrays(path, _ARRAYS), _read_arrays, damage=_ZIP),
    _row("weights-safetensors", "a.safetensors", lambda path: write_arrays(path, _ARRAYS), _read_arrays),
    _row("weights-pickled", "a.ckpt", lambda path: path.write_bytes(_PICKLED), _read_arrays),
    _row("weights-torch", "a.pth", _torch_state, _read_arrays, damage=_ZIP),
    _row("recolored", "colors.npz", lambda path: write_recolored(path, _COLORS), read_recolored, SceneFormatError,
         _ZIP),
    _row("training-state", "state.npz", _training_state, lambda path: CHECKPOINTS.resume(path, _EMPTY_HEADER, dict),
         damage=_ZIP),
    _row("detector", "detector.onnx", lambda path: write_red_finder(path, NAMES), _detect),
)  # fmt: skip
"""Networks, and what looks at them."""

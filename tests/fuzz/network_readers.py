"""Rows of the table: weights of networks, states of trainings, and detectors."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.lpips_weights import read_arrays, write_arrays
from gsrain_engine.recolor.result import read_recolored, write_recolored
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.training.settings import TrainingSettings
from gsrain_engine.training.train import CHECKPOINTS, TrainingHeader
from tests.evaluation.detection.tiny_onnx import NAMES, write_red_finder

from .containers import inside_zip
from .mutations import damaged_bytes
from .reader import Reader

_ARRAYS = {"a.weight": np.ones((2, 3, 3, 3), np.float32), "a.bias": np.zeros(2, np.float32), "n": np.array(3)}
_ZIP = inside_zip(lambda _: damaged_bytes)


def _read_arrays(path: Path) -> None:
    for name, array in read_arrays(path).items():
        assert isinstance(name, str) and isinstance(array, np.ndarray) and not array.dtype.hasobject


def _arrays(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        write_arrays(folder / name, _ARRAYS)
        return folder / name

    return write


def _pickled(folder: Path) -> Path:
    (folder / "a.ckpt").write_bytes(
        pickle.dumps({"net": {"kernel": np.ones((3, 3, 2, 4), np.float32), "bias": np.zeros(4)}})
    )
    return folder / "a.ckpt"


def _torch_state(folder: Path) -> Path:
    import torch

    torch.save({name: torch.from_numpy(array) for name, array in _ARRAYS.items()}, folder / "a.pth")
    return folder / "a.pth"


def _recolored(folder: Path) -> Path:
    write_recolored(folder / "colors.npz", {"layers/road": np.ones((3, 4, 3), np.float32)})
    return folder / "colors.npz"


def _training_state(folder: Path) -> Path:
    header = TrainingHeader(step=7, seconds=1.5, capture="views", settings=TrainingSettings())
    arrays = {"means": np.ones((4, 3), np.float32), "moments": np.zeros((4, 3), np.float32)}
    CHECKPOINTS.write(folder / "state.npz", header, arrays)
    return folder / "state.npz"


def _detector(folder: Path) -> Path:
    return write_red_finder(folder / "detector.onnx", NAMES)


def _detect(path: Path) -> None:
    detector = open_detector(path)
    for found in detector.detect(np.full((48, 64, 3), 100, np.uint8)):
        assert np.isfinite(found.box_xyxy).all() and np.isfinite(found.confidence)


def _row(
    name: str,
    write: Callable[[Path], Path],
    read: Callable[[Path], Any],
    error: type[Exception] = ValueError,
    damage: Any = damaged_bytes,
) -> Reader:
    return Reader(name, write, read, error, (("*", damage),))


NETWORK_READERS = (
    _row("weights-npz", _arrays("a.npz"), _read_arrays, damage=_ZIP),
    _row("weights-safetensors", _arrays("a.safetensors"), _read_arrays),
    _row("weights-pickled", _pickled, _read_arrays),
    _row("weights-torch", _torch_state, _read_arrays, damage=_ZIP),
    _row("recolored", _recolored, read_recolored, SceneFormatError, _ZIP),
    _row(
        "training-state",
        _training_state,
        lambda path: CHECKPOINTS.resume(path, TrainingHeader(capture="views", settings=TrainingSettings()), dict),
        damage=_ZIP,
    ),
    _row("detector", _detector, _detect),
)
"""Networks, and what looks at them."""

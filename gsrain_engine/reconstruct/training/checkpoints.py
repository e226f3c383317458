"""How far a training has come, on disk: a NumPy archive without pickles that appears whole or not at all."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Shaped

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.array_archives import read_archive
from gsrain_engine.untrusted.printable import printable

from .settings import TrainingSettings

_VERSION = 1
_FREE = frozenset({"measured_every", "saved_every"})
"""Settings that may change when a training is taken up again: nothing that is learned depends on them."""


class CheckpointError(ValueError):
    """A training can't be taken up from a checkpoint; the message names the file and says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """Everything that a training goes on from."""

    step: int
    """How many steps are done."""
    seconds: float
    """How long they took."""
    arrays: Mapping[str, Shaped[np.ndarray, "..."]]


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    version: int
    step: int
    seconds: float
    capture: str
    settings: TrainingSettings


def write_checkpoint(file: Path, checkpoint: Checkpoint, settings: TrainingSettings, capture: str) -> None:
    """Write a checkpoint; `capture` is a text that tells captures and their views apart."""
    head = _Head(version=_VERSION, step=checkpoint.step, seconds=checkpoint.seconds, capture=capture, settings=settings)
    named = {"head": np.frombuffer(msgspec.json.encode(head), np.uint8), **checkpoint.arrays}
    with whole_file(file) as beside, beside.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **named)


def read_checkpoint(file: Path, settings: TrainingSettings, capture: str) -> Checkpoint:
    """Read a checkpoint of the same training. Raises `CheckpointError` where it is damaged or of another one."""
    if not file.is_file():
        raise CheckpointError(f"{file}: there is no checkpoint to resume from; leave --resume out to begin anew")
    try:
        arrays = read_archive(file)
        head = msgspec.json.decode(arrays.pop("head").tobytes(), type=_Head)
    except (OSError, ValueError, KeyError, RecursionError, msgspec.MsgspecError) as error:
        raise CheckpointError(f"{file}: not a checkpoint, or a damaged one: {printable(error)}") from None
    if head.version != _VERSION:
        raise CheckpointError(f"{file}: a checkpoint of version {head.version}, expected {_VERSION}")
    if head.capture != capture:
        raise CheckpointError(f"{file}: made from other views ({printable(head.capture)}), now they are {capture}")
    for name in settings.__struct_fields__:
        before, now = getattr(head.settings, name), getattr(settings, name)
        if before != now and name not in _FREE:
            raise CheckpointError(f"{file}: made with {name} {before}, now it is {now}")
    return Checkpoint(head.step, head.seconds, arrays)

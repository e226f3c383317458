"""Checkpoints of a fine-tuning, as safetensors files written atomically."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from ...safe_io.limits import check_file
from ...safe_io.text_files import printable_line
from ...scene.files import whole_file
from .settings import FinetuningSettings

safetensors: Any = import_module("safetensors")
safetensors_torch: Any = import_module("safetensors.torch")
_VERSION = 1
_HEAD = "gsrain"

_FREE = frozenset(
    {"steps", "samples", "sampled_every", "saved_every", "warned_after", "gradient_checkpointing", "device", "base",
     "clip", "lpips", "start"}
)  # fmt: skip
"""Settings that may change on resume: paths, and values that don't affect what is learned."""


class FinetuningCheckpointError(ValueError):
    """Error for a checkpoint that can't be resumed; the message names the file and the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class FinetuneCheckpoint:
    """Complete training state. Random numbers and the order of images follow from `step`."""

    step: int
    seconds: float
    tensors: Mapping[str, Any]
    perceptual: bool
    """True if LPIPS is one of the losses."""


class _FinetuneHeader(msgspec.Struct, frozen=True):
    version: int
    step: int
    seconds: float
    perceptual: bool
    pictures: str
    settings: FinetuningSettings


def write_finetune_checkpoint(
    file: Path, checkpoint: FinetuneCheckpoint, settings: FinetuningSettings, pictures: str
) -> None:
    """Write a checkpoint; the text `pictures` identifies the image set."""
    state = (checkpoint.step, checkpoint.seconds, checkpoint.perceptual)
    head = msgspec.json.encode(_FinetuneHeader(_VERSION, *state, pictures, settings)).decode()
    with whole_file(file) as temporary:
        safetensors_torch.save_file(dict(checkpoint.tensors), str(temporary), metadata={_HEAD: head})


def read_finetune_checkpoint(
    file: Path, settings: FinetuningSettings, pictures: str, perceptual: bool
) -> FinetuneCheckpoint:
    """Read a checkpoint of this training. Raises `FinetuningCheckpointError` if it is damaged or of another one."""
    if not file.is_file():
        raise FinetuningCheckpointError(f"{file}: there is no checkpoint to resume from; begin anew without --resume")
    try:
        check_file(file)
        with safetensors.safe_open(str(file), "pt") as opened:
            head = msgspec.json.decode((opened.metadata() or {})[_HEAD], type=_FinetuneHeader)
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (no mapping)
    except (
        AttributeError, KeyError, OSError, RecursionError, RuntimeError, TypeError, ValueError,
        msgspec.MsgspecError, safetensors.SafetensorError,
    ) as error:  # fmt: skip
        raise FinetuningCheckpointError(
            f"{file}: not a checkpoint of a training, or damaged: {printable_line(error)}"
        ) from None
    if head.version != _VERSION:
        raise FinetuningCheckpointError(f"{file}: a checkpoint of version {head.version}, expected {_VERSION}")
    if head.pictures != pictures:
        raise FinetuningCheckpointError(
            f"{file}: made from other pictures ({printable_line(head.pictures)}), now they are {pictures}"
        )
    if head.perceptual != perceptual:
        change = "without LPIPS, whose weights are there now" if perceptual else "with LPIPS, whose weights are missing"
        raise FinetuningCheckpointError(f"{file}: trained so far {change}; give it the same again")
    for name in settings.__struct_fields__:
        before, now = getattr(head.settings, name), getattr(settings, name)
        if before != now and name not in _FREE:
            raise FinetuningCheckpointError(f"{file}: made with {name} {before}, now it is {now}")
    return FinetuneCheckpoint(head.step, head.seconds, tensors, head.perceptual)

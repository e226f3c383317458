"""Names of scenes and settings of trainings in the files near a checkpoint."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

from gsrain_engine.safe_io.limits import read_file

_MAX_SETTINGS_BYTES = 1 << 22
_NUMBERED = re.compile(r"(?:checkpoint|chkpnt|ckpt|step|iteration|model|last|epoch)(?:[-_=]|final|last|best|rank|\d)*")
_PARTS = ("nerfstudio_models", "ckpts", "checkpoints", "trained_model")


def scene_name(path: Path) -> str:
    """Name of a checkpoint's file, or that of its training's folder if the file only has a number."""
    if not _NUMBERED.fullmatch(path.stem):
        return path.stem
    folder = path.resolve().parent
    return (folder.parent if folder.name in _PARTS else folder).name or path.stem


def settings_text(path: Path) -> str:
    """Text of a settings file next to a checkpoint or above it; empty without one that can be read."""
    try:
        return read_file(path, _MAX_SETTINGS_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""


def has_tensors(state: Any, *names: str) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a value of a checkpoint is a mapping that has all names."""
    return isinstance(state, Mapping) and all(name in state for name in names)

"""Tells files from pipes and devices, which data sets may name, and whose readers would wait or read for ever."""

from pathlib import Path

from ..capture import CaptureError


def check_regular(file: Path) -> None:
    """Raise `CaptureError` where something else than a file stands; where nothing does, reading it says so."""
    try:
        is_other = "\0" in str(file) or (file.exists() and not file.is_file())
    except (OSError, ValueError):
        raise CaptureError(f"{file}: not a name that a file can have") from None
    if is_other:
        raise CaptureError(f"{file}: not a file")

"""How much a small file may become in memory: bombs are known by it before they are unpacked."""

from pathlib import Path

from ..capture import CaptureError

_ALWAYS_ALLOWED_BYTES = 64 << 20
"""What a file of any size may become: pictures of one colour compress without a bound."""
_LARGEST_EXPANSION = 2000
"""Deflate (PNG, .npz) can't reach 1033; a JPEG of one colour reaches 1024."""


def check_expansion(file: Path | str, wanted_bytes: int, file_bytes: int) -> None:
    """Raise `CaptureError` where a file says that it holds more than its size can be."""
    if wanted_bytes > max(_ALWAYS_ALLOWED_BYTES, _LARGEST_EXPANSION * file_bytes):
        raise CaptureError(
            f"{file}: says that it holds {wanted_bytes / 1e6:.0f} MB, which can't be in {file_bytes} bytes"
        )

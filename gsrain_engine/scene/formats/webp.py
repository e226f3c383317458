"""Lossless WebP images that carry numbers; their size is known, and judged, before anything is decoded."""

import io
import struct
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..errors import SceneFormatError

_CHUNK = struct.Struct("<4sI")
_RIFF_HEADER_BYTES = 12
_LOSSLESS_SIGNATURE = 0x2F
_ANIMATION_FLAG = 0x02


def lossless_webp_size(path: Path, name: str, data: bytes) -> tuple[int, int]:
    """Width and height in pixels; `name` is the image's file, `path` the scene's.

    Layout: WebP container and lossless bitstream specifications (RFC 9649, sections 2 and 3.4).
    Raises `SceneFormatError` where it is no WebP, or a lossy or moving one.
    """
    if data[:4] != b"RIFF" or data[8:_RIFF_HEADER_BYTES] != b"WEBP":
        raise SceneFormatError(path, f"{name} is not a WebP image")
    offset = _RIFF_HEADER_BYTES
    canvas: tuple[int, int] | None = None
    while offset + _CHUNK.size <= len(data):
        kind, size = _CHUNK.unpack_from(data, offset)
        body = data[offset + _CHUNK.size : offset + _CHUNK.size + min(size, 10)]
        if kind == b"VP8L" and len(body) >= 5 and body[0] == _LOSSLESS_SIGNATURE:
            bits = int.from_bytes(body[1:5], "little")
            image = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
            if canvas not in (None, image):
                raise SceneFormatError(path, f"{name} is damaged: its header says {canvas} pixels, its image {image}")
            return image
        if kind == b"VP8X" and len(body) == 10 and not body[0] & _ANIMATION_FLAG:
            canvas = int.from_bytes(body[4:7], "little") + 1, int.from_bytes(body[7:10], "little") + 1
        elif canvas is None or kind in (b"VP8X", b"VP8 ", b"VP8L", b"ANIM", b"ANMF"):
            break
        offset += _CHUNK.size + size + size % 2
    raise SceneFormatError(path, f"{name} must be a single lossless WebP image (a VP8L chunk), which it is not")


def read_lossless_webp(path: Path, name: str, data: bytes) -> UInt8[np.ndarray, "pixels 4"]:
    """Red, green, blue and alpha of every pixel, row by row. Judge the size with `lossless_webp_size` first."""
    width, height = lossless_webp_size(path, name, data)
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as image:
            pixels = np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError, Image.DecompressionBombError):
        raise SceneFormatError(path, f"{name} is damaged") from None
    if pixels.shape != (height, width, 4):
        raise SceneFormatError(path, f"{name} is damaged: {width} x {height} pixels expected, {pixels.shape[:2]} found")
    return pixels.reshape(-1, 4)

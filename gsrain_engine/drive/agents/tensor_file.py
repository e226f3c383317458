"""Pictures as PyTorch keeps tensors in files, written without PyTorch: what NeuroNCAP's model nodes read.

A zip archive, nothing in it compressed: a pickle that says how to rebuild the tensor, and its bytes ("zip-based" format
of `torch.save`, since PyTorch 1.6).
"""

import io
import struct
import zipfile

import numpy as np
from jaxtyping import UInt8


def tensor_file(image: UInt8[np.ndarray, "h w c"]) -> bytes:
    """Return what `torch.load` reads as a tensor (H, W, C) of bytes; the same picture gives the same bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in (
            ("data.pkl", _rebuilding(image.shape)),
            ("data/0", np.ascontiguousarray(image).tobytes()),
            ("version", b"3\n"),
        ):
            archive.writestr(zipfile.ZipInfo(f"archive/{name}"), data)
    return stream.getvalue()


def _rebuilding(shape: tuple[int, ...]) -> bytes:
    """Pickle, by hand, the call that makes a contiguous tensor on the CPU from storage 0."""
    height, width, channels = shape
    count = height * width * channels
    storage = b"(" + _text("storage") + b"ctorch\nByteStorage\n" + _text("0") + _text("cpu") + _number(count) + b"t"
    return b"".join((
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(", storage, b"Q", _number(0),
        b"(" + _number(height) + _number(width) + _number(channels) + b"t",
        b"(" + _number(width * channels) + _number(channels) + _number(1) + b"t",
        b"\x89", b"ccollections\nOrderedDict\n)R", b"tR.",
    ))  # fmt: skip


def _text(text: str) -> bytes:
    return b"X" + struct.pack("<I", len(text)) + text.encode("ascii")


def _number(number: int) -> bytes:
    return b"J" + struct.pack("<i", number)

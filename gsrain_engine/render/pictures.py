"""Pictures out: PNG stills and float arrays, each written beside its target and then renamed over it."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image


def write_picture(path: Path, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an 8-bit picture as PNG."""
    _write_beside(path, lambda beside: Image.fromarray(pixels).save(beside, format="PNG"))


def write_depth(path: Path, depth_m: Float32[np.ndarray, "h w"]) -> None:
    """Write depth as 16-bit PNG in centimetres; beyond 655.35 m it saturates, 0 is nothing."""
    centimetres = np.rint(np.clip(depth_m * 100, 0, 65535)).astype(np.uint16)
    _write_beside(path, lambda beside: Image.fromarray(centimetres).save(beside, format="PNG"))


def write_array(path: Path, values: Float32[np.ndarray, "..."]) -> None:
    """Write an array as NPY."""

    def save(beside: Path) -> None:
        with beside.open("wb") as file:
            np.save(file, values, allow_pickle=False)

    _write_beside(path, save)


def _write_beside(path: Path, write: Callable[[Path], None]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)

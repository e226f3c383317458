"""Pictures out: PNG stills and float arrays, whole or not at all."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, Num, UInt8
from PIL import Image

from gsrain_engine.scene.atomic_files import whole_file


def write_picture(path: Path, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an 8-bit picture as PNG."""
    _write_png(path, pixels)


def write_depth(path: Path, depth_m: Float32[np.ndarray, "h w"]) -> None:
    """Write depth as 16-bit PNG in centimetres; beyond 655.35 m it saturates, 0 is nothing."""
    _write_png(path, np.rint(np.clip(depth_m * 100, 0, 65535)).astype(np.uint16))


def write_array(path: Path, values: Float32[np.ndarray, "..."]) -> None:
    """Write an array as NPY."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside, beside.open("wb") as file:
        np.save(file, values, allow_pickle=False)


def _write_png(path: Path, pixels: Num[np.ndarray, "h w *c"]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        Image.fromarray(pixels).save(beside, format="PNG")

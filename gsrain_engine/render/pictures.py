"""Pictures out: PNG stills and float arrays, whole or not at all."""

import json
import struct
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8, UInt16
from PIL import Image, ImageCms

from gsrain_engine.scene.atomic_files import whole_file

from .heat_colors import layer_color

_PALETTE_COLORS = 255
"""Labels that fit into an indexed picture of 8 bits, besides 0."""


def write_picture(path: Path | str, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an 8-bit picture as PNG; missing folders are made."""
    _write_png(Path(path), Image.fromarray(pixels))


def write_jpeg(path: Path, pixels: UInt8[np.ndarray, "h w 3"], quality: int) -> None:
    """Write an 8-bit picture as JPEG of a quality 1..100, its chroma whole, with the profile of sRGB inside.

    The same pixels give the same bytes. Missing folders are made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        Image.fromarray(pixels).save(
            beside, format="JPEG", quality=quality, subsampling=0, optimize=True, icc_profile=_srgb_profile()
        )


@cache
def _srgb_profile() -> bytes:
    """Return the ICC profile of sRGB, with a date that is always the same (bytes 24 to 35 of its header)."""
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile[24:36] = struct.pack(">6H", 2000, 1, 1, 0, 0, 0)
    return bytes(profile)


def write_sheet(path: Path, image: Image.Image) -> None:
    """Write a picture for people in the format that its name says; PNG where that says none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        image.save(beside, format=Image.registered_extensions().get(path.suffix.lower(), "PNG"))


def write_depth(path: Path, depth_m: Float32[np.ndarray, "h w"]) -> None:
    """Write depth as 16-bit PNG in centimetres; beyond 655.35 m it saturates, 0 is nothing."""
    _write_png(path, Image.fromarray(np.rint(np.clip(depth_m * 100, 0, 65535)).astype(np.uint16)))


def write_alpha(path: Path, alpha: Float32[np.ndarray, "h w"]) -> None:
    """Write alpha as 8-bit grey PNG; 255 is solid."""
    _write_png(path, Image.fromarray(np.rint(np.clip(alpha, 0, 1) * 255).astype(np.uint8)))


def write_labels(path: Path, labels: UInt16[np.ndarray, "h w"], count: int) -> None:
    """Write labels 0..count as PNG: indexed, each in a colour of its own; more than 255 as 16-bit grey."""
    if count > _PALETTE_COLORS:
        _write_png(path, Image.fromarray(labels))
        return
    image = Image.fromarray(labels.astype(np.uint8))
    colors = [(0.0, 0.0, 0.0), *(layer_color(number) for number in range(count))]
    image.putpalette([round(255 * channel) for color in colors for channel in color])
    _write_png(path, image)


def write_legend(path: Path, legend: Mapping[str, Any]) -> None:
    """Write what labels mean as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        beside.write_text(json.dumps(legend, indent=1) + "\n", encoding="utf-8")


def write_array(path: Path, values: Float32[np.ndarray, "..."]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside, beside.open("wb") as file:
        np.save(file, values, allow_pickle=False)


def _write_png(path: Path, image: Image.Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        image.save(beside, format="PNG")

"""Rendered images: as 8-bit colors, as linear light, with depth, as a file, and as a notebook shows them."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
from jaxtyping import Float32, UInt8

from gsrain_engine.render.images import write_still
from gsrain_engine.render.renderer import Frame
from gsrain_engine.scene.geometry import srgb_to_linear


class Image:
    """A rendered image over black; the last line of a notebook's cell shows it. `np.asarray(image)` is `rgb`."""

    def __init__(self, frame: Frame) -> None:
        """Take a frame of a renderer."""
        self.frame = frame
        """Premultiplied display colors with alpha, (H, W, 4) float32, nothing clamped."""

    @property
    def width(self) -> int:
        """Width in pixels."""
        return self.frame.rgba.shape[1]

    @property
    def height(self) -> int:
        """Height in pixels."""
        return self.frame.rgba.shape[0]

    @property
    def rgb(self) -> UInt8[np.ndarray, "h w 3"]:
        """Display colors (sRGB), 0..255, top row first."""
        return self.frame.to_uint8()

    @property
    def linear(self) -> Float32[np.ndarray, "h w 3"]:
        """Linear light with sRGB primaries; 1 is white, highlights can exceed it."""
        return srgb_to_linear(self.frame.over()).astype(np.float32)

    @property
    def alpha(self) -> Float32[np.ndarray, "h w"]:
        """Share of each pixel that scene and rain cover, 0..1."""
        return self.frame.rgba[..., 3]

    @property
    def depth(self) -> Float32[np.ndarray, "h w"]:
        """Depth of the scene along the view axis in meters, without rain; 0 where there is nothing.

        Raises `ValueError` for an image that was rendered without depth.
        """
        if self.frame.depth is None:
            raise ValueError("this image was rendered without depth: pass depth=True")
        return self.frame.depth

    def save(self, path: Path | str) -> None:
        """Save as .png, .jpg, .exr (linear light, with depth) or .npy (premultiplied floats), by the ending.

        Missing folders are made. Raises `ValueError` for another ending, `OSError` where it can't be written.
        """
        write_still(path, self.frame)

    def to_pil(self) -> PIL.Image.Image:
        """Return the 8-bit colors as an image of Pillow."""
        return PIL.Image.fromarray(self.rgb)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.rgb, dtype)

    def __repr__(self) -> str:
        return f"<gsrain.Image {self.width} x {self.height}{'' if self.frame.depth is None else ', with depth'}>"

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.to_pil().save(file, format="PNG")
        return file.getvalue()

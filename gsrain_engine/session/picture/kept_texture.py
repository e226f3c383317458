"""A picture that stays on the GPU until another one takes its place. Lives in the window's OpenGL context."""

import moderngl
import numpy as np
from jaxtyping import UInt8

from ..view.texture import Texture

Pixels = UInt8[np.ndarray, "h w c"]
"""Display colour, with or without alpha; first row on top."""


class KeptTexture:
    """One texture, written only when the picture is another one."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pixels: Pixels | None = None
        self._texture: moderngl.Texture | None = None

    def show(self, pixels: Pixels | None) -> Texture | None:
        """Bring a picture to the GPU; None frees what is there."""
        if pixels is not self._pixels:
            self._pixels = pixels
            self._bring(pixels)
        return self.texture

    @property
    def texture(self) -> Texture | None:
        kept = self._texture
        return None if kept is None else Texture(kept.glo, kept.width, kept.height)

    def _bring(self, pixels: Pixels | None) -> None:
        old = self._texture
        if old is not None and (pixels is None or (old.height, old.width, old.components) != pixels.shape):
            old.release()
            self._texture = None
        if pixels is None:
            return
        if self._texture is None:
            height, width, channels = pixels.shape
            self._texture = self._context.texture((width, height), channels, alignment=1)
        self._texture.write(np.ascontiguousarray(pixels), alignment=1)

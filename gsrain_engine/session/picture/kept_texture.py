"""A picture that stays on the GPU until another one takes its place. Lives in the window's OpenGL context."""

import moderngl
import numpy as np
from jaxtyping import UInt8

from ..jobs.background_job import JobPreview


class KeptTexture:
    """One texture, written only when the picture is another one."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pixels: UInt8[np.ndarray, "h w 3"] | None = None
        self._texture: moderngl.Texture | None = None

    def show(self, pixels: UInt8[np.ndarray, "h w 3"] | None) -> JobPreview | None:
        """Bring a picture (display colour, first row on top) to the GPU; None frees what is there."""
        if pixels is not self._pixels:
            self._pixels = pixels
            size = None if pixels is None else (pixels.shape[1], pixels.shape[0])
            if self._texture is not None and self._texture.size != size:
                self._texture.release()
                self._texture = None
            if pixels is not None and self._texture is None:
                self._texture = self._context.texture(
                    (pixels.shape[1], pixels.shape[0]), 3, np.ascontiguousarray(pixels), alignment=1
                )
            elif pixels is not None and self._texture is not None:
                self._texture.write(np.ascontiguousarray(pixels), alignment=1)
        if self._texture is None:
            return None
        return JobPreview(self._texture.glo, self._texture.width, self._texture.height)

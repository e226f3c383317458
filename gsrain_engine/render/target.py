"""Textures that splats are drawn into."""

from dataclasses import dataclass
from typing import NamedTuple

import moderngl

from .gpu_memory import check_gpu_memory


class TargetLayout(NamedTuple):
    """What a target holds; the fragment shader's locations 0, 1, 2."""

    size: tuple[int, int]
    dtype: str
    shares: bool = False
    depth: bool = False


@dataclass(slots=True)
class Target:
    """A framebuffer and its textures."""

    layout: TargetLayout
    color: moderngl.Texture
    shares: moderngl.Texture | None
    depth: moderngl.Texture | None
    framebuffer: moderngl.Framebuffer

    @classmethod
    def make(cls, context: moderngl.Context, layout: TargetLayout) -> "Target":
        """Make the textures of a layout; raises `MemoryError` where the graphics card has no room for them."""
        color = context.texture(layout.size, 4, dtype=layout.dtype)
        color.filter = moderngl.NEAREST, moderngl.NEAREST
        # Without rain the second attachment only keeps the third one's place.
        with_shares = layout.shares or layout.depth
        shares = context.texture(layout.size, 2, dtype=layout.dtype) if with_shares else None
        depth = context.texture(layout.size, 2, dtype="f4") if layout.depth else None
        check_gpu_memory(context, 16 * layout.size[0] * layout.size[1])
        attachments = [each for each in (color, shares, depth) if each is not None]
        return cls(layout, color, shares, depth, context.framebuffer(attachments))

    def release(self) -> None:
        self.framebuffer.release()
        for texture in (self.color, self.shares, self.depth):
            if texture is not None:
                texture.release()

"""Brings a picture to a screen: background, display gain, 8 bits."""

import moderngl

from .frame import Color
from .shaders import load_program


class Screen:
    """An 8-bit texture of the size of the last picture."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = load_program(context, "screen.vert", "tonemap.frag")
        self._vertices = context.vertex_array(self._program, [])
        self._texture: moderngl.Texture | None = None
        self._framebuffer: moderngl.Framebuffer | None = None

    def show(
        self, picture: moderngl.Texture, background: Color = (0.0, 0.0, 0.0), gain: float = 1.0
    ) -> moderngl.Texture:
        """Tone-map a premultiplied picture; `gain` multiplies linear light."""
        if self._texture is None or self._texture.size != picture.size:
            if self._texture is not None and self._framebuffer is not None:
                self._framebuffer.release()
                self._texture.release()
            self._texture = self._context.texture(picture.size, 4)
            self._framebuffer = self._context.framebuffer([self._texture])
        assert self._framebuffer is not None
        picture.use(0)
        self._program["picture"] = 0
        self._program["background"] = background
        self._program["gain"] = gain
        before = self._context.detect_framebuffer()
        self._framebuffer.use()
        self._vertices.render(moderngl.TRIANGLES, vertices=3)
        before.use()
        return self._texture

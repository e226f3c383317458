"""Draws without a window, in an OpenGL context of its own."""

from collections.abc import Sequence

from gsrain_engine.rain.falling_rain import FallingRain
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .frame import Frame
from .look import Look
from .splat_renderer import SplatRenderer


class OffscreenRenderer(SplatRenderer):
    """A `SplatRenderer` that draws in its context whichever is current, so that several can take turns on a thread."""

    def draw(
        self,
        parts: Sequence[Part],
        camera: Camera,
        rain: FallingRain | None = None,
        *,
        with_depth: bool = False,
        look: Look = "splats",
    ) -> None:
        with self.context:
            super().draw(parts, camera, rain, with_depth=with_depth, look=look)

    def read(self) -> Frame:
        with self.context:
            return super().read()

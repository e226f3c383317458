"""What every back end does: draw scene and rain, hand out the picture."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from gsrain_engine.rain.falling_rain import FallingRain
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .frame import Frame
from .look import Look
from .statistics import RenderStatistics


@runtime_checkable
class Renderer(Protocol):
    """Draws one picture at a time. `SplatRenderer` does it with OpenGL, `CpuRenderer` without."""

    @property
    def name(self) -> str:
        """What this back end is called on the command line."""
        ...

    @property
    def statistics(self) -> RenderStatistics:
        """What the last picture was made of."""
        ...

    def draw(
        self,
        parts: Sequence[Part],
        camera: Camera,
        rain: FallingRain | None = None,
        *,
        with_depth: bool = False,
        look: Look = "splats",
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; `read` hands out the picture.

        `camera` is in the world (metres). Depth is the scene's own: rain takes no part in it. `look` shows something
        else than the picture, without rain.
        """
        ...

    def read(self) -> Frame:
        """Hand out the last picture, with depth if it was drawn."""
        ...

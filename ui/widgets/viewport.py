"""Where the picture is on the screen, and the way between its pixels and the world."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, imgui
from jaxtyping import Float64

from gsrain_engine.render.scene_view import Shot
from gsrain_engine.session.view.projection import projected_point


@dataclass(frozen=True)
class Viewport:
    """The picture of this frame, for tools and overlays that draw over it. Pixels count from its upper left corner."""

    corner: ImVec2
    """On the screen."""
    width: int
    height: int
    shot: Shot
    """What it shows: a camera of this size, in the world (metres)."""
    hovered: bool
    """Whether the mouse is over the picture, and nothing else on top of it."""
    active: bool
    """Whether a mouse button that was pressed over the picture is still held."""

    @property
    def mouse_px(self) -> tuple[float, float]:
        at = imgui.get_mouse_pos()
        return at.x - self.corner.x, at.y - self.corner.y

    def on_screen(self, x: float, y: float) -> ImVec2:
        """Screen position of a pixel, for draw lists."""
        return ImVec2(self.corner.x + x, self.corner.y + y)

    def ray(self, x: float, y: float) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Eye and unit direction, in the world, of what is seen at a pixel."""
        camera = self.shot.camera
        sight = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        direction = camera.world_to_camera[:3, :3].T @ sight
        return camera.position, direction / np.linalg.norm(direction)

    def pixel(self, point_m: Float64[np.ndarray, "3"]) -> tuple[float, float] | None:
        """Pixel at which a point of the world is seen; None behind the eye."""
        seen = projected_point(point_m, self.shot.camera)
        return seen and (seen.x, seen.y)

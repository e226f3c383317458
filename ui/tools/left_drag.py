"""A drag of the left button over the picture, as the tools see it: pressed, dragged, released."""

from dataclasses import dataclass, field
from typing import Literal

from imgui_bundle import imgui

from ..widgets.viewport import Viewport

_STILL_PX = 4.0
"""A hand that moves less than this has clicked."""


@dataclass(slots=True)
class LeftDrag:
    """The places that the mouse has been at since the left button went down; gone when the tool is put away."""

    points: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    _frame: int = -1

    @property
    def has_moved(self) -> bool:
        """Whether it is more than a click."""
        x, y = self.points[0] if self.points else (0.0, 0.0)
        return any(max(abs(u - x), abs(v - y)) > _STILL_PX for u, v in self.points)

    def follow(self, viewport: Viewport) -> Literal["none", "pressed", "dragged", "released"]:
        """Look at the mouse, once a frame; `points` stay until the next press."""
        if imgui.get_frame_count() > self._frame + 1:
            self.drop()
        self._frame = imgui.get_frame_count()
        if viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self.points = [viewport.mouse_px]
            return "pressed"
        if not self.points:
            return "none"
        if viewport.active and imgui.is_mouse_down(imgui.MouseButton_.left):
            if viewport.mouse_px != self.points[-1]:
                self.points.append(viewport.mouse_px)
            return "dragged"
        return "released"

    def drop(self) -> None:
        self.points = []

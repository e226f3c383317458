"""What a tool of the viewport is: it draws over the picture and may take the left mouse button for itself."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

from imgui_bundle import ImVec4, imgui
from imgui_bundle.imgui import ImVec2Like

from gsrain_engine.editor.editor import Editor

from ..widgets.draw import Viewport


@runtime_checkable
class Tool(Protocol):
    """One tool; `session.view.tool` names the one that is in use, "" is plain navigation."""

    name: str
    """As on its button and in the command palette, such as "Lasso"."""
    icon: str
    """One symbol of the icon font for the tool bar."""
    key: imgui.Key | None
    """Picks it."""
    help: str
    """What it does and which keys it knows, for the tooltip."""

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw over the picture and act on the mouse, each frame; returns whether the left button is its own now."""
        ...

    def options(self, session: Editor) -> None:
        """Draw its few settings into the bar above the picture."""
        ...


# § A drag of the left button over the picture, as the tools see it: pressed, dragged, released.

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


# § Lines, rings and knobs of the selection tools, readable on any picture: light on dark.

_DARK, _LIGHT = ImVec4(0.0, 0.0, 0.0, 0.75), ImVec4(1.0, 0.85, 0.3, 1.0)

_FILL = ImVec4(1.0, 0.85, 0.3, 0.10)

_FAINT = ImVec4(1.0, 0.85, 0.3, 0.55)

KNOB_PX = 7.0
"""Half the width of what can be dragged."""

Pixel = tuple[float, float]


def draw_polyline(viewport: Viewport, points: Sequence[Sequence[float]], *, closed: bool = False) -> None:
    """Draw a line through pixels."""
    on_screen: list[ImVec2Like] = [viewport.on_screen(x, y) for x, y in points]
    flags = imgui.ImDrawFlags_.closed if closed else 0
    for color, width in ((_DARK, 3.5), (_LIGHT, 1.5)):
        imgui.get_window_draw_list().add_polyline(on_screen, imgui.get_color_u32(color), thickness=width, flags=flags)


def draw_rectangle(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    """Draw a rectangle between two pixels, lightly filled."""
    low, high = viewport.on_screen(*first), viewport.on_screen(*second)
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(low, high, imgui.get_color_u32(_FILL))
    draw_polyline(viewport, [first, (second[0], first[1]), second, (first[0], second[1])], closed=True)


def draw_ring(viewport: Viewport, center: Pixel, radius_px: float) -> None:
    draw, at = imgui.get_window_draw_list(), viewport.on_screen(*center)
    for color, width in ((_DARK, 3.5), (_LIGHT, 1.5)):
        draw.add_circle(at, radius_px, imgui.get_color_u32(color), 0, width)


def draw_knob(viewport: Viewport, at: Pixel, *, is_lit: bool) -> None:
    """Draw something that can be dragged."""
    draw, center = imgui.get_window_draw_list(), viewport.on_screen(*at)
    draw.add_circle_filled(center, KNOB_PX if is_lit else KNOB_PX - 2, imgui.get_color_u32(_DARK))
    draw.add_circle_filled(center, KNOB_PX - (2 if is_lit else 3.5), imgui.get_color_u32(_LIGHT))


def is_mouse_at(viewport: Viewport, at: Pixel | None) -> bool:
    """Whether the mouse is over a knob."""
    if at is None:
        return False
    x, y = viewport.mouse_px
    return max(abs(x - at[0]), abs(y - at[1])) <= KNOB_PX + 2


def draw_faint_line(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    """Draw a thin line: how a shape would close."""
    draw = imgui.get_window_draw_list()
    draw.add_line(viewport.on_screen(*first), viewport.on_screen(*second), imgui.get_color_u32(_FAINT), 1.0)

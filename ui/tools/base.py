"""Viewport tools: their interface, drags of the left button, and drawing helpers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

from imgui_bundle import ImVec4, imgui
from imgui_bundle.imgui import ImVec2Like

from gsrain_engine.editor.editor import Editor

from ..widgets.draw import Viewport


@runtime_checkable
class Tool(Protocol):
    """A tool that draws over the viewport and may use the left mouse button.

    `session.view.tool` is the name of the active tool; "" is plain navigation.
    """

    name: str
    """Name on its button and in the command palette, such as "Lasso"."""
    icon: str
    """Symbol of the icon font for the toolbar."""
    key: imgui.Key | None
    help: str
    """Tooltip with its function and keys."""

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw over the viewport and handle the mouse, each frame; returns True if the tool uses the left button."""
        ...

    def options(self, session: Editor) -> None:
        """Draw its settings into the bar above the viewport."""
        ...


# Drags of the left button

_STILL_PX = 4.0  # movement up to this distance is a click


@dataclass(slots=True)
class LeftDrag:
    """Mouse positions since the left button went down; cleared when the tool is deactivated."""

    points: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    _frame: int = -1

    @property
    def has_moved(self) -> bool:
        """True if it is more than a click."""
        x, y = self.points[0] if self.points else (0.0, 0.0)
        return any(max(abs(u - x), abs(v - y)) > _STILL_PX for u, v in self.points)

    def follow(self, viewport: Viewport) -> Literal["none", "pressed", "dragged", "released"]:
        """Read the mouse, once per frame; `points` stay until the next press."""
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


# Lines, rings and knobs of the selection tools, light on dark to be visible on any image

_DARK, _LIGHT = ImVec4(0.0, 0.0, 0.0, 0.75), ImVec4(1.0, 0.85, 0.3, 1.0)
_FILL = ImVec4(1.0, 0.85, 0.3, 0.10)
_FAINT = ImVec4(1.0, 0.85, 0.3, 0.55)
KNOB_PX = 7.0
"""Half the width of a draggable knob."""

Pixel = tuple[float, float]


def draw_polyline(viewport: Viewport, points: Sequence[Sequence[float]], *, closed: bool = False) -> None:
    on_screen: list[ImVec2Like] = [viewport.on_screen(x, y) for x, y in points]
    flags = imgui.ImDrawFlags_.closed if closed else 0
    for color, width in ((_DARK, 3.5), (_LIGHT, 1.5)):
        imgui.get_window_draw_list().add_polyline(on_screen, imgui.get_color_u32(color), thickness=width, flags=flags)


def draw_rectangle(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    low, high = viewport.on_screen(*first), viewport.on_screen(*second)
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(low, high, imgui.get_color_u32(_FILL))
    draw_polyline(viewport, [first, (second[0], first[1]), second, (first[0], second[1])], closed=True)


def draw_ring(viewport: Viewport, center: Pixel, radius_px: float) -> None:
    draw, at = imgui.get_window_draw_list(), viewport.on_screen(*center)
    for color, width in ((_DARK, 3.5), (_LIGHT, 1.5)):
        draw.add_circle(at, radius_px, imgui.get_color_u32(color), 0, width)


def draw_knob(viewport: Viewport, at: Pixel, *, is_lit: bool) -> None:
    draw, center = imgui.get_window_draw_list(), viewport.on_screen(*at)
    draw.add_circle_filled(center, KNOB_PX if is_lit else KNOB_PX - 2, imgui.get_color_u32(_DARK))
    draw.add_circle_filled(center, KNOB_PX - (2 if is_lit else 3.5), imgui.get_color_u32(_LIGHT))


def is_mouse_at(viewport: Viewport, at: Pixel | None) -> bool:
    if at is None:
        return False
    x, y = viewport.mouse_px
    return max(abs(x - at[0]), abs(y - at[1])) <= KNOB_PX + 2


def draw_faint_line(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    """Draw a thin line, such as the closing edge of a shape."""
    draw = imgui.get_window_draw_list()
    draw.add_line(viewport.on_screen(*first), viewport.on_screen(*second), imgui.get_color_u32(_FAINT), 1.0)

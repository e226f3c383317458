"""Viewport tools: their base classes, numbers in their bar, and lines that are visible on any image."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from imgui_bundle import ImVec4, imgui
from imgui_bundle.imgui import ImVec2Like
from jaxtyping import Float64

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.viewport.picking import pick_point

from ..widgets.draw import Canvas, draw_lines, is_clicked

Pixel = tuple[float, float]
CLAMP = imgui.SliderFlags_.always_clamp
_STILL_PX = 4.0  # movement up to this distance is a click


class Tool:
    """A tool that draws over the viewport and may use the left button; `viewport.options.tool` names the active one.

    Its constructor gets the editor's parts that its parameters name.
    """

    name: str
    """Name on its button and in the command palette, such as "Lasso"."""
    icon: str
    """Symbol of the icon font for the toolbar."""
    key: imgui.Key | None = None
    help: str
    """Tooltip with its function and keys."""
    _frame = -1

    def draw(self, canvas: Canvas) -> bool:
        """Draw over the viewport and handle the mouse, each frame; returns True if the tool uses the left button."""
        raise NotImplementedError

    def options(self) -> None:
        """Draw its settings into the bar above the viewport."""
        raise NotImplementedError

    def is_resumed(self) -> bool:
        """Return True if the tool was inactive in the last frame. Call it once per frame."""
        before, self._frame = self._frame, imgui.get_frame_count()
        return self._frame > before + 1


class DragTool(Tool):
    """A tool for drags of the left button."""

    points: Sequence[Pixel] = ()
    """Mouse positions since the button went down; cleared after the release, or when the tool is deactivated."""
    _state: Literal["none", "pressed", "dragged", "released"] = "none"

    @property
    def has_moved(self) -> bool:
        """True if it is more than a click."""
        x, y = self.points[0] if self.points else (0.0, 0.0)
        return any(max(abs(u - x), abs(v - y)) > _STILL_PX for u, v in self.points)

    def follow_drag(self, canvas: Canvas) -> Literal["none", "pressed", "dragged", "released"]:
        """Read the mouse, once per frame."""
        if self.is_resumed() or self._state == "released":
            self.points = []
        if canvas.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._state, self.points = "pressed", [canvas.mouse_px]
        elif not self.points:
            self._state = "none"
        elif canvas.active and imgui.is_mouse_down(imgui.MouseButton_.left):
            self._state = "dragged"
            if canvas.mouse_px != self.points[-1]:
                self.points = [*self.points, canvas.mouse_px]
        else:
            self._state = "released"
        return self._state


def point_under_mouse(document: Document, canvas: Canvas) -> Float64[np.ndarray, "3"] | None:
    """Return the world point (meters) of the surface under the mouse; None for sky or nothing."""
    return pick_point(document.scene, canvas.shot, *canvas.mouse_px)


def clicked_point(document: Document, canvas: Canvas) -> Float64[np.ndarray, "3"] | None:
    """Return the world point (meters) of a surface that was clicked in this frame."""
    return point_under_mouse(document, canvas) if is_clicked(canvas) else None


# Numbers in the bar of a tool


def drag_number(
    label: str,
    value: float,
    speed: float,
    bounds: tuple[float, float],
    text: str,
    help_text: str,
    width_em: float,
    flags: int = CLAMP,
) -> tuple[bool, float]:
    """Draw a number that is dragged or typed; returns True if it has changed, and the number."""
    imgui.set_next_item_width(width_em * imgui.get_font_size())
    result = imgui.drag_float(label, value, speed, *bounds, text, flags)
    imgui.set_item_tooltip(help_text)
    return result


def drag_vector(
    label: str,
    value: tuple[float, float, float],
    speed: float,
    low: float,
    help_text: str,
    width_em: float,
    flags: int = CLAMP,
) -> tuple[bool, tuple[float, float, float]]:
    """Draw three numbers in meters, from `low` on."""
    imgui.set_next_item_width(width_em * imgui.get_font_size())
    changed, (x, y, z) = imgui.drag_float3(label, list(value), speed, low, 1e5, "%.2f", flags)
    imgui.set_item_tooltip(help_text)
    return changed, (x, y, z)


# Lines of the selection tools, light on dark

DARK, LIGHT = ImVec4(0.0, 0.0, 0.0, 0.75), ImVec4(1.0, 0.85, 0.3, 1.0)
_FILL = ImVec4(1.0, 0.85, 0.3, 0.10)
_FAINT = ImVec4(1.0, 0.85, 0.3, 0.55)


def draw_polyline(canvas: Canvas, points: Sequence[Sequence[float]], *, closed: bool = False) -> None:
    on_screen: list[ImVec2Like] = [canvas.on_screen(x, y) for x, y in points]
    flags = imgui.ImDrawFlags_.closed if closed else 0
    for color, width in ((DARK, 3.5), (LIGHT, 1.5)):
        imgui.get_window_draw_list().add_polyline(on_screen, imgui.get_color_u32(color), thickness=width, flags=flags)


def draw_rectangle(canvas: Canvas, first: Pixel, second: Pixel) -> None:
    low, high = canvas.on_screen(*first), canvas.on_screen(*second)
    imgui.get_window_draw_list().add_rect_filled(low, high, imgui.get_color_u32(_FILL))
    draw_polyline(canvas, [first, (second[0], first[1]), second, (first[0], second[1])], closed=True)


def draw_faint_line(canvas: Canvas, first: Pixel, second: Pixel) -> None:
    """Draw a thin line, such as the closing edge of a shape."""
    draw_lines(canvas, [(first, second)], _FAINT, 1.0)

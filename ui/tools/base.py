"""Viewport tools: their base classes, numbers in their bar, and lines that are visible on any image."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from imgui_bundle import ImVec4, imgui
from imgui_bundle.imgui import ImVec2Like
from jaxtyping import Float64

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.viewport.picking import pick_point

from ..widgets.draw import Viewport, is_clicked

Pixel = tuple[float, float]
CLAMP = imgui.SliderFlags_.always_clamp
_STILL_PX = 4.0  # movement up to this distance is a click


class Tool:
    """A tool that draws over the viewport and may use the left button; `session.view.tool` names the active one."""

    name: str
    """Name on its button and in the command palette, such as "Lasso"."""
    icon: str
    """Symbol of the icon font for the toolbar."""
    key: imgui.Key | None = None
    help: str
    """Tooltip with its function and keys."""
    _frame = -1

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw over the viewport and handle the mouse, each frame; returns True if the tool uses the left button."""
        raise NotImplementedError

    def options(self, session: Editor) -> None:
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

    def follow_drag(self, viewport: Viewport) -> Literal["none", "pressed", "dragged", "released"]:
        """Read the mouse, once per frame."""
        if self.is_resumed() or self._state == "released":
            self.points = []
        if viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._state, self.points = "pressed", [viewport.mouse_px]
        elif not self.points:
            self._state = "none"
        elif viewport.active and imgui.is_mouse_down(imgui.MouseButton_.left):
            self._state = "dragged"
            if viewport.mouse_px != self.points[-1]:
                self.points = [*self.points, viewport.mouse_px]
        else:
            self._state = "released"
        return self._state


def point_under_mouse(session: Editor, viewport: Viewport) -> Float64[np.ndarray, "3"] | None:
    """Return the world point (meters) of the surface under the mouse; None for sky or nothing."""
    return pick_point(session.scene, viewport.shot, *viewport.mouse_px)


def clicked_point(session: Editor, viewport: Viewport) -> Float64[np.ndarray, "3"] | None:
    """Return the world point (meters) of a surface that was clicked in this frame."""
    return point_under_mouse(session, viewport) if is_clicked(viewport) else None


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


def same_line_if_fits(width_em: float) -> None:
    """Continue on the same line, after a gap, if the width still fits; else on the next."""
    imgui.same_line(0, 10)
    if imgui.get_content_region_avail().x < width_em * imgui.get_font_size():
        imgui.new_line()


# Lines of the selection tools, light on dark

DARK, LIGHT = ImVec4(0.0, 0.0, 0.0, 0.75), ImVec4(1.0, 0.85, 0.3, 1.0)
_FILL = ImVec4(1.0, 0.85, 0.3, 0.10)
_FAINT = ImVec4(1.0, 0.85, 0.3, 0.55)


def draw_polyline(viewport: Viewport, points: Sequence[Sequence[float]], *, closed: bool = False) -> None:
    on_screen: list[ImVec2Like] = [viewport.on_screen(x, y) for x, y in points]
    flags = imgui.ImDrawFlags_.closed if closed else 0
    for color, width in ((DARK, 3.5), (LIGHT, 1.5)):
        imgui.get_window_draw_list().add_polyline(on_screen, imgui.get_color_u32(color), thickness=width, flags=flags)


def draw_rectangle(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    low, high = viewport.on_screen(*first), viewport.on_screen(*second)
    imgui.get_window_draw_list().add_rect_filled(low, high, imgui.get_color_u32(_FILL))
    draw_polyline(viewport, [first, (second[0], first[1]), second, (first[0], second[1])], closed=True)


def draw_faint_line(viewport: Viewport, first: Pixel, second: Pixel) -> None:
    """Draw a thin line, such as the closing edge of a shape."""
    start, end = viewport.on_screen(*first), viewport.on_screen(*second)
    imgui.get_window_draw_list().add_line(start, end, imgui.get_color_u32(_FAINT), 1.0)

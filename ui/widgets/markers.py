"""Points, lines and words drawn over the picture at places of the world."""

import numpy as np
from imgui_bundle import ImVec2, imgui
from jaxtyping import Float64

from .viewport import Viewport

Rgba = tuple[float, float, float, float]

YELLOW: Rgba = (1.0, 0.85, 0.25, 1.0)
_SHADOW: Rgba = (0.0, 0.0, 0.0, 0.6)


def draw_point(viewport: Viewport, point_m: Float64[np.ndarray, "3"], color: Rgba = YELLOW, radius: float = 5) -> None:
    """Draw a dot; nothing behind the eye."""
    pixel = viewport.pixel(point_m)
    if pixel is not None:
        draw, at = imgui.get_window_draw_list(), viewport.on_screen(*pixel)
        draw.add_circle_filled(at, radius + 1.5, imgui.get_color_u32(_SHADOW))
        draw.add_circle_filled(at, radius, imgui.get_color_u32(color))


def draw_line(
    viewport: Viewport, start_m: Float64[np.ndarray, "3"], end_m: Float64[np.ndarray, "3"], color: Rgba = YELLOW
) -> None:
    """Draw a straight line; nothing where an end of it is behind the eye."""
    first, second = viewport.pixel(start_m), viewport.pixel(end_m)
    if first is not None and second is not None:
        draw = imgui.get_window_draw_list()
        start, end = viewport.on_screen(*first), viewport.on_screen(*second)
        draw.add_line(start, end, imgui.get_color_u32(_SHADOW), 4.0)
        draw.add_line(start, end, imgui.get_color_u32(color), 2.0)


def draw_words(viewport: Viewport, point_m: Float64[np.ndarray, "3"], words: str) -> None:
    """Write something beside a point."""
    pixel = viewport.pixel(point_m)
    if pixel is not None:
        at = viewport.on_screen(*pixel)
        _write(ImVec2(at.x + 10, at.y - 0.5 * imgui.get_font_size()), words)


def draw_hint(viewport: Viewport, words: str) -> None:
    """Say at the lower edge of the picture what a tool waits for."""
    size = imgui.calc_text_size(words)
    _write(viewport.on_screen((viewport.width - size.x) / 2, viewport.height - 2.2 * size.y), words)


def is_clicked(viewport: Viewport) -> bool:
    """Whether the left button was pressed and let go over the picture without dragging: a drag still orbits."""
    left = imgui.MouseButton_.left
    moved = imgui.get_io().mouse_drag_max_distance_sqr[left]
    return viewport.hovered and imgui.is_mouse_released(left) and moved < 16.0


def _write(at: ImVec2, words: str) -> None:
    size, draw = imgui.calc_text_size(words), imgui.get_window_draw_list()
    low, high = ImVec2(at.x - 6, at.y - 3), ImVec2(at.x + size.x + 6, at.y + size.y + 3)
    draw.add_rect_filled(low, high, imgui.get_color_u32(_SHADOW), 4.0)
    draw.add_text(at, imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), words)

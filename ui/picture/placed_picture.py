"""A picture that lies somewhere in the viewport; in cells, since draw lists know no perspective."""

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from jaxtyping import Float64

from ..widgets.viewport import Viewport


def draw_placed_picture(
    viewport: Viewport, texture: int, grid: Float64[np.ndarray, "rows columns 2"], opacity: float
) -> None:
    """Draw a texture (its OpenGL name) with its first row on top, so that it fills a grid of pixels of the viewport."""
    low, high = grid.min(axis=(0, 1)), grid.max(axis=(0, 1))
    if not (high[0] > 0 and high[1] > 0 and low[0] < viewport.width and low[1] < viewport.height):
        return
    draw, tint = imgui.get_window_draw_list(), imgui.get_color_u32(ImVec4(1.0, 1.0, 1.0, opacity))
    on_screen = [[viewport.on_screen(x, y) for x, y in row] for row in grid.tolist()]
    rows, columns = len(on_screen) - 1, len(on_screen[0]) - 1
    for row in range(rows):
        top, bottom = row / rows, (row + 1) / rows
        for column in range(columns):
            left, right = column / columns, (column + 1) / columns
            draw.add_image_quad(
                imgui.ImTextureRef(texture),
                on_screen[row][column],
                on_screen[row][column + 1],
                on_screen[row + 1][column + 1],
                on_screen[row + 1][column],
                ImVec2(left, top),
                ImVec2(right, top),
                ImVec2(right, bottom),
                ImVec2(left, bottom),
                tint,
            )

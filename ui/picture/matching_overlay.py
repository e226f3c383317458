"""Matching over the picture: another view warped onto this one, and where the pixel at the mouse lies in it."""

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from jaxtyping import Float64

from gsrain_engine.appearance.matching.correspondence import Outcome
from gsrain_engine.session.capture.frustums import picture_grid
from gsrain_engine.session.capture.view_pictures import THUMBNAIL_PX, Wish
from gsrain_engine.session.matching.matching_colors import COLORS
from gsrain_engine.session.matching.matching_view import Shown
from gsrain_engine.session.session import Session

from ..widgets.colors import CHOSEN, OUTLINE, color
from ..widgets.viewport import Viewport
from .placed_picture import draw_placed_picture

WORDS: dict[Outcome, str] = {
    Outcome.MATCHED: "matched",
    Outcome.HIDDEN: "hidden there",
    Outcome.EDGE: "edge of something",
    Outcome.MOVING: "may have moved",
    Outcome.UNKNOWN: "depth unknown",
    Outcome.OUTSIDE: "outside that view",
}
_CELLS = (8, 6)
_LEAST_SHARE = 0.005
"""Of the picture, from which on the legend names something."""
_LINE = ImVec4(0.35, 0.95, 0.6, 0.85)
_INSET_SHARE, _MOST_INSET_EM, _MARGIN = 0.3, 16.0, 10.0
_PAPER = ImVec4(0.06, 0.065, 0.08, 0.82)
_INK = ImVec4(0.94, 0.94, 0.96, 1.0)
_FAINT = ImVec4(0.7, 0.71, 0.75, 1.0)


def matching_overlay(session: Session, viewport: Viewport) -> bool:
    """Draw what is matched, if that is switched on; never takes the mouse."""
    matching = session.matching
    if not matching.is_on:
        return False
    shown = matching.shown
    if shown is None:
        _card(viewport, matching.problem or "Matching...", [])
        return False
    texture = session.matching.texture
    grid = picture_grid(shown.camera, 1.0, viewport.shot.camera, _CELLS)
    if texture is None or grid is None:
        return False
    draw_placed_picture(viewport, texture.name, grid, 1.0)
    if matching.lines:
        _lines(viewport, shown, grid)
    under = _under_the_mouse(viewport, shown, grid)
    _inset(session, viewport, shown, under)
    named = [each for each in shown.shares.items() if each[1] >= _LEAST_SHARE]
    if matching.mode != "pixels":  # what matches has its own colours, and the title tells how much it is
        named = [each for each in named if each[0] != Outcome.MATCHED]
    _card(viewport, _title(shown), named)
    return False


def _title(shown: Shown) -> str:
    return f"{shown.matched.found.valid.mean():.0%} matched with {shown.matched.to.name}"


def _lines(viewport: Viewport, shown: Shown, grid: Float64[np.ndarray, "rows columns 2"]) -> None:
    draw = imgui.get_window_draw_list()
    starts, ends = (_on_grid(shown.lines[:, k], grid) for k in (0, 1))
    for (x0, y0), (x1, y1) in zip(starts.tolist(), ends.tolist(), strict=True):
        start, end = viewport.on_screen(x0, y0), viewport.on_screen(x1, y1)
        draw.add_line(start, end, color(OUTLINE), 3.0)
        draw.add_line(start, end, color(_LINE), 1.3)
        draw.add_circle_filled(start, 2.4, color(OUTLINE))
        draw.add_circle_filled(start, 1.6, color(_LINE))


def _on_grid(shares: np.ndarray, grid: Float64[np.ndarray, "rows columns 2"]) -> Float64[np.ndarray, "n 2"]:
    """Pixels of the viewport at shares of the picture; the picture's corners are those of the grid."""
    x, y = shares[:, :1].astype(np.float64), shares[:, 1:].astype(np.float64)
    top = (1 - x) * grid[0, 0] + x * grid[0, -1]
    bottom = (1 - x) * grid[-1, 0] + x * grid[-1, -1]
    return (1 - y) * top + y * bottom


def _under_the_mouse(
    viewport: Viewport, shown: Shown, grid: Float64[np.ndarray, "rows columns 2"]
) -> tuple[int, int] | None:
    """Row and column of the matched picture under the mouse; None beside it."""
    if not viewport.hovered:
        return None
    height, width = shown.matched.found.outcome.shape
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    away = np.array(viewport.mouse_px) - grid[0, 0]
    share = np.linalg.solve(np.stack([right, down], axis=1), away)
    column, row = int(np.floor(share[0] * width)), int(np.floor(share[1] * height))
    return (row, column) if 0 <= row < height and 0 <= column < width else None


def _inset(session: Session, viewport: Viewport, shown: Shown, under: tuple[int, int] | None) -> None:
    """The other view in the corner, with a cross at what is under the mouse."""
    captures, other = session.captures, shown.matched.to
    if captures.pictures is None:
        return
    captures.pictures.want(shown.wish.to, THUMBNAIL_PX)
    texture = captures.textures.get(Wish(shown.wish.to, THUMBNAIL_PX))
    if texture is None:
        return
    width = min(_INSET_SHARE * viewport.width, _MOST_INSET_EM * imgui.get_font_size())
    height = width * other.camera.height / other.camera.width
    low = viewport.on_screen(viewport.width - width - _MARGIN, _MARGIN)
    high = ImVec2(low.x + width, low.y + height)
    draw = imgui.get_window_draw_list()
    draw.add_image(imgui.ImTextureRef(texture.name), low, high)
    draw.add_rect(low, high, color(CHOSEN), thickness=1.5)
    if under is None:
        return
    outcome = Outcome(int(shown.matched.found.outcome[under]))
    if outcome == Outcome.MATCHED:
        x, y = shown.matched.found.places[under].tolist()
        at = ImVec2(low.x + x / other.camera.width * width, low.y + y / other.camera.height * height)
        for line, thick in ((OUTLINE, 3.5), (CHOSEN, 1.5)):
            draw.add_line(ImVec2(at.x - 7, at.y), ImVec2(at.x + 7, at.y), color(line), thick)
            draw.add_line(ImVec2(at.x, at.y - 7), ImVec2(at.x, at.y + 7), color(line), thick)
        imgui.set_tooltip(f"There at column {x:.1f}, row {y:.1f} of {other.camera.width} x {other.camera.height} px.")
    else:
        imgui.set_tooltip(f"No match in {other.name}: {WORDS[outcome]}.")


def _card(viewport: Viewport, title: str, shares: list[tuple[Outcome, float]]) -> None:
    """The legend, in the lower right corner: tools are on the left."""
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    line = imgui.get_text_line_height() * 1.2
    rows = [f"{WORDS[each]}  {share:.0%}" for each, share in shares]
    width = max([imgui.calc_text_size(title).x, *(imgui.calc_text_size(row).x + 1.4 * em for row in rows)]) + 1.2 * em
    height = (1 + len(rows)) * line + 0.8 * em
    low = viewport.on_screen(viewport.width - width - _MARGIN, viewport.height - height - _MARGIN)
    draw.add_rect_filled(low, ImVec2(low.x + width, low.y + height), color(_PAPER), 5.0)
    x, y = low.x + 0.6 * em, low.y + 0.4 * em
    draw.add_text(ImVec2(x, y), color(_INK), title)
    for (outcome, _), row in zip(shares, rows, strict=True):
        y += line
        red, green, blue = COLORS[outcome]
        box = ImVec2(x, y + 0.2 * em), ImVec2(x + 0.8 * em, y + em)
        draw.add_rect_filled(*box, color(ImVec4(red, green, blue, 1.0)), 2.0)
        draw.add_rect(*box, color(_FAINT), 2.0)
        draw.add_text(ImVec2(x + 1.4 * em, y), color(_FAINT), row)

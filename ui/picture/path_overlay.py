"""The camera path in the picture: its way, its seconds, and its keys as small cameras that are dragged."""

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from jaxtyping import Float64

from gsrain_engine.session.camera_path import edits
from gsrain_engine.session.camera_path.path_drawing import KeyMark, drag_in_view, path_drawing
from gsrain_engine.session.session import Session

from ..widgets.colors import CHOSEN, KEY, OUTLINE, PLAYHEAD, color
from ..widgets.viewport import Viewport

_WAY = ImVec4(0.55, 0.78, 1.0, 0.9)
_HANDLE, _REACH = 5.5, 10.0
_LEFT = imgui.MouseButton_.left
_DRAG_PX = 2.0


def path_overlay(session: Session, viewport: Viewport) -> bool:
    """Draw the path unless it is ridden along; returns whether a key is in the hand or under it."""
    timeline = session.timeline
    drag = timeline.drag if timeline.drag is not None and timeline.drag.in_view else None
    if not timeline.show_path or session.view.follow_path:
        return False
    drawing = path_drawing(session, viewport.shot.camera)
    if drawing is None:
        return False
    _lines(viewport, drawing.way_px, _WAY, 2.0)
    for x, y in drawing.ticks_px.tolist():
        imgui.get_window_draw_list().add_circle_filled(viewport.on_screen(x, y), 2.5, color(_WAY))
    _lines(viewport, drawing.now_px, PLAYHEAD, 1.5)
    under = _under_the_mouse(viewport, drawing.keys) if session.view.tool == "" or drag is not None else None
    for mark in drawing.keys:
        _key(session, viewport, mark, is_near=mark.key == under)
    if drag is not None:
        _drag(session, viewport)
        return True
    if under is None or not viewport.hovered:
        return False
    imgui.set_tooltip(
        f"Camera key {under + 1}. Drag: move it in the plane that faces you. Shift+drag: up and down. Click: choose it."
    )
    if imgui.is_mouse_clicked(_LEFT):
        edits.begin_drag(session, under, in_view=True)
    return True


def _drag(session: Session, viewport: Viewport) -> None:
    drag, moved = session.timeline.drag, imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX)
    if drag is None:
        return
    if moved.x or moved.y:
        session.timeline.drag = drag = drag.begun()
    if drag.has_moved:
        drag_in_view(session, viewport.shot, (moved.x, moved.y), upright=imgui.get_io().key_shift)
    if not imgui.is_mouse_down(_LEFT):
        edits.end_drag(session)


def _under_the_mouse(viewport: Viewport, keys: list[KeyMark]) -> int | None:
    """The key whose handle the mouse is at; of several, the one that is drawn last."""
    x, y = viewport.mouse_px
    for mark in reversed(keys):
        if abs(mark.handle_px[0] - x) <= _REACH and abs(mark.handle_px[1] - y) <= _REACH:
            return mark.key
    return None


def _key(session: Session, viewport: Viewport, mark: KeyMark, *, is_near: bool) -> None:
    draw, hue = imgui.get_window_draw_list(), CHOSEN if edits.chosen_key(session) == mark.key else KEY
    _lines(viewport, mark.frustum_px, hue, 1.5)
    at = viewport.on_screen(*mark.handle_px)
    radius = _HANDLE + (2 if is_near else 0)
    draw.add_circle_filled(at, radius + 1.5, color(OUTLINE))
    draw.add_circle_filled(at, radius, color(hue))
    low = at.y + 0.35 * imgui.get_font_size()
    for offset, ink in ((1.0, OUTLINE), (0.0, hue)):
        draw.add_text(ImVec2(at.x + radius + 3 + offset, low + offset), color(ink), str(mark.key + 1))


def _lines(viewport: Viewport, lines_px: Float64[np.ndarray, "m 2 2"], hue: ImVec4, width: float) -> None:
    draw = imgui.get_window_draw_list()
    for (x0, y0), (x1, y1) in lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(OUTLINE), width + 1.5)
    for (x0, y0), (x1, y1) in lines_px.tolist():
        draw.add_line(viewport.on_screen(x0, y0), viewport.on_screen(x1, y1), color(hue), width)

"""The ruler of the timeline: marks in seconds, the playhead that is dragged, and the grips of what plays."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.camera_path import moments
from gsrain_engine.session.session import Session

from ...widgets.colors import DIM, FAINT, PLAYED, PLAYHEAD, color

HEIGHT_EM = 1.7
_LABELS_APART_EM = 4.5
_MARKS_APART_PX = 7.0
_GRIP = 5.0
_HELP = (
    "Seconds of the scene. Drag: go to a moment. Wheel: zoom. Middle drag: move along. Double click: show all.\n"
    "Over the rows below, Shift+wheel scrolls."
)


def strip(session: Session, width: float) -> None:
    """Draw the ruler at the cursor, and scrub while it is held."""
    corner, height = imgui.get_cursor_screen_pos(), HEIGHT_EM * imgui.get_font_size()
    ruler = session.timeline.ruler
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button("ruler", ImVec2(width, height))
    imgui.set_item_tooltip(_HELP)
    if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        ruler.fit(*session.span_s)
    elif imgui.is_item_active() and not imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        session.clock.seek(moments.on_frame(session, ruler.time(imgui.get_mouse_pos().x - corner.x)))
    _marks(session, corner, width, height)
    _span(session, corner, width, height)
    imgui.set_cursor_screen_pos(corner)
    imgui.dummy(ImVec2(width, height))


def playhead(session: Session, corner: ImVec2, width: float, height: float, *, with_head: bool) -> None:
    """Draw the line of the present moment."""
    x = session.timeline.ruler.x(session.clock.time_s)
    if not -1 <= x <= width + 1:
        return
    draw, at = imgui.get_window_draw_list(), corner.x + x
    draw.add_line(ImVec2(at, corner.y), ImVec2(at, corner.y + height), color(PLAYHEAD), 1.5)
    if with_head:
        low = corner.y + height
        draw.add_triangle_filled(ImVec2(at - 6, low - 9), ImVec2(at + 6, low - 9), ImVec2(at, low), color(PLAYHEAD))


def _marks(session: Session, corner: ImVec2, width: float, height: float) -> None:
    draw, ruler = imgui.get_window_draw_list(), session.timeline.ruler
    low = corner.y + height
    for t in ruler.marks(_MARKS_APART_PX):
        x = corner.x + ruler.x(t)
        draw.add_line(ImVec2(x, low - 4), ImVec2(x, low), color(FAINT))
    apart = _LABELS_APART_EM * imgui.get_font_size()
    digits = 0 if ruler.mark_step(apart) >= 1 else 1 if ruler.mark_step(apart) >= 0.1 else 2
    for t in ruler.marks(apart):
        x = corner.x + ruler.x(t)
        draw.add_line(ImVec2(x, low - 9), ImVec2(x, low), color(DIM))
        draw.add_text(ImVec2(x + 3, corner.y), color(DIM), f"{abs(t):.{digits}f} s")


def _span(session: Session, corner: ImVec2, width: float, height: float) -> None:
    """A band over what plays, with a grip at either end."""
    draw, ruler = imgui.get_window_draw_list(), session.timeline.ruler
    start, end = session.span_s
    low = corner.y + height
    draw.add_rect_filled(
        ImVec2(corner.x + ruler.x(start), low - 3), ImVec2(corner.x + ruler.x(end), low), color(PLAYED)
    )
    for name, moment in (("span start", start), ("span end", end)):
        x = corner.x + ruler.x(moment)
        if not corner.x - _GRIP <= x <= corner.x + width + _GRIP:
            continue
        imgui.set_cursor_screen_pos(ImVec2(x - _GRIP, low - 12))
        imgui.set_next_item_allow_overlap()
        imgui.invisible_button(name, ImVec2(2 * _GRIP, 12))
        held, hovered = imgui.is_item_active(), imgui.is_item_hovered()
        imgui.set_item_tooltip("Drag: play from here or up to here. Right click: all of the flight or the traffic.")
        if held or hovered:
            imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
        if held and imgui.is_mouse_dragging(imgui.MouseButton_.left, 2):
            moments.set_span(session, name == "span start", ruler.time(imgui.get_mouse_pos().x - corner.x))
        if hovered and imgui.is_mouse_clicked(imgui.MouseButton_.right):
            session.clock.span_s = None
        top = low - (11 if held or hovered else 8)
        draw.add_rect_filled(ImVec2(x - 2, top), ImVec2(x + 2, low), color(PLAYED), 1.0)

"""The Timeline panel: time is scrubbed, camera keys are set and moved, and all that has a time is seen."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.camera_path import edits
from gsrain_engine.session.session import Session

from .timeline.keys import key_menu
from .timeline.numbers import numbers
from .timeline.rows import rows
from .timeline.strip import HEIGHT_EM, playhead, strip
from .timeline.transport import transport

_TITLES_EM, _NUMBERS_EM = 6.5, 21.0
_NARROW_EM = 50.0
"""Below this width the numbers make room for the rows."""


def timeline_panel(session: Session) -> None:
    em, timeline = imgui.get_font_size(), session.timeline
    transport(session)
    avail = imgui.get_content_region_avail()
    beside = _NUMBERS_EM * em if avail.x > _NARROW_EM * em else 0.0
    titles = _TITLES_EM * em
    # Room for the scroll bar of the rows stays free, so that ruler and rows are equally wide.
    width = max(avail.x - beside - titles - imgui.get_style().scrollbar_size - 8, 60.0)
    timeline.ruler.width_px = width
    if not timeline.is_fitted:
        timeline.ruler.fit(*session.span_s)
        timeline.is_fitted = True
    if session.clock.playing and not imgui.is_mouse_down(imgui.MouseButton_.left):
        timeline.ruler.show(session.clock.time_s)
    start = imgui.get_cursor_screen_pos()
    height = HEIGHT_EM * em
    imgui.set_cursor_screen_pos(ImVec2(start.x + titles, start.y))
    imgui.begin_group()
    strip(session, width)
    playhead(session, ImVec2(start.x + titles, start.y), width, height, with_head=True)
    imgui.end_group()
    imgui.set_cursor_screen_pos(ImVec2(start.x, start.y + height))
    _rows(session, titles, width)
    if beside:
        imgui.set_cursor_screen_pos(ImVec2(start.x + avail.x - beside + 8, start.y))
        if imgui.begin_child("numbers", ImVec2(beside - 8, 0)):
            numbers(session)
        imgui.end_child()
    _keyboard(session)


def _rows(session: Session, titles: float, width: float) -> None:
    size = ImVec2(titles + width + imgui.get_style().scrollbar_size, 0)
    flags = imgui.WindowFlags_.no_scroll_with_mouse
    shown = imgui.begin_child("rows", size, window_flags=flags)
    corner, height = imgui.get_window_pos(), imgui.get_window_height()
    if shown:
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
        rows(session, titles, width)
        imgui.pop_style_var()
        io = imgui.get_io()
        if io.key_shift and io.mouse_wheel and imgui.is_window_hovered():
            imgui.set_scroll_y(imgui.get_scroll_y() - io.mouse_wheel * imgui.get_text_line_height())
        key_menu(session)
        playhead(session, ImVec2(corner.x + titles, corner.y), width, height, with_head=False)
    imgui.end_child()
    _wheel(session, corner.x + titles)


def _wheel(session: Session, left: float) -> None:
    """Zoom by the wheel and pan by the middle button, over ruler and rows; Shift and the wheel scroll the rows."""
    io, ruler = imgui.get_io(), session.timeline.ruler
    x = imgui.get_mouse_pos().x - left
    if not imgui.is_window_hovered(imgui.HoveredFlags_.child_windows) or not 0 <= x <= ruler.width_px:
        return
    if io.mouse_wheel and not io.key_shift:
        ruler.zoom(io.mouse_wheel, x)
    if imgui.is_mouse_dragging(imgui.MouseButton_.middle, 0):
        ruler.pan(io.mouse_delta.x)


def _keyboard(session: Session) -> None:
    key = edits.chosen_key(session)
    session.timeline.takes_keys = imgui.is_window_focused(imgui.FocusedFlags_.child_windows)
    if imgui.get_io().want_text_input or key is None:
        return
    if session.timeline.takes_keys and imgui.is_key_pressed(imgui.Key.delete):
        edits.delete_key(session, key)

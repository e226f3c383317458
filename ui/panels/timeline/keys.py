"""Camera keys on the timeline: a click goes there, a drag moves in time, a drag with Ctrl copies."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.camera_path import edits, files, moments
from gsrain_engine.session.session import Session

from ...widgets.colors import CHOSEN, KEY, OUTLINE, color

_RADIUS = 6.5
_LEFT, _RIGHT = imgui.MouseButton_.left, imgui.MouseButton_.right
_DRAG_PX = 3.0
_APART_PX = 3.0
"""Keys that stand closer are left out until the timeline is zoomed in: imported paths have thousands."""


def camera_keys(session: Session, corner: ImVec2, width: float, height: float) -> None:
    """Draw the keys of the person's path into a row, and act on the mouse."""
    path, ruler = session.scene.path, session.timeline.ruler
    if path is None:
        return
    last_x, chosen = -_RADIUS - _APART_PX, edits.chosen_key(session)
    for key, moment in enumerate(path.times_s.tolist()):
        x = ruler.x(moment)
        if key == chosen or last_x + _APART_PX <= x <= width + _RADIUS:
            last_x = x
            _key(session, key, moment, ImVec2(corner.x + x, corner.y + height / 2))
    _drag(session)


def key_menu(session: Session) -> None:
    """Draw the menu that a right click on a key opened; in the window that the keys are in."""
    if not imgui.begin_popup("key menu"):
        return
    key = edits.chosen_key(session)
    if key is not None:
        if _item("Look through it", "Ride along, stopped at this key."):
            moments.go_to_key(session, key)
        if _item("Update from the view", "Give this key what the view shows."):
            edits.update_key(session, key)
        if _item("Copy to the present time", "Put the same camera at the playhead."):
            edits.copy_key(session, key, session.clock.time_s)
        if _item("Move to the present time", "Move this key to the playhead."):
            edits.retime_key(session, key, session.clock.time_s)
        if _item("Snap to the drive", "Lay it onto the nearest place of the recorded drive, looking as it does there."):
            files.snap_key(session, key)
        imgui.separator()
        if _item("Delete", "Take this key away."):
            edits.delete_key(session, key)
    imgui.end_popup()


def _key(session: Session, key: int, moment: float, at: ImVec2) -> None:
    imgui.set_cursor_screen_pos(ImVec2(at.x - _RADIUS, at.y - _RADIUS))
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button(f"key {key}", ImVec2(2 * _RADIUS, 2 * _RADIUS))
    hovered = imgui.is_item_hovered()
    if imgui.is_item_activated():
        edits.begin_drag(session, key, copies=imgui.get_io().key_ctrl)
    if hovered and imgui.is_mouse_clicked(_RIGHT):
        session.timeline.key = key
        imgui.open_popup("key menu")
    if session.timeline.drag is None:
        imgui.set_item_tooltip(
            f"Camera key {key + 1} at {moment:.2f} s. Click: look through it. Drag: move in time. Ctrl+drag: copy. "
            "Delete: remove. Right click: more."
        )
    draw, is_chosen = imgui.get_window_draw_list(), edits.chosen_key(session) == key
    r = _RADIUS + (1.5 if hovered else 0)
    for size, hue in ((r + 1.5, OUTLINE), (r, CHOSEN if is_chosen else KEY)):
        left, right = ImVec2(at.x - size, at.y), ImVec2(at.x + size, at.y)
        draw.add_quad_filled(left, ImVec2(at.x, at.y - size), right, ImVec2(at.x, at.y + size), color(hue))


def _drag(session: Session) -> None:
    """Go on with a drag that began on a key of this row: keys change their numbers under the hand."""
    timeline = session.timeline
    if timeline.drag is None or timeline.drag.in_view:
        return
    moved = imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX).x
    if moved:
        timeline.drag = timeline.drag.begun()
    if timeline.drag.has_moved:
        edits.drag_in_time(session, timeline.ruler.seconds(moved))
        imgui.set_tooltip(f"{edits.chosen_time(session):.2f} s")
    if not imgui.is_mouse_down(_LEFT):
        key, has_moved = timeline.drag.key, timeline.drag.has_moved
        edits.end_drag(session)
        if not has_moved:
            moments.go_to_key(session, key)


def _item(name: str, help_text: str) -> bool:
    clicked, _ = imgui.menu_item(name, "", False)
    imgui.set_item_tooltip(help_text)
    return clicked

"""The bar above the timeline: play, step, the time, keys, and what can be done with the whole path."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.camera_path import edits
from gsrain_engine.session.session import Session

from .path_menu import path_menu
from .widgets import icon_button, switch, typed_number

_FA = icons_fontawesome_6
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_GAP = 18.0


def transport(session: Session) -> None:
    clock, timeline = session.clock, session.timeline
    start, end = session.span_s
    if icon_button(_FA.ICON_FA_BACKWARD_FAST, "to start", "To the start (Ctrl+Left)."):
        clock.seek(start)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_BACKWARD_STEP, "step back", "One frame back (Left)."):
        clock.step(-1, timeline.fps)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_PAUSE if clock.playing else _FA.ICON_FA_PLAY, "play", "Play or pause (Space)."):
        clock.toggle()
    imgui.same_line()
    if icon_button(_FA.ICON_FA_FORWARD_STEP, "step", "One frame on (Right)."):
        clock.step(1, timeline.fps)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_FORWARD_FAST, "to end", "To the end (Ctrl+Right)."):
        clock.seek(end)
    imgui.same_line()
    if switch(_FA.ICON_FA_REPEAT, "repeat", "Begin again at the end.", is_on=clock.loop):
        clock.loop = not clock.loop
    imgui.same_line()
    _speed(session)
    imgui.same_line()
    _time(session, end)
    imgui.same_line(spacing=_GAP)
    _keys(session)
    imgui.same_line(spacing=_GAP)
    if switch(
        _FA.ICON_FA_VIDEO, "ride", "Ride along: look through the flying camera (V).", is_on=session.view.follow_path
    ):
        session.ride(not session.view.follow_path)
    imgui.same_line()
    if switch(
        _FA.ICON_FA_ROUTE, "show path", "Show path: draw way and keys into the picture.", is_on=timeline.show_path
    ):
        timeline.show_path = not timeline.show_path
    imgui.same_line()
    path_menu(session)


def _speed(session: Session) -> None:
    imgui.set_next_item_width(4.2 * imgui.get_font_size())
    speed = session.clock.speed
    if imgui.begin_combo("##speed", f"{speed:g}\u00d7"):
        for each in _SPEEDS:
            if imgui.selectable(f"{each:g}\u00d7", each == speed)[0]:
                session.clock.speed = each
        imgui.end_combo()
    imgui.set_item_tooltip("How fast time plays, in seconds of the scene a second. Recordings don't care.")


def _time(session: Session, end: float) -> None:
    if session.timeline.asks_for_time:
        imgui.set_keyboard_focus_here()
        session.timeline.asks_for_time = False
    imgui.set_next_item_width(5.5 * imgui.get_font_size())
    typed = typed_number("##time", session.clock.time_s, "%.2f s")
    imgui.set_item_tooltip("Moment of the scene in seconds: traffic, rain and the flight are all functions of it.")
    if typed is not None:
        session.clock.seek(typed)
    imgui.same_line(spacing=4)
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(f"/ {end:.2f} s")
    imgui.set_item_tooltip("Where playing ends. Drag the grips on the ruler to play less or more.")


def _keys(session: Session) -> None:
    key = edits.chosen_key(session)
    words = "Keep what the view shows as a camera key at the present time (K). Shift+K: after the last key."
    if icon_button(f"{_FA.ICON_FA_PLUS} Key", "add key", words):
        edits.add_key(session)
    imgui.begin_disabled(key is None)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_CAMERA, "update key", "Give the chosen key what the view shows.") and key is not None:
        edits.update_key(session, key)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_TRASH, "delete key", "Delete the chosen key (Delete).") and key is not None:
        edits.delete_key(session, key)
    imgui.end_disabled()

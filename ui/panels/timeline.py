"""Timeline panel: transport bar, path menu, ruler, rows with keyframes, and numbers of the camera path."""

from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.editor.camera_path import CameraPathEditor
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain_tracks import TRACKS, RainTracks
from gsrain_engine.editor.timeline import Playback, TimelineRow, ego_speed_km_h, speed_of, track_rows
from gsrain_engine.scene.camera_path import CameraPath, Interpolation
from gsrain_engine.scene.camera_path_edit import ViewAngles, focal_length_mm, fov_of_focal_length
from gsrain_engine.scene.easing import Easing

from ..commands.table import help_of
from ..folding import show_panel
from ..widgets import draw as hues
from ..widgets.draw import color
from ..widgets.fields import (
    CLAMPED,
    button,
    checkbox,
    combo,
    disabled,
    end_gesture_when_released,
    error_color,
    menu_item,
    same_line_if_room,
    text_color,
)
from ..widgets.file_dialogs import ask_what_to_open, ask_where_to_save
from ..widgets.numbers import typed_seconds
from ..widgets.text import label
from .record import ask_where_to_record
from .timeline_tracks import (
    KEY_RADIUS,
    draw_key,
    easing_items,
    key_handle,
    label_before,
    rain_menu,
    track_key_numbers,
    track_menu,
    track_row,
)

_FA = icons_fontawesome_6
_LEFT, _RIGHT = imgui.MouseButton_.left, imgui.MouseButton_.right
_TITLES_EM, _NUMBERS_EM = 6.5, 21.0
_NARROW_EM = 50.0  # width below which numbers and words are hidden in favor of rows and buttons


def timeline_panel(editor: Editor) -> None:
    playback, camera_path = editor.playback, editor.camera_path
    em, timeline = imgui.get_font_size(), playback.timeline
    _transport(editor)
    avail = imgui.get_content_region_avail()
    numbers = _NUMBERS_EM * em if avail.x > _NARROW_EM * em else 0.0
    titles = _TITLES_EM * em
    # Reserve the width of the scroll bar, so that ruler and rows are equally wide.
    width = max(avail.x - numbers - titles - imgui.get_style().scrollbar_size - 8, 60.0)
    timeline.ruler.width_px = width
    if not timeline.is_fitted:
        playback.show_all()
        timeline.is_fitted = True
    playback.follow_history()
    if playback.clock.playing and not imgui.is_mouse_down(_LEFT):
        timeline.ruler.show(playback.clock.time_s)
    start, range_height, height = imgui.get_cursor_screen_pos(), _RANGE_EM * em, _RULER_EM * em
    imgui.set_cursor_screen_pos(ImVec2(start.x + titles, start.y))
    imgui.begin_group()
    _playback_range(playback, ImVec2(start.x + titles, start.y), width, range_height)
    corner = ImVec2(start.x + titles, start.y + range_height)
    imgui.set_cursor_screen_pos(corner)
    _ruler(playback, width, height)
    _playhead(playback, corner, width, height, with_head=True)
    imgui.end_group()
    _range_title(playback, start, titles, range_height)
    imgui.set_cursor_screen_pos(ImVec2(start.x, start.y + range_height + height))
    _rows(editor, titles, width)
    if numbers:
        imgui.set_cursor_screen_pos(ImVec2(start.x + avail.x - numbers + 8, start.y))
        if imgui.begin_child("numbers", ImVec2(numbers - 8, 0)):
            key, path = camera_path.active_key, editor.document.scene.path
            if path is not None and key is not None:
                _keyframe_numbers(editor, path, key)
            elif (rain_key := editor.rain_tracks.active) is not None:
                track_key_numbers(editor.document, editor.rain_tracks, rain_key)
                if button("Whole path", _WHOLE_PATH_HELP, width=-1):
                    editor.rain_tracks.choose(None)
            else:
                _path_numbers(editor, path)
        imgui.end_child()
    key = camera_path.active_key
    timeline.takes_keys = imgui.is_window_focused(imgui.FocusedFlags_.child_windows)
    has_focus = timeline.takes_keys and not imgui.get_io().want_text_input
    if has_focus:
        _act_on_keys(camera_path, editor.rain_tracks, key)


def _act_on_keys(camera_path: CameraPathEditor, tracks: RainTracks, key: int | None) -> None:
    """Delete the chosen keyframe, of the camera or of a track of the rain."""
    if imgui.is_key_pressed(imgui.Key.delete):
        if key is not None:
            camera_path.delete_keyframe(key)
        else:
            tracks.delete()


# Transport bar

_SPEEDS = {each: f"{each:g}\u00d7" for each in (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)}
_GAP = 18.0


def _transport(editor: Editor) -> None:
    playback, view = editor.playback, editor.viewport.options
    clock, timeline = playback.clock, playback.timeline
    start, end = playback.span_s
    is_narrow = imgui.get_content_region_avail().x < _NARROW_EM * imgui.get_font_size()
    if button(f"{_FA.ICON_FA_BACKWARD_FAST}###to start", "To the start of the range (Ctrl+Left)."):
        clock.seek(start)
    imgui.same_line()
    if button(f"{_FA.ICON_FA_BACKWARD_STEP}###step back", "One frame back (Left)."):
        clock.step(-1, timeline.fps)
    imgui.same_line()
    if button(f"{_FA.ICON_FA_PAUSE if clock.playing else _FA.ICON_FA_PLAY}###play", "Play or pause (Space)."):
        clock.toggle()
    imgui.same_line()
    if button(f"{_FA.ICON_FA_FORWARD_STEP}###step", "One frame forward (Right)."):
        clock.step(1, timeline.fps)
    imgui.same_line()
    if button(f"{_FA.ICON_FA_FORWARD_FAST}###to end", "To the end of the range (Ctrl+Right)."):
        clock.seek(end)
    imgui.same_line()
    if button(f"{_FA.ICON_FA_REPEAT}###repeat", "Loop: restart at the end of the range.", is_on=clock.loop):
        clock.loop = not clock.loop
    imgui.same_line()
    imgui.set_next_item_width(4.2 * imgui.get_font_size())
    clock.speed = combo("##speed", clock.speed, _SPEEDS, "Playback speed; exports do not depend on it.")
    imgui.same_line()
    _time(playback, None if is_narrow else end)
    gap = _GAP / 2 if is_narrow else _GAP
    same_line_if_room(7 if is_narrow else 11, gap)
    _keyframe_buttons(editor.camera_path, has_words=not is_narrow)
    same_line_if_room(9, gap)
    help_text = "Follow path: look through the path camera (V)."
    if button(f"{_FA.ICON_FA_EYE}###ride", help_text, is_on=view.follow_path):
        editor.viewport.ride(not view.follow_path)
    imgui.same_line()
    help_text = "Show path: draw path and keyframes in the viewport."
    if button(f"{_FA.ICON_FA_ROUTE}###show path", help_text, is_on=timeline.show_path):
        timeline.show_path = not timeline.show_path
    imgui.same_line()
    _path_menu(editor.document, playback, editor.camera_path)
    same_line_if_room(2, gap)
    help_text = "Choose a place, then record the timeline (Ctrl+R); the Record panel has format and size."
    title = f"{_FA.ICON_FA_VIDEO} Record..."
    width = imgui.calc_text_size(title).x + 2 * imgui.get_style().frame_padding.x
    fits = width <= imgui.get_content_region_avail().x
    if button(f"{title if fits else _FA.ICON_FA_VIDEO}###record", help_text):
        ask_where_to_record(editor.render_queue)


def _time(playback: Playback, end: float | None) -> None:
    """Draw the time, and behind it the end of the range, unless that is None."""
    if playback.timeline.asks_for_time:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(5.5 * imgui.get_font_size())
    typed = typed_seconds("##time", playback.clock.time_s)
    if imgui.is_item_active():  # a panel that has just opened takes the focus a frame later
        playback.timeline.asks_for_time = False
    imgui.set_item_tooltip("Time of the scene in seconds: traffic, rain and camera path depend on it.")
    if typed is not None:
        playback.clock.seek(typed)
    if end is None:
        return
    imgui.same_line(spacing=4)
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(f"/ {end:.2f} s")
    imgui.set_item_tooltip("End of the playback range. Drag its handles on the ruler to change it.")


def _keyframe_buttons(camera_path: CameraPathEditor, *, has_words: bool) -> None:
    key = camera_path.active_key
    help_text = "Insert a camera keyframe of the present view at the present time (K). Shift+K: after the last one."
    if button(f"{_FA.ICON_FA_PLUS}{' Keyframe' if has_words else ''}###add key", help_text):
        camera_path.add_keyframe()
    with disabled(key is None):
        imgui.same_line()
        help_text = "Set the active keyframe to the present view."
        if button(f"{_FA.ICON_FA_CAMERA}###update key", help_text) and key is not None:
            camera_path.update_keyframe(key)
        imgui.same_line()
        if button(f"{_FA.ICON_FA_TRASH}###delete key", "Delete the active keyframe (Delete).") and key is not None:
            camera_path.delete_keyframe(key)


# Camera path menu

_FRAME_RATES = (10.0, 24.0, 25.0, 30.0, 50.0, 60.0)
_JSON = "Camera paths{.json},All files{.*}"


def ask_for_time(playback: Playback) -> None:
    """Bring the timeline to the front, with the keyboard in its field of the time."""
    show_panel("Timeline")
    playback.timeline.asks_for_time = True


def ask_for_import(camera_path: CameraPathEditor) -> None:
    ask_what_to_open("Import a camera path", _JSON, lambda chosen: camera_path.import_path(chosen[0]))


def ask_for_export(camera_path: CameraPathEditor) -> None:
    title, name = "Export the camera path", "camera_path.json"
    ask_where_to_save(title, _JSON, lambda chosen: camera_path.export_path(chosen[0]), proposed=name)


def _path_menu(document: Document, playback: Playback, camera_path: CameraPathEditor) -> None:
    if button(f"Path {_FA.ICON_FA_CARET_DOWN}###path", "Import, export, create and delete the camera path."):
        imgui.open_popup("path menu")
    if not imgui.begin_popup("path menu"):
        return
    if menu_item("Import...", help_of("Import camera path...")):
        ask_for_import(camera_path)
    if imgui.begin_menu("Export"):
        _export_menu(camera_path)
        imgui.end_menu()
    imgui.separator()
    _drive_menu(camera_path)
    if menu_item("Circle around target", help_of("Circle around target")):
        camera_path.circle_target()
    imgui.separator()
    if imgui.begin_menu("fps"):
        for fps in _FRAME_RATES:
            if imgui.menu_item(f"{fps:g}", "", playback.timeline.fps == fps)[0]:
                playback.timeline.fps = fps
        imgui.end_menu()
    imgui.set_item_tooltip("Frame rate: keyframes and steps are on whole frames; exports write each frame.")
    has_path = document.scene.path is not None
    if menu_item("Reverse", help_of("Reverse camera path"), possible=has_path):
        camera_path.reverse_path()
    if menu_item("Delete all keyframes", help_of("Delete camera path"), possible=has_path):
        camera_path.delete_path()
    imgui.end_popup()


def _export_menu(camera_path: CameraPathEditor) -> None:
    if menu_item("Keyframes (GSRAIN)...", "Keyframes, interpolation and easing; import restores them exactly."):
        ask_for_export(camera_path)
    if menu_item("Every frame (nerfstudio)...", "A camera_path.json for ns-render, at the timeline's frame rate."):
        title = "Export for nerfstudio"
        name, export = "camera_path.json", camera_path.export_path
        ask_where_to_save(title, _JSON, lambda chosen: export(chosen[0], "nerfstudio"), proposed=name)
    help_text = "A list of cameras at the timeline's frame rate; it has no times."
    if menu_item("Every frame (3DGS cameras.json)...", help_text):
        title = "Export as 3DGS cameras"
        name, export = "cameras.json", camera_path.export_path
        ask_where_to_save(title, _JSON, lambda chosen: export(chosen[0], "training cameras"), proposed=name)


def _drive_menu(camera_path: CameraPathEditor) -> None:
    cameras = camera_path.rig_cameras
    if not imgui.begin_menu("From recorded drive", bool(cameras)):
        imgui.set_item_tooltip("Fly like a camera of the recording vehicle. This scene has no such vehicle.")
        return
    for number, camera in enumerate(cameras):
        if imgui.begin_menu(label(camera.name, str(number))):
            if menu_item("Few keyframes", "As few as stay within 5 cm and half a degree of the drive."):
                camera_path.path_from_drive(camera)
            for seconds in (0.5, 1.0, 2.0):
                if menu_item(f"A keyframe every {seconds:g} s", "Keyframes at equal intervals."):
                    camera_path.path_from_drive(camera, seconds)
            imgui.end_menu()
    imgui.end_menu()


# Playback range, and below it the ruler with the playhead

_RANGE_EM, _RULER_EM = 1.05, 1.55
_LABELS_APART_EM = 4.5
_MARKS_APART_PX = 7.0
_GRIP = 6.0
_RULER_HELP = (
    "Seconds of the scene. Drag: go to a time. Wheel: zoom. Middle drag: pan. Double click: show all.\n"
    "Over the rows below, Shift+wheel scrolls."
)


def _ruler(playback: Playback, width: float, height: float) -> None:
    """Draw the ruler at the cursor, and scrub while it is dragged."""
    corner, ruler = imgui.get_cursor_screen_pos(), playback.timeline.ruler
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button("ruler", ImVec2(width, height))
    imgui.set_item_tooltip(_RULER_HELP)
    if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(_LEFT):
        playback.show_all()
    elif imgui.is_item_active() and not imgui.is_mouse_double_clicked(_LEFT):
        playback.clock.seek(playback.nearest_frame_time(ruler.time(imgui.get_mouse_pos().x - corner.x)))
    draw, low = imgui.get_window_draw_list(), corner.y + height
    for t in ruler.marks(_MARKS_APART_PX):
        x = corner.x + ruler.x(t)
        draw.add_line(ImVec2(x, low - 4), ImVec2(x, low), color(hues.FAINT))
    apart = _LABELS_APART_EM * imgui.get_font_size()
    digits = 0 if ruler.mark_step(apart) >= 1 else 1 if ruler.mark_step(apart) >= 0.1 else 2
    for t in ruler.marks(apart):
        x = corner.x + ruler.x(t)
        draw.add_line(ImVec2(x, low - 9), ImVec2(x, low), color(hues.DIM))
        draw.add_text(ImVec2(x + 3, corner.y), color(hues.DIM), f"{abs(t):.{digits}f} s")
    imgui.set_cursor_screen_pos(corner)
    imgui.dummy(ImVec2(width, height))


def _range_title(playback: Playback, start: ImVec2, titles_px: float, height: float) -> None:
    """Draw the length of the range left of it; a click on it goes back to all of the content."""
    first_s, last_s = playback.span_s
    own = playback.clock.span_s is not None
    imgui.set_cursor_screen_pos(start)
    if imgui.invisible_button("range title", ImVec2(titles_px - 4, height)) and own:
        playback.clock.span_s = None
    imgui.set_item_tooltip(_RANGE_HELP + ("\nClick: all of the camera path or the traffic." if own else ""))
    text = f"Range {last_s - first_s:.1f} s"
    hue = color(hues.PLAYED if own else hues.DIM)
    imgui.get_window_draw_list().add_text(start + ImVec2(4, 0), hue, text)


_RANGE_HELP = "Range that is played and recorded. Drag its ends, or the bar between them. Right click: all."


def _playback_range(playback: Playback, corner: ImVec2, width: float, height: float) -> None:
    """Draw the playback range in a row of its own, with a handle at either end; the bar between them moves both."""
    draw, ruler, (start, end) = imgui.get_window_draw_list(), playback.timeline.ruler, playback.span_s
    first, last, low = corner.x + ruler.x(start), corner.x + ruler.x(end), corner.y + height
    middle = corner.y + height / 2
    draw.push_clip_rect(corner, ImVec2(corner.x + width, low), True)
    draw.add_rect_filled(corner, ImVec2(corner.x + width, low - 1), color(hues.STRIPE))
    draw.add_rect_filled(ImVec2(first, middle - 2), ImVec2(last, middle + 2), color(hues.PLAYED))
    draw.pop_clip_rect()
    left, right = max(first + _GRIP, corner.x), min(last - _GRIP, corner.x + width)
    if right > left:
        imgui.set_cursor_screen_pos(ImVec2(left, corner.y))
        imgui.invisible_button("span", ImVec2(right - left, height))
        imgui.set_item_tooltip(_RANGE_HELP)
        if imgui.is_item_active() and imgui.is_mouse_dragging(_LEFT, 2):
            playback.shift_span(ruler.seconds(imgui.get_io().mouse_delta.x))
        if imgui.is_item_clicked(_RIGHT):
            playback.clock.span_s = None
    for name, x in (("span start", first), ("span end", last)):
        if not corner.x - _GRIP <= x <= corner.x + width + _GRIP:
            continue
        imgui.set_cursor_screen_pos(ImVec2(x - _GRIP, corner.y))
        imgui.set_next_item_allow_overlap()
        imgui.invisible_button(name, ImVec2(2 * _GRIP, height))
        held, hovered = imgui.is_item_active(), imgui.is_item_hovered()
        imgui.set_item_tooltip("Drag: play and record from or up to here. Right click: all of it.")
        if held or hovered:
            imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
        if held and imgui.is_mouse_dragging(_LEFT, 2):
            playback.set_span(name == "span start", ruler.time(imgui.get_mouse_pos().x - corner.x))
        if hovered and imgui.is_mouse_clicked(_RIGHT):
            playback.clock.span_s = None
        half = 4 if held or hovered else 3
        draw.add_rect_filled(ImVec2(x - half, corner.y), ImVec2(x + half, low - 1), color(hues.PLAYED), 2.0)


def _playhead(playback: Playback, corner: ImVec2, width: float, height: float, *, with_head: bool) -> None:
    x = playback.timeline.ruler.x(playback.clock.time_s)
    if not -1 <= x <= width + 1:
        return
    draw, at, low, hue = imgui.get_window_draw_list(), corner.x + x, corner.y + height, color(hues.PLAYHEAD)
    draw.add_line(ImVec2(at, corner.y), ImVec2(at, low), hue, 1.5)
    if with_head:
        draw.add_triangle_filled(ImVec2(at - 6, low - 9), ImVec2(at + 6, low - 9), ImVec2(at, low), hue)


# Rows: camera keyframes, rain keyframes, and lifetimes of actors

_ROW_EM = 1.35
_DOT_PX = 4.0
_HINTS = (
    "No keyframes yet: find a view, press K; move on in time, find another view, press K.",
    "No keyframes yet: press K.",
)
"""Words of an empty row, and shorter ones for where they have no room."""


def _rows(editor: Editor, titles: float, width: float) -> None:
    playback = editor.playback
    size = ImVec2(titles + width + imgui.get_style().scrollbar_size, 0)
    is_visible = imgui.begin_child("rows", size, window_flags=imgui.WindowFlags_.no_scroll_with_mouse)
    corner, height, io = imgui.get_window_pos(), imgui.get_window_height(), imgui.get_io()
    ruler, weather = playback.timeline.ruler, editor.document.keyframes
    if is_visible:
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
        _camera_row(editor, titles, width)
        for track in TRACKS:
            if track.is_always_visible or weather.is_keyed(track.field):
                menu = "rain menu" if track is TRACKS[0] else ""
                corner_of_row, row_height = _begin_row(track.title, track.help, titles, width, menu)
                track_row(editor.document, playback, editor.rain_tracks, track, corner_of_row, width, row_height)
                _end_row(corner_of_row, titles, width, row_height)
        for row in track_rows(editor.rollouts.displayed_scene):
            _row(playback, row, titles, width, hues.PRESENT, 0.25)
        imgui.pop_style_var()
        if io.key_shift and io.mouse_wheel and imgui.is_window_hovered():
            imgui.set_scroll_y(imgui.get_scroll_y() - io.mouse_wheel * imgui.get_text_line_height())
        _keyframe_menu(playback, editor.document, editor.camera_path)
        track_menu(editor.rain_tracks, editor.document)
        rain_menu(editor)
        _playhead(playback, ImVec2(corner.x + titles, corner.y), width, height, with_head=False)
    imgui.end_child()
    # Zoom with the wheel and pan with the middle button, over ruler and rows.
    x = imgui.get_mouse_pos().x - corner.x - titles
    if imgui.is_window_hovered(imgui.HoveredFlags_.child_windows) and 0 <= x <= ruler.width_px:
        if io.mouse_wheel and not io.key_shift:
            ruler.zoom(io.mouse_wheel, x)
        if imgui.is_mouse_dragging(imgui.MouseButton_.middle, 0):
            ruler.pan(io.mouse_delta.x)


def _camera_row(editor: Editor, titles_px: float, width: float) -> None:
    playback = editor.playback
    corner, height = _begin_row("camera", "Keyframes of the camera path.", titles_px, width)
    if (path := editor.document.scene.path) is None:
        place = ImVec2(corner.x + 32, corner.y + 0.12 * height)
        words = _HINTS[imgui.calc_text_size(_HINTS[0]).x > width - 32]
        imgui.get_window_draw_list().add_text(place, color(hues.DIM), words)
    else:
        _bar(playback, corner, height, (path.start_s, path.end_s), hues.FLIGHT, 0.4)
        for span_s in speed_of(editor.viewport.path).implausible_spans:
            _bar(playback, corner, height, span_s, hues.TOO_FAST, 0.4)
        _keyframes(playback, editor.camera_path, path, corner, width, height)
    _end_row(corner, titles_px, width, height)


def _row(playback: Playback, row: TimelineRow, titles_px: float, width: float, hue: ImVec4, inset: float) -> None:
    corner, height = _begin_row(row.title, row.help, titles_px, width)
    for span_s in row.spans_s:
        _bar(playback, corner, height, span_s, hue, inset)
    draw = imgui.get_window_draw_list()
    for moment in row.keys_s:
        at = ImVec2(corner.x + playback.timeline.ruler.x(moment), corner.y + height / 2)
        draw.add_circle_filled(at, _DOT_PX + 1, color(hues.OUTLINE))
        draw.add_circle_filled(at, _DOT_PX, color(hues.RAIN))
    _end_row(corner, titles_px, width, height)


def _begin_row(title: str, help_text: str, titles_px: float, width: float, menu: str = "") -> tuple[ImVec2, float]:
    """Draw title and background of a row; the rest is clipped to the part right of the titles.

    A click on the title opens the popup `menu`, if there is one.
    """
    start, height = imgui.get_cursor_screen_pos(), _ROW_EM * imgui.get_font_size()
    draw, corner = imgui.get_window_draw_list(), ImVec2(start.x + titles_px, start.y)
    if imgui.invisible_button(f"row {title}", ImVec2(titles_px - 4, height)) and menu:
        imgui.open_popup(menu)
    hue = color(hues.KEY if menu and imgui.is_item_hovered() else hues.TEXT)
    imgui.set_item_tooltip(f"{title}: {help_text}" + ("\nClick: menu of all rain keyframes." if menu else ""))
    draw.push_clip_rect(start, ImVec2(corner.x - 4, start.y + height), True)
    draw.add_text(
        ImVec2(start.x + 4, start.y + 0.15 * height), hue, f"{title} {_FA.ICON_FA_CARET_DOWN if menu else ''}"
    )
    draw.pop_clip_rect()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    draw.add_rect_filled(corner, ImVec2(corner.x + width, corner.y + height - 1), color(hues.STRIPE))
    return corner, height


def _bar(
    playback: Playback, corner: ImVec2, height: float, span_s: tuple[float, float], hue: ImVec4, inset: float
) -> None:
    x0, x1 = (corner.x + playback.timeline.ruler.x(each) for each in span_s)
    top, low = corner.y + inset * height, corner.y + (1 - inset) * height
    imgui.get_window_draw_list().add_rect_filled(ImVec2(x0, top), ImVec2(max(x1, x0 + 2), low), color(hue), 2.0)


def _end_row(corner: ImVec2, titles_px: float, width: float, height: float) -> None:
    imgui.get_window_draw_list().pop_clip_rect()
    imgui.set_cursor_screen_pos(ImVec2(corner.x - titles_px, corner.y))
    imgui.dummy(ImVec2(titles_px + width, height))


# Camera keyframes

_DRAG_PX = 3.0
_APART_PX = 3.0
"""Minimum distance: imported paths have thousands of keyframes, so closer ones are hidden until zoomed in."""


def _keyframes(
    playback: Playback, camera_path: CameraPathEditor, path: CameraPath, corner: ImVec2, width: float, height: float
) -> None:
    """Draw the keyframes into their row: click goes to one, drag moves it in time, Ctrl+drag copies it."""
    last_x, active = -KEY_RADIUS - _APART_PX, camera_path.active_key
    for key, moment in enumerate(path.times_s.tolist()):
        x = playback.timeline.ruler.x(moment)
        if key == active or last_x + _APART_PX <= x <= width + KEY_RADIUS:
            last_x = x
            _keyframe(playback, camera_path, key, moment, ImVec2(corner.x + x, corner.y + height / 2))
    _drag(playback, camera_path)


def _keyframe(playback: Playback, camera_path: CameraPathEditor, key: int, moment: float, at: ImVec2) -> None:
    hovered = key_handle(f"key {key}", at)
    if imgui.is_item_activated():
        camera_path.begin_drag(key, copies=imgui.get_io().key_ctrl)
    if hovered and imgui.is_mouse_clicked(_RIGHT):
        playback.timeline.key = key
        imgui.open_popup("key menu")
    if playback.timeline.drag is None:
        imgui.set_item_tooltip(
            f"Keyframe {key + 1} at {moment:.2f} s. Click: look through it. Drag: move in time. Ctrl+drag: copy. "
            "Delete: remove. Right click: menu."
        )
    radius = KEY_RADIUS + (1.5 if hovered else 0)
    draw_key(at, radius, camera_path.easing_of(key), is_chosen=camera_path.active_key == key)


def _drag(playback: Playback, camera_path: CameraPathEditor) -> None:
    """Continue a drag of a keyframe in this row; keyframe numbers change during the drag."""
    timeline = playback.timeline
    if timeline.drag is None or timeline.drag.in_view:
        return
    moved = imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX).x
    if moved:
        timeline.drag = timeline.drag._replace(has_moved=True)
    if timeline.drag.has_moved:
        camera_path.drag_in_time(timeline.ruler.seconds(moved))
        imgui.set_tooltip(f"{camera_path.active_time_s:.2f} s")
    if not imgui.is_mouse_down(_LEFT):
        key, has_moved = timeline.drag.key, timeline.drag.has_moved
        camera_path.end_drag()
        if not has_moved:
            camera_path.go_to_keyframe(key)


def _keyframe_menu(playback: Playback, document: Document, camera_path: CameraPathEditor) -> None:
    """Draw the context menu of a keyframe, in the window of the keyframes."""
    if not imgui.begin_popup("key menu"):
        return
    if (key := camera_path.active_key) is not None:
        if menu_item("Look through it", "Follow path, stopped at this keyframe."):
            camera_path.go_to_keyframe(key)
        if menu_item("Update from the view", "Set this keyframe to the present view."):
            camera_path.update_keyframe(key)
        if menu_item("Copy to the present time", "Insert the same camera at the playhead."):
            camera_path.copy_keyframe(key, playback.clock.time_s)
        if menu_item("Move to the present time", "Move this keyframe to the playhead."):
            camera_path.retime_keyframe(key, playback.clock.time_s)
        if menu_item("Snap to recorded drive", "Move it to the nearest pose of the recorded drive."):
            camera_path.snap_keyframe(key)
        if menu_item("Copy", "Copy the camera (Ctrl+C); Ctrl+V pastes it at the playhead."):
            camera_path.copy(key)
        imgui.separator()
        easing_items(camera_path.easing_of(key), lambda easing: camera_path.ease(key, easing), "As the path")
        imgui.separator()
        if menu_item("Delete", "Delete this keyframe."):
            camera_path.delete_keyframe(key)
    imgui.end_popup()


# Numbers of the active keyframe, else of the whole path

_WHOLE_PATH_HELP = "Show speed, easing and the other numbers of the whole path."


def _keyframe_numbers(editor: Editor, path: CameraPath, key: int) -> None:
    document, camera_path = editor.document, editor.camera_path
    label_before(f"Keyframe {key + 1}/{len(path.times_s)}", "Time of the keyframe in seconds, on a whole frame.")
    imgui.set_next_item_width(0.5 * imgui.get_content_region_avail().x - 3)
    typed = typed_seconds("##key time", float(path.times_s[key]))
    if typed is not None:
        camera_path.retime_keyframe(key, typed)
    imgui.same_line(spacing=6)
    if button("Whole path", _WHOLE_PATH_HELP, width=-1):
        editor.playback.timeline.key = None
    help_text = "Position in the world: x, y, z in meters, z is up. Ctrl+click types a number."
    label_before("Position", help_text)
    position = editor.viewport.path.positions[key].tolist()
    changed, moved = imgui.drag_float3("##key place", position, 0.02, 0, 0, "%.2f")
    imgui.set_item_tooltip(help_text)
    if changed:
        position_m = np.array(moved, np.float64)
        camera_path.place_keyframe(key, "Move keyframe", position_m=position_m, gesture="key place")
    end_gesture_when_released(document)
    help_text = "Heading from +x to +y, pitch upward, and roll to the right, in degrees."
    label_before("Angles", help_text)
    angles = list(camera_path.key_angles(key))
    changed, angles = imgui.drag_float3("##key look", angles, 0.1, 0, 0, "%.1f\u00b0")
    imgui.set_item_tooltip(help_text)
    if changed:
        camera_path.place_keyframe(key, "Turn keyframe", look=ViewAngles(*angles), gesture="key look")
    end_gesture_when_released(document)
    fov = float(path.vertical_fov_deg[key])
    label_before("Field of view", "Vertical, in degrees; and the equivalent focal length on 35 mm film.")
    half = 0.5 * imgui.get_content_region_avail().x - 3
    imgui.set_next_item_width(half)
    changed, angle = imgui.drag_float("##key fov", fov, 0.1, 2, 150, "%.1f\u00b0", CLAMPED)
    imgui.set_item_tooltip("Vertical field of view in degrees.")
    _set_fov(document, camera_path, key, angle if changed else None, "key fov")
    imgui.same_line(spacing=6)
    imgui.set_next_item_width(half)
    changed, focal = imgui.drag_float("##key focal", focal_length_mm(fov), 0.1, 4, 600, "%.1f mm", CLAMPED)
    imgui.set_item_tooltip("Focal length in mm with the same vertical field of view on 35 mm film.")
    _set_fov(document, camera_path, key, fov_of_focal_length(focal) if changed else None, "key focal")


def _set_fov(document: Document, camera_path: CameraPathEditor, key: int, fov_deg: float | None, gesture: str) -> None:
    if fov_deg is not None:
        camera_path.place_keyframe(key, "Change field of view", vertical_fov_deg=fov_deg, gesture=gesture)
    end_gesture_when_released(document)


def _path_numbers(editor: Editor, path: CameraPath | None) -> None:
    viewport, camera_path = editor.viewport, editor.camera_path
    displayed = path or viewport.path
    with disabled(path is None):
        label_before("Curve, easing", "Interpolation between keyframes, and easing.")
        half = 0.5 * imgui.get_content_region_avail().x - 3
        imgui.set_next_item_width(half)
        help_text = "spline: smooth through all keyframes. linear: straight, at constant speed between keyframes."
        _choice(camera_path, "Interpolation", "interpolation", get_args(Interpolation), displayed, help_text)
        imgui.same_line(spacing=6)
        imgui.set_next_item_width(half)
        help_text = "Easing. none: constant speed. in and out: slow at both ends. at each key: stop at every keyframe."
        _choice(camera_path, "Easing", "easing", get_args(Easing), displayed, help_text)
        help_text = "Duration of the path in seconds: scales the times of all keyframes."
        label_before("Path duration", help_text)
        imgui.set_next_item_width(half)
        typed = typed_seconds("##duration", displayed.duration_s)
        imgui.set_item_tooltip(help_text)
        if typed is not None:
            camera_path.stretch_path(typed)
        imgui.same_line(spacing=6)
        help_text = "Continue from the last keyframe to the first, in the mean time of the other intervals."
        if (loop := checkbox("Closed###loop", displayed.loop, help_text)) != displayed.loop:
            camera_path.change_path("Closed path on" if loop else "Closed path off", loop=loop)
    speed, t = speed_of(viewport.path), editor.playback.clock.time_s
    ego = ego_speed_km_h(editor.rollouts.displayed_scene, t)
    now = 3.6 * float(np.linalg.norm(viewport.path.velocity(t)))
    imgui.text(f"{speed.length_m:.1f} m, {speed.mean_km_h:.0f} km/h, at most {speed.fastest_km_h:.0f} km/h")
    imgui.set_item_tooltip("Length, mean speed and maximum speed of the path.")
    vehicle = "recording vehicle" if editor.rollouts.playing is None else "ego vehicle"
    imgui.text(f"Now {now:.1f} km/h" + (f"   {vehicle} {ego:.1f} km/h" if ego is not None else ""))
    imgui.set_item_tooltip(f"Speed of the path camera, and of the {vehicle}, at the present time.")
    if speed.warning is not None:
        with text_color(error_color()):
            imgui.text_wrapped(speed.warning)


def _choice(
    camera_path: CameraPathEditor, title: str, field: str, choices: tuple[str, ...], path: CameraPath, help_text: str
) -> None:
    present = getattr(path, field)
    if (picked := combo(f"##{field}", present, choices, help_text)) != present:
        camera_path.change_path(f"{title}: {picked}", **{field: picked})

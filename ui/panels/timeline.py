"""Timeline: camera keyframes, numbers, path menu, rows, ruler and transport bar."""

from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor import camera_path
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.timeline import TimelineRow, ego_speed_km_h, speed_of, track_rows, weather_row
from gsrain_engine.scene.camera_path import CameraPath, Easing, Interpolation
from gsrain_engine.scene.camera_path_edit import ViewAngles, focal_length_mm, fov_of_focal_length

from ..widgets.draw import (
    CHOSEN,
    DIM,
    FAINT,
    FLIGHT,
    KEY,
    OUTLINE,
    PLAYED,
    PLAYHEAD,
    PRESENT,
    RAIN,
    STRIPE,
    TEXT,
    TOO_FAST,
    color,
)
from ..widgets.fields import ask_what_to_open, ask_where_to_save, end_gesture_when_released, plain_label
from ..widgets.text import label

_RADIUS = 6.5
_LEFT, _RIGHT = imgui.MouseButton_.left, imgui.MouseButton_.right
_DRAG_PX = 3.0
_APART_PX = 3.0
"""Minimum distance: imported paths have thousands of keyframes, so closer ones are hidden until zoomed in."""


def camera_keyframes(session: Editor, corner: ImVec2, width: float, height: float) -> None:
    """Draw the camera path's keyframes into a row: click goes to one, drag moves it in time, Ctrl+drag copies it."""
    path, ruler = session.scene.path, session.timeline.ruler
    if path is None:
        return
    last_x, chosen = -_RADIUS - _APART_PX, camera_path.active_keyframe(session)
    for key, moment in enumerate(path.times_s.tolist()):
        x = ruler.x(moment)
        if key == chosen or last_x + _APART_PX <= x <= width + _RADIUS:
            last_x = x
            _key(session, key, moment, ImVec2(corner.x + x, corner.y + height / 2))
    _drag(session)


def keyframe_menu(session: Editor) -> None:
    """Draw the context menu of a keyframe, in the window of the keyframes."""
    if not imgui.begin_popup("key menu"):
        return
    key = camera_path.active_keyframe(session)
    if key is not None:
        if _item("Look through it", "Ride along, stopped at this key."):
            camera_path.go_to_keyframe(session, key)
        if _item("Update from the view", "Give this key what the view shows."):
            camera_path.update_keyframe(session, key)
        if _item("Copy to the present time", "Put the same camera at the playhead."):
            camera_path.copy_keyframe(session, key, session.clock.time_s)
        if _item("Move to the present time", "Move this key to the playhead."):
            camera_path.retime_keyframe(session, key, session.clock.time_s)
        if _item("Snap to the drive", "Lay it onto the nearest place of the recorded drive, looking as it does there."):
            camera_path.snap_keyframe(session, key)
        imgui.separator()
        if _item("Delete", "Take this key away."):
            camera_path.delete_keyframe(session, key)
    imgui.end_popup()


def _key(session: Editor, key: int, moment: float, at: ImVec2) -> None:
    imgui.set_cursor_screen_pos(ImVec2(at.x - _RADIUS, at.y - _RADIUS))
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button(f"key {key}", ImVec2(2 * _RADIUS, 2 * _RADIUS))
    hovered = imgui.is_item_hovered()
    if imgui.is_item_activated():
        camera_path.begin_drag(session, key, copies=imgui.get_io().key_ctrl)
    if hovered and imgui.is_mouse_clicked(_RIGHT):
        session.timeline.key = key
        imgui.open_popup("key menu")
    if session.timeline.drag is None:
        imgui.set_item_tooltip(
            f"Camera key {key + 1} at {moment:.2f} s. Click: look through it. Drag: move in time. Ctrl+drag: copy. "
            "Delete: remove. Right click: more."
        )
    draw, is_chosen = imgui.get_window_draw_list(), camera_path.active_keyframe(session) == key
    r = _RADIUS + (1.5 if hovered else 0)
    for size, hue in ((r + 1.5, OUTLINE), (r, CHOSEN if is_chosen else KEY)):
        left, right = ImVec2(at.x - size, at.y), ImVec2(at.x + size, at.y)
        draw.add_quad_filled(left, ImVec2(at.x, at.y - size), right, ImVec2(at.x, at.y + size), color(hue))


def _drag(session: Editor) -> None:
    """Continue a drag of a keyframe in this row; keyframe numbers change during the drag."""
    timeline = session.timeline
    if timeline.drag is None or timeline.drag.in_view:
        return
    moved = imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX).x
    if moved:
        timeline.drag = timeline.drag._replace(has_moved=True)
    if timeline.drag.has_moved:
        camera_path.drag_in_time(session, timeline.ruler.seconds(moved))
        imgui.set_tooltip(f"{camera_path.active_keyframe_time(session):.2f} s")
    if not imgui.is_mouse_down(_LEFT):
        key, has_moved = timeline.drag.key, timeline.drag.has_moved
        camera_path.end_drag(session)
        if not has_moved:
            camera_path.go_to_keyframe(session, key)


def _item(name: str, help_text: str) -> bool:
    clicked, _ = imgui.menu_item(name, "", False)
    imgui.set_item_tooltip(help_text)
    return clicked


# Numbers of the active keyframe, else of the whole path

_TOO_FAST = (0.95, 0.45, 0.38, 1.0)
_LABEL_EM = 6.5


def keyframe_number_fields(session: Editor) -> None:
    key, path = camera_path.active_keyframe(session), session.scene.path
    if path is not None and key is not None:
        _keyframe(session, path, key)
    else:
        _path(session, path)


def _keyframe(session: Editor, path: CameraPath, key: int) -> None:
    _label(f"Key {key + 1} of {len(path.times_s)}", "Moment of the key in seconds, on a frame of the film.")
    imgui.set_next_item_width(0.5 * imgui.get_content_region_avail().x - 3)
    typed = typed_number("##key time", float(path.times_s[key]), "%.2f s")
    if typed is not None:
        camera_path.retime_keyframe(session, key, typed)
    imgui.same_line(spacing=6)
    if imgui.button("Whole path", ImVec2(-1, 0)):
        session.timeline.key = None
    imgui.set_item_tooltip("Show speed, easing and the other numbers of the path as a whole.")
    words = "Place of the key in the world: x, y, z in metres, z is up. Ctrl+click types a number."
    _label("Place", words)
    place = session.path.positions[key]
    changed, moved = imgui.drag_float3("##key place", place.tolist(), 0.02, 0, 0, "%.2f")
    imgui.set_item_tooltip(words)
    if changed:
        camera_path.place_keyframe(
            session, key, "Move camera key", position_m=np.array(moved, np.float64), gesture="key place"
        )
    end_gesture_when_released(session)
    _look(session, key)
    _lens(session, path, key)


def _look(session: Editor, key: int) -> None:
    words = "Heading from +x to +y, pitch upwards, and roll to the right; degrees."
    _label("Angles", words)
    changed, angles = imgui.drag_float3(
        "##key look", list(camera_path.key_angles(session, key)), 0.1, 0, 0, "%.1f\u00b0"
    )
    imgui.set_item_tooltip(words)
    if changed:
        camera_path.place_keyframe(session, key, "Turn camera key", look=ViewAngles(*angles), gesture="key look")
    end_gesture_when_released(session)


def _lens(session: Editor, path: CameraPath, key: int) -> None:
    fov = float(path.vertical_fov_deg[key])
    _label("Field of view", "Vertical, in degrees; and the focal length that sees as much on 35 mm film.")
    half = 0.5 * imgui.get_content_region_avail().x - 3
    imgui.set_next_item_width(half)
    flags = imgui.SliderFlags_.always_clamp
    changed, angle = imgui.drag_float("##key fov", fov, 0.1, 2, 150, "%.1f\u00b0", flags)
    imgui.set_item_tooltip("Vertical field of view in degrees.")
    if changed:
        camera_path.place_keyframe(session, key, "Field of view of a key", vertical_fov_deg=angle, gesture="key fov")
    end_gesture_when_released(session)
    imgui.same_line(spacing=6)
    imgui.set_next_item_width(half)
    changed, focal = imgui.drag_float("##key focal", focal_length_mm(fov), 0.1, 4, 600, "%.1f mm", flags)
    imgui.set_item_tooltip("Focal length in mm of the lens that sees as much from top to bottom on 35 mm film.")
    if changed:
        angle = fov_of_focal_length(focal)
        camera_path.place_keyframe(session, key, "Field of view of a key", vertical_fov_deg=angle, gesture="key focal")
    end_gesture_when_released(session)


def _path(session: Editor, path: CameraPath | None) -> None:
    imgui.begin_disabled(path is None)
    shown = path or session.path
    _label("Way, easing", "What lies between the keys.")
    half = 0.5 * imgui.get_content_region_avail().x - 3
    imgui.set_next_item_width(half)
    _choice(session, "Way between keys", "interpolation", get_args(Interpolation), shown,
            "spline: smooth through all keys. linear: straight, at constant speed from key to key.")  # fmt: skip
    imgui.same_line(spacing=6)
    imgui.set_next_item_width(half)
    _choice(session, "Easing", "easing", get_args(Easing), shown,
            "none: even. in and out: sets off and arrives gently. at each key: rests at every key.")  # fmt: skip
    _label("Loop, takes", "Fly from the last key on to the first; and how many seconds the flight takes.")
    changed, loop = imgui.checkbox("##loop", shown.loop)
    imgui.set_item_tooltip("Fly from the last key on to the first, in as long as the other intervals take on average.")
    if changed:
        camera_path.change_path(session, "Loop on" if loop else "Loop off", loop=loop)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    typed = typed_number("##duration", shown.duration_s, "%.2f s")
    imgui.set_item_tooltip("Seconds that the flight takes: all keys move apart or together.")
    if typed is not None:
        camera_path.stretch_path(session, typed)
    imgui.end_disabled()
    _read_out(session)


def _choice(session: Editor, title: str, field: str, choices: tuple[str, ...], path: CameraPath, words: str) -> None:
    changed, picked = imgui.combo(f"##{field}", choices.index(getattr(path, field)), list(choices))
    imgui.set_item_tooltip(words)
    if changed:
        camera_path.change_path(session, f"{title}: {choices[picked]}", **{field: choices[picked]})


def _read_out(session: Editor) -> None:
    speed, t = speed_of(session.path), session.clock.time_s
    ego = ego_speed_km_h(session.displayed_scene, t)
    now = 3.6 * float(np.linalg.norm(session.path.velocity(t)))
    imgui.text(f"{speed.length_m:.1f} m, {speed.mean_km_h:.0f} km/h, at most {speed.fastest_km_h:.0f} km/h")
    imgui.set_item_tooltip("Length of the flight, its mean and its highest speed.")
    imgui.text(f"now {now:.1f} km/h" + (f"   ego vehicle {ego:.1f} km/h" if ego is not None else ""))
    imgui.set_item_tooltip("Speed of the flying camera, and of the recording vehicle, at the present time.")
    if speed.warning is not None:
        imgui.push_style_color(imgui.Col_.text, _TOO_FAST)
        imgui.text_wrapped(speed.warning)
        imgui.pop_style_color()


def _label(text: str, help_text: str) -> None:
    plain_label(text, help_text)
    imgui.same_line(_LABEL_EM * imgui.get_font_size())


# Camera path menu

_FRAME_RATES = (10.0, 24.0, 25.0, 30.0, 50.0, 60.0)
_JSON = "Camera paths{.json},All files{.*}"


def path_menu(session: Editor) -> None:
    if icon_button(
        f"Path {icons_fontawesome_6.ICON_FA_CARET_DOWN}", "path", "Files, the drive, and the path as a whole."
    ):
        imgui.open_popup("path menu")
    if imgui.begin_popup("path menu"):
        _files(session)
        imgui.separator()
        _drives(session)
        if _menu_item(
            "Circle around the target", "A loop of 12 s from this view on, around the point that a left drag orbits."
        ):
            camera_path.circle_target(session)
        imgui.separator()
        _whole(session)
        imgui.end_popup()


def ask_for_import(session: Editor) -> None:
    ask_what_to_open("Import a camera path", _JSON, lambda chosen: camera_path.import_path(session, chosen[0]))


def ask_for_export(session: Editor) -> None:
    ask_where_to_save("Export the camera path", _JSON, lambda chosen: camera_path.export_path(session, chosen[0]))


def _files(session: Editor) -> None:
    if _menu_item("Import...", "Read a camera path: ours, nerfstudio's camera_path.json, or 3DGS's cameras.json."):
        ask_for_import(session)
    if not imgui.begin_menu("Export"):
        return
    if _menu_item("Keys (GSRAIN)...", "Keys and what lies between them: reads back as it is."):
        ask_for_export(session)
    if _menu_item("Every frame (nerfstudio)...", "A camera_path.json as ns-render reads it, at the film's frame rate."):
        title = "Export for nerfstudio"
        ask_where_to_save(title, _JSON, lambda chosen: camera_path.export_path(session, chosen[0], "nerfstudio"))
    if _menu_item(
        "Every frame (3DGS cameras.json)...", "A list of cameras at the film's frame rate; it knows no times."
    ):
        title = "Export as 3DGS cameras"
        ask_where_to_save(title, _JSON, lambda chosen: camera_path.export_path(session, chosen[0], "training cameras"))
    imgui.end_menu()


def _drives(session: Editor) -> None:
    cameras = camera_path.rig_cameras(session)
    if not imgui.begin_menu("From the drive", bool(cameras)):
        imgui.set_item_tooltip("Fly as a camera of the recording vehicle did. This scene has no such vehicle.")
        return
    for number, camera in enumerate(cameras):
        if imgui.begin_menu(label(camera.name, str(number))):
            if _menu_item("Few keys", "As few keys as stay within 5 cm and half a degree of the drive."):
                camera_path.path_from_drive(session, camera)
            for seconds in (0.5, 1.0, 2.0):
                if _menu_item(f"A key every {seconds:g} s", "Keys at even distances in time."):
                    camera_path.path_from_drive(session, camera, seconds)
            imgui.end_menu()
    imgui.end_menu()


def _whole(session: Editor) -> None:
    if imgui.begin_menu("Frames a second"):
        for fps in _FRAME_RATES:
            if imgui.menu_item(f"{fps:g}", "", session.timeline.fps == fps)[0]:
                session.timeline.fps = fps
        imgui.end_menu()
    imgui.set_item_tooltip("Of the film: keys and steps keep to its frames; exports write each of them.")
    has_path = session.scene.path is not None
    if _menu_item("Reverse", "Fly the same way backwards.", possible=has_path):
        camera_path.reverse_path(session)
    if _menu_item("Delete all keys", "Ride along takes the scene's own way again.", possible=has_path):
        camera_path.delete_path(session)


def _menu_item(name: str, help_text: str, *, possible: bool = True) -> bool:
    clicked, _ = imgui.menu_item(name, "", False, possible)
    imgui.set_item_tooltip(help_text)
    return clicked


# Rows: camera keyframes, rain keyframes, and lifetimes of actors

ROW_EM = 1.3
_ROW_RADIUS = 4.0


def rows(session: Editor, titles_px: float, width: float) -> None:
    _camera(session, titles_px, width)
    ruler, weather = session.timeline.ruler, session.weather
    last_s = ruler.first_s + ruler.visible_span_s
    if weather.keys:
        _row(session, weather_row(weather, ruler.first_s, last_s, int(width / 6)), titles_px, width, is_rain=True)
    for row in track_rows(session.displayed_scene):
        _row(session, row, titles_px, width)


def _camera(session: Editor, titles_px: float, width: float) -> None:
    corner, height = _begin("camera", "Keys of the camera path.", titles_px, width)
    draw, ruler, path = imgui.get_window_draw_list(), session.timeline.ruler, session.scene.path
    if path is None:
        hint = "No keys yet: find a view, press K; go on in time, find another, press K again."
        draw.add_text(ImVec2(corner.x + 32, corner.y + 0.12 * height), color(DIM), hint)
    else:
        spans = [(path.start_s, path.end_s, FLIGHT)]
        spans += [(first, last, TOO_FAST) for first, last in speed_of(session.path).implausible_spans]
        for first, last, hue in spans:
            x0, x1 = corner.x + ruler.x(first), corner.x + ruler.x(last)
            draw.add_rect_filled(
                ImVec2(x0, corner.y + 0.4 * height), ImVec2(max(x1, x0 + 2), corner.y + 0.6 * height), color(hue), 2.0
            )
        camera_keyframes(session, corner, width, height)
    draw.pop_clip_rect()
    imgui.set_cursor_screen_pos(ImVec2(corner.x - titles_px, corner.y))
    imgui.dummy(ImVec2(titles_px + width, height))


def _row(session: Editor, row: TimelineRow, titles_px: float, width: float, *, is_rain: bool = False) -> None:
    corner, height = _begin(row.title, row.help, titles_px, width)
    draw, ruler = imgui.get_window_draw_list(), session.timeline.ruler
    inset = 0.4 if is_rain else 0.25
    for first, last in row.spans_s:
        x0, x1 = corner.x + ruler.x(first), corner.x + ruler.x(last)
        top, low = corner.y + inset * height, corner.y + (1 - inset) * height
        draw.add_rect_filled(ImVec2(x0, top), ImVec2(max(x1, x0 + 2), low), color(FLIGHT if is_rain else PRESENT), 2.0)
    for moment in row.keys_s:
        at = ImVec2(corner.x + ruler.x(moment), corner.y + height / 2)
        draw.add_circle_filled(at, _ROW_RADIUS + 1, color(OUTLINE))
        draw.add_circle_filled(at, _ROW_RADIUS, color(RAIN))
    draw.pop_clip_rect()
    imgui.set_cursor_screen_pos(ImVec2(corner.x - titles_px, corner.y))
    imgui.dummy(ImVec2(titles_px + width, height))


def _begin(title: str, help_text: str, titles_px: float, width: float) -> tuple[ImVec2, float]:
    """Draw title and background of a row; the rest is clipped to the part right of the titles."""
    start, height = imgui.get_cursor_screen_pos(), ROW_EM * imgui.get_font_size()
    draw, corner = imgui.get_window_draw_list(), ImVec2(start.x + titles_px, start.y)
    imgui.invisible_button(f"row {title}", ImVec2(titles_px - 4, height))
    imgui.set_item_tooltip(f"{title}: {help_text}")
    draw.push_clip_rect(start, ImVec2(corner.x - 4, start.y + height), True)
    draw.add_text(ImVec2(start.x + 4, start.y + 0.15 * height), color(TEXT), title)
    draw.pop_clip_rect()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    draw.add_rect_filled(corner, ImVec2(corner.x + width, corner.y + height - 1), color(STRIPE))
    return corner, height


# Ruler

HEIGHT_EM = 1.7
_LABELS_APART_EM = 4.5
_MARKS_APART_PX = 7.0
_GRIP = 5.0

_HELP = (
    "Seconds of the scene. Drag: go to a moment. Wheel: zoom. Middle drag: move along. Double click: show all.\n"
    "Over the rows below, Shift+wheel scrolls."
)


def time_ruler(session: Editor, width: float) -> None:
    """Draw the ruler at the cursor, and scrub while it is dragged."""
    corner, height = imgui.get_cursor_screen_pos(), HEIGHT_EM * imgui.get_font_size()
    ruler = session.timeline.ruler
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button("ruler", ImVec2(width, height))
    imgui.set_item_tooltip(_HELP)
    if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        ruler.fit(*session.span_s)
    elif imgui.is_item_active() and not imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        session.clock.seek(camera_path.nearest_frame_time(session, ruler.time(imgui.get_mouse_pos().x - corner.x)))
    _marks(session, corner, width, height)
    _span(session, corner, width, height)
    imgui.set_cursor_screen_pos(corner)
    imgui.dummy(ImVec2(width, height))


def playhead(session: Editor, corner: ImVec2, width: float, height: float, *, with_head: bool) -> None:
    x = session.timeline.ruler.x(session.clock.time_s)
    if not -1 <= x <= width + 1:
        return
    draw, at = imgui.get_window_draw_list(), corner.x + x
    draw.add_line(ImVec2(at, corner.y), ImVec2(at, corner.y + height), color(PLAYHEAD), 1.5)
    if with_head:
        low = corner.y + height
        draw.add_triangle_filled(ImVec2(at - 6, low - 9), ImVec2(at + 6, low - 9), ImVec2(at, low), color(PLAYHEAD))


def _marks(session: Editor, corner: ImVec2, width: float, height: float) -> None:
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


def _span(session: Editor, corner: ImVec2, width: float, height: float) -> None:
    """Draw the playback range, with a handle at either end."""
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
            camera_path.set_span(session, name == "span start", ruler.time(imgui.get_mouse_pos().x - corner.x))
        if hovered and imgui.is_mouse_clicked(imgui.MouseButton_.right):
            session.clock.span_s = None
        top = low - (11 if held or hovered else 8)
        draw.add_rect_filled(ImVec2(x - 2, top), ImVec2(x + 2, low), color(PLAYED), 1.0)


# Transport bar

_FA = icons_fontawesome_6
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_GAP = 18.0


def transport(session: Editor) -> None:
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


def _speed(session: Editor) -> None:
    imgui.set_next_item_width(4.2 * imgui.get_font_size())
    speed = session.clock.speed
    if imgui.begin_combo("##speed", f"{speed:g}\u00d7"):
        for each in _SPEEDS:
            if imgui.selectable(f"{each:g}\u00d7", each == speed)[0]:
                session.clock.speed = each
        imgui.end_combo()
    imgui.set_item_tooltip("How fast time plays, in seconds of the scene a second. Recordings don't care.")


def _time(session: Editor, end: float) -> None:
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


def _keys(session: Editor) -> None:
    key = camera_path.active_keyframe(session)
    words = "Keep what the view shows as a camera key at the present time (K). Shift+K: after the last key."
    if icon_button(f"{_FA.ICON_FA_PLUS} Key", "add key", words):
        camera_path.add_keyframe(session)
    imgui.begin_disabled(key is None)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_CAMERA, "update key", "Give the chosen key what the view shows.") and key is not None:
        camera_path.update_keyframe(session, key)
    imgui.same_line()
    if icon_button(_FA.ICON_FA_TRASH, "delete key", "Delete the chosen key (Delete).") and key is not None:
        camera_path.delete_keyframe(session, key)
    imgui.end_disabled()


# Small buttons


def icon_button(icon: str, name: str, help_text: str) -> bool:
    """Draw a button with a symbol; `name` is its identity for tests and tools."""
    clicked = imgui.button(f"{icon}###{name}")
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        imgui.set_tooltip(help_text)
    return clicked


def typed_number(name: str, value: float, text_format: str) -> float | None:
    """Draw a number field; returns the number when Enter is pressed or the field loses the focus."""
    changed, typed = imgui.input_float(name, value, 0, 0, text_format)
    storage, item = imgui.get_state_storage(), imgui.get_item_id()
    if changed:
        storage.set_float(item, typed)
    return storage.get_float(item, value) if imgui.is_item_deactivated_after_edit() else None


def switch(icon: str, name: str, help_text: str, *, is_on: bool) -> bool:
    color = imgui.Col_.button_active if is_on else imgui.Col_.button
    imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(color))
    clicked = icon_button(icon, name, help_text)
    imgui.pop_style_color()
    return clicked

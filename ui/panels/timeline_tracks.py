"""Tracks of the rain in the Timeline panel: a row with curve and keyframes for each field, numbers, and menus."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import add_shower, replace_keyframes, set_interpolation
from gsrain_engine.editor.rain import CalibrationTools
from gsrain_engine.editor.rain_tracks import RainTracks, Track, TrackKey, track_of
from gsrain_engine.editor.timeline import Playback, Ruler
from gsrain_engine.fields import field_of
from gsrain_engine.rain.keyframes import NO_KEYFRAMES, RainKeyframe
from gsrain_engine.scene.easing import KeyEasing

from ..commands.table import help_of
from ..widgets import draw as hues
from ..widgets.draw import color
from ..widgets.fields import CLAMPED, end_gesture_when_released, menu_item, plain_label
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.numbers import slide, typed_seconds

_LEFT, _RIGHT = imgui.MouseButton_.left, imgui.MouseButton_.right
KEY_RADIUS, _APART_PX, _DRAG_PX = 6.5, 3.0, 3.0
_MENU = "rain key menu"
_LABEL_EM, _NUMBER_EM = 6.5, 12.0
EASING_HELP: dict[KeyEasing, str] = {
    "linear": "Evenly to the next keyframe.",
    "smooth": "Slow at both keyframes.",
    "ease in": "Slow at this keyframe.",
    "ease out": "Slow at the next keyframe.",
    "hold": "These values, until the next keyframe.",
}


def track_row(
    document: Document, playback: Playback, tracks: RainTracks, track: Track, corner: ImVec2, width: float,
    height: float,
) -> None:  # fmt: skip
    """Draw curve and keyframes of a track into its row.

    A click chooses a keyframe, a drag moves it in time, Ctrl+drag copies it; a double click on the row inserts one.
    """
    ruler, times = playback.timeline.ruler, tracks.times_s(track.field)
    imgui.set_cursor_screen_pos(corner)
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button(f"track {track.title}", ImVec2(width, height))
    is_over = imgui.is_item_hovered()
    if not len(times) and is_over:
        at = ImVec2(corner.x + 8, corner.y + 0.12 * height)
        imgui.get_window_draw_list().add_text(at, color(hues.DIM), "Double click: insert a keyframe here.")
    _curve(document, track, ruler, corner, width, height)
    last_x, active = -KEY_RADIUS - _APART_PX, tracks.active
    for number, time_s in enumerate(times.tolist()):
        key, x = TrackKey(track.field, number), ruler.x(time_s)
        if key == active or last_x + _APART_PX <= x <= width + KEY_RADIUS:
            last_x = x
            is_over = _key(tracks, key, time_s, track, ImVec2(corner.x + x, corner.y + height / 2)) and is_over
    _drag(tracks, track, ruler)
    if is_over and imgui.is_mouse_double_clicked(_LEFT):
        tracks.insert(track.field, ruler.time(imgui.get_mouse_pos().x - corner.x))


def track_menu(tracks: RainTracks, document: Document) -> None:
    """Draw the menu of the chosen keyframe, in the window of the tracks."""
    if not imgui.begin_popup(_MENU):
        return
    if (key := tracks.active) is not None:
        track_key_numbers(document, tracks, key)
        imgui.separator()
        easing_items(tracks.easing(key), tracks.ease, "As all rain keyframes")
        imgui.separator()
        if menu_item("Copy", "Copy value and easing (Ctrl+C); Ctrl+V pastes them at the playhead."):
            tracks.copy()
        if menu_item(
            "Paste at the playhead", "Insert the copied keyframe (Ctrl+V).", possible=tracks.copied is not None
        ):
            tracks.paste()
        if menu_item("Delete", "Delete this keyframe (Delete)."):
            tracks.delete()
    imgui.end_popup()


def easing_items(present: KeyEasing | None, ease: Callable[[KeyEasing | None], None], none: str) -> None:
    """Draw menu items of the easings from a keyframe to the next one; `none` is the title of no own one."""
    if imgui.menu_item(none, "", present is None)[0]:
        ease(None)
    for each, help_text in EASING_HELP.items():
        if imgui.menu_item(each.capitalize(), "", present == each)[0]:
            ease(each)
        imgui.set_item_tooltip(help_text)


def track_key_numbers(document: Document, tracks: RainTracks, key: TrackKey) -> None:
    """Edit time and value of a keyframe as numbers."""
    track, value, form = track_of(key.field), tracks.value(key), "%.3f m/s"
    low, high = (track.scale * each for each in field_of(RainKeyframe, key.field).bounds)
    times, width = tracks.times_s(key.field), _NUMBER_EM * imgui.get_font_size()
    label_before(f"{track.title.capitalize()} {key.number + 1}/{len(times)}", "Time of the keyframe in seconds.")
    imgui.set_next_item_width(width)
    if (to_s := typed_seconds("##key time", float(times[key.number]))) is not None:
        tracks.set_time(key, to_s)
        return  # its number may be another one
    label_before("Value", f"{track.help} Drag; double click: type.")
    imgui.set_next_item_width(width)
    if isinstance(value, tuple):
        changed, pair = imgui.drag_float2("##value", list(value), 0.05, low, high, form, CLAMPED)
        value = tuple(pair)
    else:
        changed, value = slide("##value", track.scale * value, low, high, track.form)
        value /= track.scale
    if changed:
        tracks.set_value(key, value, gesture=f"value of {track.title}")
    end_gesture_when_released(document)


def label_before(text: str, help_text: str) -> None:
    """Draw the label of the next widget, in a column of labels."""
    plain_label(text, help_text)
    imgui.same_line(_LABEL_EM * imgui.get_font_size())


# Menu of all rain keyframes

_SERIES_FILES = "Disdrometer files{.nc,.cdf,.dat,.txt,.csv,.log,.mis,.gz},All files{.*}"
_INTERPOLATIONS: dict[Literal["linear", "smooth"], str] = {
    "linear": "Straight lines between keyframes.",
    "smooth": "Smooth, within the values of neighboring keyframes (Fritsch and Carlson, 1980).",
}


def add_passing_shower(document: Document, playback: Playback) -> None:
    """Add a shower that starts now; keyframes of wind and exposure stay."""
    document.edit_keyframes("Add passing shower", add_shower, playback.clock.time_s)
    playback.show_all()


def clear_keyframes(document: Document, playback: Playback) -> None:
    document.edit_keyframes("Clear rain keyframes", replace_keyframes, NO_KEYFRAMES)
    playback.show_all()


def ask_for_rate_file(calibration: CalibrationTools) -> None:
    ask_what_to_open("Import a series", _SERIES_FILES, lambda paths: calibration.read_series(paths[0]))


def rain_menu(editor: Editor) -> None:
    """Draw the menu of all rain keyframes, in the window of the tracks."""
    document, calibration = editor.document, editor.calibration
    if not imgui.begin_popup("rain menu"):
        return
    if menu_item("Add passing shower", help_of("Add passing shower")):
        add_passing_shower(document, editor.playback)
    help_text = help_of("Import disdrometer series...")
    if menu_item("Import disdrometer series...", help_text, possible=calibration.busy is None):
        ask_for_rate_file(calibration)
    imgui.separator()
    present = document.keyframes.between
    for each, help_text in _INTERPOLATIONS.items():
        if imgui.menu_item(each.capitalize(), "", present == each)[0] and present != each:
            document.edit_keyframes(f"Interpolation {each}", set_interpolation, each)
        imgui.set_item_tooltip(help_text)
    imgui.separator()
    if menu_item("Clear rain keyframes", help_of("Clear rain keyframes"), possible=bool(document.keyframes.keys)):
        clear_keyframes(document, editor.playback)
    imgui.end_popup()


# Drawing of tracks


def _curve(document: Document, track: Track, ruler: Ruler, corner: ImVec2, width: float, height: float) -> None:
    """Draw the values of a track between the row's edges, from 0 to their maximum."""
    curve = document.keyframes.curves.get(track.field)
    if curve is None:
        return
    steps = max(int(width / 4), 2)
    seconds = np.linspace(ruler.first_s, ruler.first_s + ruler.visible_span_s, steps)
    sizes = np.linalg.norm(curve.values, axis=1)
    top = float(max(sizes.max(), 1.0 if track.field in ("wetness", "lamp_gain") else 1e-9))
    shares = np.interp(seconds, curve.times_s, sizes) / top
    x, y = np.linspace(0.0, width, steps), height * (0.88 - 0.76 * shares)
    points = [ImVec2(corner.x + a, corner.y + b) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    imgui.get_window_draw_list().add_polyline(points, color(hues.RAIN), 1.5, 0)


def _key(tracks: RainTracks, key: TrackKey, time_s: float, track: Track, at: ImVec2) -> bool:
    """Draw a keyframe and handle its clicks; returns True if the mouse is not over it."""
    hovered = key_handle(f"{track.title} key {key.number}", at)
    if imgui.is_item_activated():
        tracks.begin_drag(key, copies=imgui.get_io().key_ctrl)
    if hovered and imgui.is_mouse_clicked(_RIGHT):
        tracks.choose(key)
        imgui.open_popup(_MENU)
    if tracks.drag is None:
        imgui.set_item_tooltip(
            f"{value_text(track, tracks.value(key))} at {time_s:.2f} s. Drag: move in time. Ctrl+drag: copy.\n"
            "Right click: value, easing and more. Ctrl+C, Ctrl+V, Delete."
        )
    draw_key(at, KEY_RADIUS - 1.5 + (1.5 if hovered else 0), tracks.easing(key), is_chosen=tracks.active == key)
    return not hovered


def key_handle(name: str, at: ImVec2) -> bool:
    """Place an invisible button at a keyframe; returns True if the mouse is over it."""
    imgui.set_cursor_screen_pos(ImVec2(at.x - KEY_RADIUS, at.y - KEY_RADIUS))
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button(name, ImVec2(2 * KEY_RADIUS, 2 * KEY_RADIUS))
    return imgui.is_item_hovered()


def draw_key(at: ImVec2, radius: float, easing: KeyEasing | None, *, is_chosen: bool) -> None:
    """Draw a keyframe: a square if its value is held, a disk if it has another easing of its own, else a diamond."""
    hue, draw = hues.CHOSEN if is_chosen else hues.KEY, imgui.get_window_draw_list()
    if easing in (None, "linear"):
        hues.draw_diamond(at, radius + 1.5, hues.OUTLINE)
        hues.draw_diamond(at, radius, hue)
    elif easing == "hold":
        for side, ink in ((0.8 * radius + 1.2, hues.OUTLINE), (0.8 * radius, hue)):
            draw.add_rect_filled(ImVec2(at.x - side, at.y - side), ImVec2(at.x + side, at.y + side), color(ink))
    else:
        draw.add_circle_filled(at, 0.9 * radius + 1.2, color(hues.OUTLINE))
        draw.add_circle_filled(at, 0.9 * radius, color(hue))


def _drag(tracks: RainTracks, track: Track, ruler: Ruler) -> None:
    drag = tracks.drag
    if drag is None or drag.key.field != track.field:
        return
    if moved := imgui.get_mouse_drag_delta(_LEFT, _DRAG_PX).x:
        tracks.drag_by(ruler.seconds(moved))
    key = tracks.active
    if moved and key is not None:
        imgui.set_tooltip(f"{tracks.times_s(key.field)[key.number]:.2f} s")
    if not imgui.is_mouse_down(_LEFT):
        tracks.end_drag()


def value_text(track: Track, value: float | tuple[float, float]) -> str:
    """Return a keyframe's value with its unit."""
    if isinstance(value, tuple):
        return ", ".join(f"{each:.3g}" for each in value) + " m/s"
    return track.form % (track.scale * value)

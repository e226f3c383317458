"""Rain keyframes panel: plot of the intensity over time, table of keyframes, and import of measured series."""

from functools import lru_cache
from typing import Literal

import numpy as np
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui, implot
from jaxtyping import Float64

from gsrain_engine.disdrometer.rain_rates import MeasuredKeyframes, keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerReading
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import (
    add_shower,
    move_keyframe,
    replace_keyframes,
    set_interpolation,
    set_keyframe_number,
)
from gsrain_engine.editor.rain import CalibrationTools, KeyframePanelState, PendingInput
from gsrain_engine.editor.rain_tracks import TRACKS, Track
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.rain.keyframes import (
    NO_KEYFRAMES,
    RainKeyframe,
    RainKeyframes,
)
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H, HEAVIEST_MM_H

from ..commands.table import help_of
from ..widgets.draw import draw_diamond, on_screen_px
from ..widgets.fields import LOGARITHMIC, button, same_line_if_fits, square_button, toggle_keyframe, warn
from ..widgets.file_dialogs import ask_what_to_open
from .timeline_tracks import value_text

_IMPORT_HELP = "Make keyframes from the rain rates of a disdrometer file, in mm/h, at most 149."
_SERIES_FILES = "Disdrometer files{.nc,.cdf,.dat,.txt,.csv,.log,.mis,.gz},All files{.*}"
_INTERPOLATIONS: tuple[tuple[Literal["linear", "smooth"], str], ...] = (
    ("linear", "Straight lines between keyframes."),
    ("smooth", "Smooth, within the values of neighboring keyframes (Fritsch and Carlson, 1980)."),
)
_MOVE, _REMOVE = "Move rain keyframe", "Remove rain keyframe"  # labels of steps
_WIDE_EM, _NUMBERS_EM = 50.0, 22.0  # panel width from which the table is next to the plot, and the table's width


def rain_keyframes_panel(editor: Editor) -> None:
    document, keyframe_panel = editor.document, editor.keyframe_panel
    room, em = imgui.get_content_region_avail(), imgui.get_font_size()
    is_wide = room.x > _WIDE_EM * em
    _buttons(editor)
    if editor.calibration.series is not None:
        _series(editor, *editor.calibration.series)
    imgui.begin_group()
    _plot(document, editor.playback, keyframe_panel, room.x - _NUMBERS_EM * em if is_wide else room.x)
    imgui.end_group()
    if is_wide:
        imgui.same_line()
    imgui.begin_group()
    weather = document.keyframes
    if weather.keys:
        imgui.align_text_to_frame_padding()
        imgui.text("Interpolation")
        for choice, help_text in _INTERPOLATIONS:
            imgui.same_line()
            if imgui.radio_button(choice, weather.between == choice) and weather.between != choice:
                document.edit_keyframes(f"Interpolation {choice}", set_interpolation, choice)
            imgui.set_item_tooltip(help_text)
        _table(document, keyframe_panel)
    else:
        imgui.text_wrapped("No keyframes: the rain is constant. Double click in the plot to add the first one.")
    imgui.end_group()


def add_passing_shower(document: Document, playback: Playback, keyframe_panel: KeyframePanelState) -> None:
    """Add a shower that starts now; keyframes of wind and exposure stay."""
    document.edit_keyframes("Add passing shower", add_shower, playback.clock.time_s)
    keyframe_panel.refit = True


def clear_keyframes(document: Document) -> None:
    document.edit_keyframes("Clear rain keyframes", replace_keyframes, NO_KEYFRAMES)


def ask_for_rate_file(calibration: CalibrationTools) -> None:
    ask_what_to_open("Import a series", _SERIES_FILES, lambda paths: calibration.read_series(paths[0]))


def _buttons(editor: Editor) -> None:
    document, playback, calibration = editor.document, editor.playback, editor.calibration
    now_s = playback.clock.time_s
    present = document.keyframes.key_at(now_s)
    is_here = present is not None and present.intensity_mm_h is not None
    action = "Remove the keyframe" if is_here else "Insert a keyframe of the present intensity"
    if button(
        "Remove intensity keyframe###now" if is_here else "Insert intensity keyframe###now",
        f"{action} at {now_s:.2f} s.",
    ):
        toggle_keyframe(document, editor.viewport, playback, "intensity_mm_h")
    same_line_if_fits("Add passing shower")
    if button("Add passing shower", help_of("Add passing shower")):
        add_passing_shower(document, playback, editor.keyframe_panel)
    same_line_if_fits("Import disdrometer series...")
    if button("Import disdrometer series...###import", _IMPORT_HELP, enabled=calibration.busy is None):
        ask_for_rate_file(calibration)
    same_line_if_fits("Fit##shower")
    if button(
        f"{icons_fontawesome_6.ICON_FA_MAXIMIZE}###fit shower", "Show all keyframes. Wheel: zoom in time. Drag: pan."
    ):
        editor.keyframe_panel.refit = True
    same_line_if_fits("Clear rain keyframes")
    if button("Clear rain keyframes", help_of("Clear rain keyframes"), enabled=bool(document.keyframes.keys)):
        clear_keyframes(document)
    if calibration.busy is not None:
        imgui.text_disabled(calibration.busy)
    warn(calibration.error)


def _series(editor: Editor, name: str, reading: DisdrometerReading) -> None:
    """Draw the options for importing a disdrometer series."""
    document, calibration, keyframe_panel = editor.document, editor.calibration, editor.keyframe_panel
    imgui.separator_text(name)
    try:
        measured = _keyframes_of(reading, keyframe_panel.speed_up, keyframe_panel.start_s)
    except ValueError as error:
        calibration.series = None
        editor.status.report(f"{name}: {error}")
        return
    imgui.text_wrapped(f"{measured.summary}. Maximum: {measured.weather.heaviest_mm_h(document.rain):.1f} mm/h.")
    width = 5.5 * imgui.get_font_size()
    imgui.set_next_item_width(width)
    _, keyframe_panel.speed_up = imgui.drag_float(
        "Times faster", keyframe_panel.speed_up, 0.5, 1.0, 10_000.0, "%.0f", LOGARITHMIC
    )
    imgui.set_item_tooltip("Compresses time: at 60, a minute of the series takes a second of the scene.")
    imgui.set_next_item_width(width)
    _, keyframe_panel.start_s = imgui.drag_float("Starts at (s)", keyframe_panel.start_s, 0.1, -1e6, 1e6, "%.1f")
    imgui.set_item_tooltip("Time of the first record in the scene, in seconds.")
    if button("Use it", "Replace the present keyframes by the series."):
        document.edit_keyframes(f"Series {name}", replace_keyframes, measured.weather)
        calibration.series, keyframe_panel.refit = None, True
    imgui.same_line()
    if button("Cancel##series", "Do not change the keyframes."):
        calibration.series = None
    imgui.separator()


@lru_cache(maxsize=1)
def _keyframes_of(reading: DisdrometerReading, speed_up: float, start_s: float) -> MeasuredKeyframes:
    return keyframes_from_spectra(reading, speed_up=speed_up, start_s=start_s)


# Plot: draggable keyframes of the intensity, with those of wind and exposure below

_CURVE = ImVec4(0.42, 0.74, 1.0, 1.0)
_FILL = ImVec4(0.42, 0.74, 1.0, 0.16)
_KEY = ImVec4(1.0, 0.93, 0.45, 1.0)
_NOW = ImVec4(1.0, 0.45, 0.35, 1.0)
_LIMIT = ImVec4(0.86, 0.48, 0.06, 0.8)
_HEIGHT_EM, _MIN_EM, _ROW_EM = 12.0, 7.0, 1.5
_GRIP_PX = 8.0
_MAX_KEYS, _MAX_POINTS = 150, 20_000
_CLOSEST_S = 0.01
_ROWS = tuple(each for each in TRACKS if each.field != "intensity_mm_h")


def _plot(document: Document, playback: Playback, keyframe_panel: KeyframePanelState, width: float) -> None:
    """Draw the plot with a width in pixels, and handle the mouse."""
    weather = document.keyframes
    keyframe_panel.follow(weather.heaviest_mm_h(document.rain))
    fit, menu = implot.get_input_map().fit, implot.get_input_map().menu
    implot.get_input_map().fit = implot.get_input_map().menu = imgui.MouseButton_.middle  # both buttons edit keyframes
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    flags |= implot.Flags_.no_legend | implot.Flags_.no_title
    em = imgui.get_font_size()
    rows_height = em * _ROW_EM * sum(weather.is_keyed(each.field) for each in _ROWS)
    height = min(max(imgui.get_content_region_avail().y - rows_height, _MIN_EM * em), _HEIGHT_EM * em)
    if implot.begin_plot("##shower", ImVec2(width, height), flags):
        _axes(document, playback, keyframe_panel)
        _curve(document, keyframe_panel)
        is_over_key = _keys(document, keyframe_panel)  # before the clock: a drag of both moves the keyframe
        now_line(playback)
        if implot.is_plot_hovered() and not is_over_key and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            at = implot.get_plot_mouse_pos()
            rate = float(np.clip(round(at.y, 1), 0, HEAVIEST_MM_H))
            document.edit_keyframes("Insert rain keyframe", RainKeyframes.with_key, round(at.x, 2), intensity_mm_h=rate)
        position, size, limits = implot.get_plot_pos(), implot.get_plot_size(), implot.get_plot_limits()
        implot.end_plot()
        for track in _ROWS:
            if weather.is_keyed(track.field):
                _row(document, track, position, size, (limits.x.min, limits.x.max))
    implot.get_input_map().fit, implot.get_input_map().menu = fit, menu


def _axes(document: Document, playback: Playback, keyframe_panel: KeyframePanelState) -> None:
    always = imgui.Cond_.always
    implot.setup_axes("", "mm/h", implot.AxisFlags_.no_highlight, implot.AxisFlags_.no_highlight)
    first, last = keyframe_panel.span_s(document.keyframes, playback.clock.time_s)
    implot.setup_axis_limits(implot.ImAxis_.x1, first, last, always if keyframe_panel.refit else imgui.Cond_.once)
    implot.setup_axis_format(implot.ImAxis_.x1, "%g s")
    keyframe_panel.refit = False
    implot.setup_axis_limits(implot.ImAxis_.y1, 0.0, keyframe_panel.top_mm_h, always)


def _curve(document: Document, keyframe_panel: KeyframePanelState) -> None:
    limits = implot.get_plot_limits()
    times, rates = _points(document, limits.x.min, limits.x.max)
    implot.plot_shaded("fill", times, rates, spec=implot.Spec(fill_color=_FILL))
    implot.plot_line("rate", times, rates, spec=implot.Spec(line_color=_CURVE, line_weight=on_screen_px(2.0)))
    if keyframe_panel.top_mm_h > CALIBRATED_UP_TO_MM_H:
        spec = implot.Spec(line_color=_LIMIT, flags=implot.InfLinesFlags_.horizontal)
        implot.plot_inf_lines("calibrated up to", np.array([CALIBRATED_UP_TO_MM_H]), spec=spec)
        at, words = implot.plot_to_pixels(limits.x.max, CALIBRATED_UP_TO_MM_H), "beyond calibration"
        above = at.y - imgui.get_font_size() - 2
        y = above if above >= implot.get_plot_pos().y else at.y + 1  # no room above the line in a low plot
        _text(ImVec2(at.x - imgui.calc_text_size(words).x - 5, y), imgui.get_color_u32(_LIMIT), words)


def _points(
    document: Document, first: float, last: float
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return the visible curve: its corners, or evenly spaced points if there are too many."""
    curve = document.keyframes.curves.get("intensity_mm_h")
    if curve is None:
        return np.array([first, last]), np.full(2, document.rain.intensity_mm_h)
    inside = curve.times_s[(curve.times_s > first) & (curve.times_s < last)]
    if len(inside) > _MAX_POINTS:
        inside = np.linspace(first, last, _MAX_POINTS)[1:-1]
    times = np.concatenate([[first], inside, [last]])
    return times, np.interp(times, curve.times_s, curve.values[:, 0])


def _text(at: ImVec2, color: int, words: str) -> None:
    implot.push_plot_clip_rect()
    implot.get_plot_draw_list().add_text(at, color, words)
    implot.pop_plot_clip_rect()


def now_line(playback: Playback) -> None:
    now_s, clock = playback.clock.time_s, playback.clock
    changed, moved, *_ = implot.drag_line_x(1, now_s, _NOW, 1.5, implot.DragToolFlags_.no_fit, False, False, False)
    if changed:
        clock.time_s = moved
    implot.tag_x(now_s, _NOW, f"{now_s:.2f}")


def _keys(document: Document, keyframe_panel: KeyframePanelState) -> bool:
    """Draw the intensity keyframes and drag them; returns True if the mouse is over one."""
    weather, limits = document.keyframes, implot.get_plot_limits()
    times = weather.key_times["intensity_mm_h"]
    visible = range(*np.searchsorted(times, (limits.x.min, limits.x.max)).tolist())
    if len(visible) > _MAX_KEYS:
        corner = implot.get_plot_pos()
        color = imgui.get_color_u32(imgui.Col_.text_disabled)
        _text(ImVec2(corner.x + 8, corner.y + 5), color, f"{len(visible):,} keyframes: zoom in to drag")
        return False
    is_over, was_held = False, keyframe_panel.is_held
    keyframe_panel.is_held = False
    for number in visible:
        key = weather.key_at(times[number])
        assert key is not None, "a keyframe exists at each of its times"
        rate = key.intensity_mm_h or 0.0
        moved, at, height, _, hovered, held = implot.drag_point(
            100 + number, key.time_s, rate, _KEY, 5.0, implot.DragToolFlags_.no_fit, False, False, False
        )
        is_over, keyframe_panel.is_held = is_over or bool(hovered) or bool(held), keyframe_panel.is_held or bool(held)
        if hovered and not held:
            imgui.set_tooltip(f"{key.time_s:.2f} s, {rate:.2f} mm/h. Drag to move; right click or Delete removes it.")
        if hovered and (imgui.is_mouse_clicked(imgui.MouseButton_.right) or _deletes(document)):
            document.edit_keyframes(_REMOVE, RainKeyframes.without_key, key.time_s, "intensity_mm_h")
            return True
        if moved:
            to_s = _between(times, number, at)
            height = float(np.clip(height, 0.0, HEAVIEST_MM_H))
            change = move_keyframe, "intensity_mm_h", number, to_s
            document.edit_keyframes(_MOVE, *change, gesture="shower key", intensity_mm_h=height)
    if was_held and not keyframe_panel.is_held:
        document.end_gesture()
    return is_over


def _deletes(document: Document) -> bool:
    """Return True if Delete was pressed and applies here: selected Gaussians take precedence."""
    selected = any(each.marks.selected is not None for each in document.scene.members)
    return imgui.is_key_pressed(imgui.Key.delete) and not selected


def _between(times: Float64[np.ndarray, " n"], number: int, time_s: float) -> float:
    """Limit the new time of a keyframe to the interval between its neighbors."""
    low = times[number - 1] + _CLOSEST_S if number > 0 else -np.inf
    high = times[number + 1] - _CLOSEST_S if number + 1 < len(times) else np.inf
    return float(times[number]) if low > high else float(np.clip(time_s, low, high))


def _row(document: Document, track: Track, position: ImVec2, size: ImVec2, span_s: tuple[float, float]) -> None:
    """Draw the keyframes of another field as diamonds below the plot; they are dragged in time."""
    name, title = track.field, track.title
    height, draw = _ROW_EM * imgui.get_font_size(), imgui.get_window_draw_list()
    top = imgui.get_cursor_screen_pos().y
    imgui.dummy(ImVec2(1, height))
    after, middle = imgui.get_cursor_screen_pos(), top + height / 2
    low, high = ImVec2(position.x, top), ImVec2(position.x + size.x, top + height)
    draw.add_rect_filled(low, high, imgui.get_color_u32(imgui.Col_.frame_bg))
    draw.add_text(ImVec2(position.x + 4, top + 1), imgui.get_color_u32(imgui.Col_.text_disabled), title)
    scale, times = size.x / (span_s[1] - span_s[0]), document.keyframes.key_times[name]
    first, end = np.searchsorted(times, span_s).tolist()
    for number in range(first, min(end, first + _MAX_KEYS)):
        key = document.keyframes.key_at(times[number])
        assert key is not None, "a keyframe exists at each of its times"
        x = position.x + (key.time_s - span_s[0]) * scale
        imgui.set_cursor_screen_pos(ImVec2(x - _GRIP_PX, middle - _GRIP_PX))
        imgui.invisible_button(f"{name} {number}", ImVec2(2 * _GRIP_PX, 2 * _GRIP_PX))
        radius = 6.5 if imgui.is_item_hovered() or imgui.is_item_active() else 5.0
        draw_diamond(ImVec2(x, middle), radius, _KEY)
        value = getattr(key, name)
        words = f"{title} {value_text(track, value)}"
        imgui.set_item_tooltip(f"{words} at {key.time_s:.2f} s. Drag to move; right click or Delete removes it.")
        if imgui.is_item_clicked(imgui.MouseButton_.right) or (imgui.is_item_hovered() and _deletes(document)):
            document.edit_keyframes(_REMOVE, RainKeyframes.without_key, key.time_s, name)
            break
        if imgui.is_item_active() and imgui.get_io().mouse_delta.x:
            to_s = _between(times, number, span_s[0] + (imgui.get_mouse_pos().x - position.x) / scale)
            document.edit_keyframes(_MOVE, move_keyframe, name, number, to_s, gesture=f"shower {name}")
        if imgui.is_item_deactivated():
            document.end_gesture()
    imgui.set_cursor_screen_pos(after)
    imgui.dummy(ImVec2(0, 0))


# Table of keyframes

_VISIBLE_ROWS = 8
_TITLES = {
    "time": ("s", "Time of the keyframe in the scene, in seconds."),
    "intensity_mm_h": ("mm/h", "Rainfall intensity R, 0 to 149 mm/h."),
    "wind x": ("wind x", "Wind at 10 m along world x (east) in m/s."),
    "wind y": ("wind y", "Wind at 10 m along world y (north) in m/s."),
    "exposure_s": ("ms", "Exposure T in milliseconds."),
}


def _table(document: Document, keyframe_panel: KeyframePanelState) -> None:
    """Draw the table; an edit applies when its field loses the focus."""
    weather = document.keyframes
    columns = ["time", "intensity_mm_h"]
    columns += ["wind x", "wind y"] if weather.is_keyed("wind_m_s") else []
    columns += ["exposure_s"] if weather.is_keyed("exposure_s") else []
    height = imgui.get_frame_height_with_spacing() * (min(len(weather.keys), _VISIBLE_ROWS) + 1) + 4
    flags = imgui.TableFlags_.scroll_y | imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_same
    if not imgui.begin_table("keys", len(columns) + 1, flags, ImVec2(0, height)):
        return
    imgui.table_setup_scroll_freeze(0, 1)
    for name in columns:
        imgui.table_setup_column(_TITLES[name][0])
    imgui.table_setup_column("##remove", imgui.TableColumnFlags_.width_fixed, imgui.get_frame_height())
    imgui.table_next_row(imgui.TableRowFlags_.headers)
    for name in columns:
        imgui.table_next_column()
        imgui.table_header(_TITLES[name][0])
        imgui.set_item_tooltip(_TITLES[name][1])
    clipper = imgui.ListClipper()
    clipper.begin(len(weather.keys))
    while clipper.step():
        for number in range(clipper.display_start, min(clipper.display_end, len(weather.keys))):
            key = weather.keys[number]
            imgui.table_next_row()
            for name in columns:
                imgui.table_next_column()
                imgui.set_next_item_width(-1)
                _cell(document, keyframe_panel, key, number, name)
            imgui.table_next_column()
            if square_button(icons_fontawesome_6.ICON_FA_XMARK, f"remove {number}"):
                document.edit_keyframes(_REMOVE, RainKeyframes.without_key, key.time_s)
            imgui.set_item_tooltip("Remove all keyframes at this time.")
    clipper.end()
    imgui.end_table()


def _cell(document: Document, keyframe_panel: KeyframePanelState, key: RainKeyframe, number: int, name: str) -> None:
    value = _number(key, name)
    if value is None:
        imgui.align_text_to_frame_padding()
        imgui.text_disabled("-")
        imgui.set_item_tooltip("No keyframe at this time.")
        return
    typed = keyframe_panel.typed
    displayed = typed.value if typed is not None and typed[:2] == (key.time_s, name) else value
    changed, displayed = imgui.input_float(f"##{name} {number}", displayed, 0, 0, "%.2f")
    imgui.set_item_tooltip(_TITLES[name][1])
    if changed:
        keyframe_panel.typed = PendingInput(key.time_s, name, displayed)
    if imgui.is_item_deactivated_after_edit() and keyframe_panel.typed is not None:
        label = _MOVE if name == "time" else "Change rain keyframe"
        typed, keyframe_panel.typed = keyframe_panel.typed, None
        document.edit_keyframes(label, set_keyframe_number, key.time_s, name, typed.value)


def _number(key: RainKeyframe, name: str) -> float | None:
    if name == "time":
        return key.time_s
    if name == "intensity_mm_h":
        return key.intensity_mm_h
    if name == "exposure_s":
        return None if key.exposure_s is None else 1000 * key.exposure_s
    return None if key.wind_m_s is None else key.wind_m_s[name == "wind y"]

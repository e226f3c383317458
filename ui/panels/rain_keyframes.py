"""Shower panel: rain that changes over time, with a table of its keyframes."""

from functools import lru_cache
from typing import Literal

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.disdrometer.rain_rates import MeasuredKeyframes, keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerReading
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain import PendingInput
from gsrain_engine.rain.keyframes import (
    HEAVIEST_MM_H,
    KEYED,
    NO_KEYFRAMES,
    RainKeyframe,
    RainKeyframes,
    shower_keyframes,
)

from ..widgets.fields import ask_what_to_open, square_button, toggle_keyframe
from .rain import WARNING
from .rain_keyframe_plot import rain_keyframe_plot

_WAYS: tuple[tuple[Literal["linear", "smooth"], str], ...] = (
    ("linear", "Straight from key to key."),
    ("smooth", "Rounded, and never beyond the keys on either side (Fritsch and Carlson, 1980)."),
)

_WIDE_EM, _NUMBERS_EM = 50.0, 22.0  # panel width from which the table is next to the plot, and the table's width
SERIES_FILES = "Disdrometer files{.nc,.cdf,.dat,.txt,.csv,.log,.mis,.gz},All files{.*}"


def rain_keyframes_panel(session: Editor) -> None:
    room, em = imgui.get_content_region_avail(), imgui.get_font_size()
    is_wide = room.x > _WIDE_EM * em
    _buttons(session)
    if session.lab.series is not None:
        _series(session)
    width = room.x - _NUMBERS_EM * em if is_wide else room.x
    imgui.begin_group()
    rain_keyframe_plot(session, width)
    imgui.end_group()
    if is_wide:
        imgui.same_line()
    imgui.begin_group()
    if session.weather.keys:
        _between(session)
        rain_keyframe_table(session)
    else:
        imgui.text_wrapped("No keys: the rain stays as it is set. Double click in the plot to set the first one.")
    imgui.end_group()


def add_passing_shower(session: Editor) -> None:
    """Add a shower that starts now; keyframes of wind and exposure stay."""
    shower = shower_keyframes(session.clock.time_s)
    kept = session.weather.without("intensity_mm_h")
    for key in kept.keys:
        values = {name: value for name in ("wind_m_s", "exposure_s") if (value := getattr(key, name)) is not None}
        shower = shower.with_key(key.time_s, **values)
    session.set_weather("A shower that passes", shower)
    session.shower.refit = True


def ask_for_rate_file(session: Editor) -> None:
    ask_what_to_open("Import a series", SERIES_FILES, lambda paths: session.lab.read_series(paths[0]))


def _buttons(session: Editor) -> None:
    now_s = session.clock.time_s
    present = session.weather.key_at(now_s)
    is_here = present is not None and present.intensity_mm_h is not None
    if imgui.button("Remove key###now" if is_here else "Key now###now"):
        toggle_keyframe(session, "intensity_mm_h")
    imgui.set_item_tooltip(
        f"{'Remove the key' if is_here else 'Keep the present intensity as a key'} at the clock's time, {now_s:.2f} s."
    )
    _same_line_if_fits("A shower that passes")
    if imgui.button("A shower that passes"):
        add_passing_shower(session)
    imgui.set_item_tooltip("60 s from now on: from 0 to 12 mm/h and back, smooth.")
    _same_line_if_fits("Import...")
    imgui.begin_disabled(session.lab.busy is not None)
    if imgui.button("Import..."):
        ask_for_rate_file(session)
    imgui.end_disabled()
    imgui.set_item_tooltip("Take the rain rates of a disdrometer's file as keys, in mm/h; above 100 they are cut off.")
    _same_line_if_fits("Fit##shower")
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_MAXIMIZE}###fit shower"):
        session.shower.refit = True
    imgui.set_item_tooltip("Show all keys. Wheel: zoom in time; drag the plot: go along.")
    _same_line_if_fits("Clear keys")
    imgui.begin_disabled(not session.weather.keys)
    if imgui.button("Clear keys"):
        session.set_weather("Clear the keys", NO_KEYFRAMES)
    imgui.end_disabled()
    imgui.set_item_tooltip("Remove all keys: the rain stays as it is set in the Rain panel.")
    if session.lab.busy is not None:
        imgui.text_disabled(session.lab.busy)
    if session.lab.problem is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(session.lab.problem)
        imgui.pop_style_color()


def _same_line_if_fits(label: str) -> None:
    style = imgui.get_style()
    width = imgui.calc_text_size(label, hide_text_after_double_hash=True).x + 2 * style.frame_padding.x
    right = imgui.get_window_pos().x + imgui.get_window_width() - style.window_padding.x
    if imgui.get_item_rect_max().x + style.item_spacing.x + width < right:
        imgui.same_line()


def _between(session: Editor) -> None:
    weather = session.weather
    imgui.align_text_to_frame_padding()
    imgui.text("Between keys")
    for choice, help_text in _WAYS:
        imgui.same_line()
        if imgui.radio_button(choice, weather.between == choice) and weather.between != choice:
            session.set_weather(f"Keys {choice}", RainKeyframes(keys=weather.keys, between=choice))
        imgui.set_item_tooltip(help_text)


def _series(session: Editor) -> None:
    """Draw the options for importing a disdrometer series."""
    lab, shower = session.lab, session.shower
    assert lab.series is not None
    name, reading = lab.series
    imgui.separator_text(name)
    try:
        measured = _accept_reading(reading, shower.speed_up, shower.start_s)
    except ValueError as error:
        lab.series, lab.problem = None, f"{name}: {error}"
        return
    imgui.text_wrapped(f"{measured.summary}. The heaviest: {measured.weather.heaviest_mm_h(session.rain):.1f} mm/h.")
    width = 5.5 * imgui.get_font_size()
    imgui.set_next_item_width(width)
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    _, shower.speed_up = imgui.drag_float("times faster", shower.speed_up, 0.5, 1.0, 10_000.0, "%.0f", flags)
    imgui.set_item_tooltip("Compresses time: at 60 a minute of the series passes in a second of the scene.")
    imgui.set_next_item_width(width)
    _, shower.start_s = imgui.drag_float("starts at (s)", shower.start_s, 0.1, -1e6, 1e6, "%.1f")
    imgui.set_item_tooltip("Time in the scene of the first record, in seconds.")
    if imgui.button("Use it"):
        session.set_weather(f"Series {name}", measured.weather)
        lab.series, shower.refit = None, True
    imgui.set_item_tooltip("Take the series as the course of the intensity, in place of the present keys.")
    imgui.same_line()
    if imgui.button("Cancel##series"):
        lab.series = None
    imgui.set_item_tooltip("Leave the weather as it is.")
    imgui.separator()


@lru_cache(maxsize=1)
def _accept_reading(reading: DisdrometerReading, speed_up: float, start_s: float) -> MeasuredKeyframes:
    return keyframes_from_spectra(reading, speed_up=speed_up, start_s=start_s)


# Keyframes as numbers

_VISIBLE_ROWS = 8

_TITLES = {
    "time": ("s", "Time of the key in the scene, in seconds."),
    "intensity_mm_h": ("mm/h", "Rainfall intensity R, 0..100 mm/h."),
    "wind x": ("wind x", "Wind along world x in m/s."),
    "wind y": ("wind y", "Wind along world y in m/s."),
    "exposure_s": ("ms", "Shutter time T in milliseconds."),
}


def rain_keyframe_table(session: Editor) -> None:
    """Draw the table; an edit applies when its field loses the focus."""
    weather = session.weather
    columns = ["time", "intensity_mm_h"]
    columns += ["wind x", "wind y"] if weather.is_keyed("wind_m_s") else []
    columns += ["exposure_s"] if weather.is_keyed("exposure_s") else []
    row = imgui.get_frame_height_with_spacing()
    height = row * (min(len(weather.keys), _VISIBLE_ROWS) + 1) + 4
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
            _row(session, weather.keys[number], number, columns)
    clipper.end()
    imgui.end_table()


def _row(session: Editor, key: RainKeyframe, number: int, columns: list[str]) -> None:
    imgui.table_next_row()
    for name in columns:
        imgui.table_next_column()
        imgui.set_next_item_width(-1)
        _cell(session, key, number, name)
    imgui.table_next_column()
    if square_button(icons_fontawesome_6.ICON_FA_XMARK, f"remove {number}"):
        session.set_weather("Remove a key", session.weather.without_key(key.time_s))
    imgui.set_item_tooltip("Remove all that is keyed at this time.")


def _cell(session: Editor, key: RainKeyframe, number: int, name: str) -> None:
    shower, value = session.shower, _number(key, name)
    if value is None:
        imgui.align_text_to_frame_padding()
        imgui.text_disabled("-")
        imgui.set_item_tooltip("Not keyed at this time.")
        return
    typed = shower.typed
    shown = typed.value if typed is not None and typed[:2] == (key.time_s, name) else value
    changed, shown = imgui.input_float(f"##{name} {number}", shown, 0, 0, "%.2f")
    imgui.set_item_tooltip(_TITLES[name][1])
    if changed:
        shower.typed = PendingInput(key.time_s, name, shown)
    if imgui.is_item_deactivated_after_edit() and shower.typed is not None:
        label = "Move a key" if name == "time" else "Change a key"
        typed, shower.typed = shower.typed, None
        session.set_weather(label, _changed(session.weather, key, name, typed.value))


def _number(key: RainKeyframe, name: str) -> float | None:
    if name == "time":
        return key.time_s
    if name == "intensity_mm_h":
        return key.intensity_mm_h
    if name == "exposure_s":
        return None if key.exposure_s is None else 1000 * key.exposure_s
    return None if key.wind_m_s is None else key.wind_m_s[name == "wind y"]


def _changed(weather: RainKeyframes, key: RainKeyframe, name: str, value: float) -> RainKeyframes:
    """Return the keyframes with one number of a keyframe changed, clamped to its bounds."""
    if name == "time":
        for each in KEYED:  # fields without a keyframe here are unaffected
            weather = weather.moved_key(key.time_s, min(max(value, -1e6), 1e6), each)
        return weather
    if name == "intensity_mm_h":
        return weather.with_key(key.time_s, intensity_mm_h=min(max(value, 0.0), HEAVIEST_MM_H))
    if name == "exposure_s":
        return weather.with_key(key.time_s, exposure_s=min(max(value / 1000, 1e-5), 1.0))
    x, y = key.wind_m_s or (0.0, 0.0)
    value = min(max(value, -40.0), 40.0)
    return weather.with_key(key.time_s, wind_m_s=(value, y) if name == "wind x" else (x, value))

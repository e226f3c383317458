"""The keys of the weather as numbers, to be read and typed."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.rain.weather import HEAVIEST_MM_H, KEYED, Weather, WeatherKey
from gsrain_engine.session.rain.shower_view import TypedNumber
from gsrain_engine.session.session import Session

from ..widgets.square_button import square_button

_ROWS_SHOWN = 8
_TITLES = {
    "time": ("s", "Time of the key in the scene, in seconds."),
    "intensity_mm_h": ("mm/h", "Rainfall intensity R, 0..100 mm/h."),
    "wind x": ("wind x", "Wind along world x in m/s."),
    "wind y": ("wind y", "Wind along world y in m/s."),
    "exposure_s": ("ms", "Shutter time T in milliseconds."),
}


def shower_table(session: Session) -> None:
    """Draw the table; a number counts when its field is left."""
    weather = session.weather
    columns = ["time", "intensity_mm_h"]
    columns += ["wind x", "wind y"] if weather.is_keyed("wind_m_s") else []
    columns += ["exposure_s"] if weather.is_keyed("exposure_s") else []
    row = imgui.get_frame_height_with_spacing()
    height = row * (min(len(weather.keys), _ROWS_SHOWN) + 1) + 4
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


def _row(session: Session, key: WeatherKey, number: int, columns: list[str]) -> None:
    imgui.table_next_row()
    for name in columns:
        imgui.table_next_column()
        imgui.set_next_item_width(-1)
        _cell(session, key, number, name)
    imgui.table_next_column()
    if square_button(icons_fontawesome_6.ICON_FA_XMARK, f"remove {number}"):
        session.set_weather("Remove a key", session.weather.without_key(key.time_s))
    imgui.set_item_tooltip("Remove all that is keyed at this time.")


def _cell(session: Session, key: WeatherKey, number: int, name: str) -> None:
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
        shower.typed = TypedNumber(key.time_s, name, shown)
    if imgui.is_item_deactivated_after_edit() and shower.typed is not None:
        label = "Move a key" if name == "time" else "Change a key"
        typed, shower.typed = shower.typed, None
        session.set_weather(label, _changed(session.weather, key, name, typed.value))


def _number(key: WeatherKey, name: str) -> float | None:
    if name == "time":
        return key.time_s
    if name == "intensity_mm_h":
        return key.intensity_mm_h
    if name == "exposure_s":
        return None if key.exposure_s is None else 1000 * key.exposure_s
    return None if key.wind_m_s is None else key.wind_m_s[name == "wind y"]


def _changed(weather: Weather, key: WeatherKey, name: str, value: float) -> Weather:
    """Return the weather with one number of a key as it was typed, within its bounds."""
    if name == "time":
        for each in KEYED:  # those that are not keyed here stay out of it
            weather = weather.moved_key(key.time_s, min(max(value, -1e6), 1e6), each)
        return weather
    if name == "intensity_mm_h":
        return weather.with_key(key.time_s, intensity_mm_h=min(max(value, 0.0), HEAVIEST_MM_H))
    if name == "exposure_s":
        return weather.with_key(key.time_s, exposure_s=min(max(value / 1000, 1e-5), 1.0))
    x, y = key.wind_m_s or (0.0, 0.0)
    value = min(max(value, -40.0), 40.0)
    return weather.with_key(key.time_s, wind_m_s=(value, y) if name == "wind x" else (x, value))

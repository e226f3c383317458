"""The Rain panel: what a person asks for."""

from functools import cache

import msgspec
from imgui_bundle import ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.rain.presets import load_preset, preset_names
from gsrain_engine.rain.rain import CALIBRATED_UP_TO_MM_H, Rain
from gsrain_engine.session.session import Session

from ..widgets import fields
from ..widgets.key_button import key_button, key_button_width, keyed_slider, tint_keyed
from .drop_color import drop_color
from .wetness_fields import wetness_fields

WARNING = ImVec4(1.0, 0.72, 0.3, 1.0)
_HIGHEST_MM_H = 100.0


def rain_panel(session: Session) -> None:
    _presets(session)
    _intensity(session)
    _exposure(session)
    fields.toggle(session, "streaks")
    imgui.same_line()
    fields.toggle(session, "haze")
    imgui.same_line()
    fields.toggle(session, "roofs")
    drop_color(session)
    wetness_fields(session)
    if session.rain.exaggeration:
        imgui.text_colored(WARNING, session.rain.exaggeration)
    if imgui.collapsing_header("Wind and seed"):
        _wind(session)
        fields.slider(session, "gust_m_s")
        fields.integer(session, "seed")
    if imgui.collapsing_header("Regions"):
        _regions(session)
    if imgui.collapsing_header("Physics"):
        for name in ("closure", "velocity", "streak_frame", "rain_light", "far_drops", "streak_reset", "haze_reset"):
            fields.choice(session, name)
    if imgui.collapsing_header("Lens"):
        fields.slider(session, "aperture_mm", high=10.0)
        fields.slider(session, "focus_distance_m", logarithmic=True)
    if imgui.collapsing_header("Appearance"):
        for name in ("streak_gain", "haze_gain"):
            fields.slider(session, name, high=10.0)
        for name in ("critical_haze_coefficient", "haze_opacity", "haze_sigma_m"):
            fields.slider(session, name, logarithmic=True)
        fields.slider(session, "drying_s", high=600.0)


@cache
def _shipped() -> dict[str, Rain]:
    return {name: load_preset(name) for name in preset_names()}


def _presets(session: Session) -> None:
    presets = _shipped()
    spacing = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - spacing * (len(presets) - 1)) / len(presets)
    for place, (name, preset) in enumerate(presets.items()):
        active = preset == session.rain_now
        if active:
            imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active))
        if imgui.button(name, (width, 0)):
            session.change_rain(f"Preset {name}", **msgspec.structs.asdict(preset))
        if active:
            imgui.pop_style_color()
        unit = "no rain" if preset.intensity_mm_h == 0 else f"{preset.intensity_mm_h:g} mm/h"
        imgui.set_item_tooltip(f"{unit}, all as in the paper" if name == "paper" else unit)
        if place < len(presets) - 1:
            imgui.same_line()


def _intensity(session: Session) -> None:
    intensity = session.rain_now.intensity_mm_h
    beyond = session.view.beyond_calibration or intensity > CALIBRATED_UP_TO_MM_H
    keyed_slider(session, "intensity_mm_h", high=_HIGHEST_MM_H if beyond else CALIBRATED_UP_TO_MM_H)
    changed, wanted = imgui.checkbox("up to 100 mm/h", beyond)
    imgui.set_item_tooltip("Above 13 mm/h the calibration is extrapolated.")
    if changed:
        session.view.beyond_calibration = wanted
        if not wanted and intensity > CALIBRATED_UP_TO_MM_H:
            session.change_rain("Intensity", intensity_mm_h=CALIBRATED_UP_TO_MM_H)
    if intensity > CALIBRATED_UP_TO_MM_H:
        imgui.same_line()
        imgui.text_colored(WARNING, "beyond calibration")


def _exposure(session: Session) -> None:
    exposure, is_keyed = session.rain_now.exposure_s, session.weather.is_keyed("exposure_s")
    own = exposure is None
    camera_s = session.shot(16, 16).camera.exposure_s
    fields.plain_label("Exposure (ms)", fields.field_info("exposure_s").help)
    imgui.set_next_item_width(-1.3 * imgui.get_frame_height() - imgui.get_style().item_spacing.x - key_button_width())
    colors = tint_keyed(session, "exposure_s")
    imgui.begin_disabled(own)
    milliseconds = 1000 * (camera_s if exposure is None else exposure)
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    changed, milliseconds = imgui.slider_float("##exposure_s", milliseconds, 0.1, 100.0, "%.2f", flags)
    if changed:
        session.change_rain("Exposure", "exposure_s", exposure_s=milliseconds / 1000)
    fields.end_gesture_when_released(session)
    imgui.end_disabled()
    imgui.pop_style_color(colors)
    imgui.same_line()
    imgui.begin_disabled(is_keyed)
    imgui.push_style_color(
        imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active if own else imgui.Col_.button)
    )
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_CAMERA}###camera's", (1.3 * imgui.get_frame_height(), 0)):
        session.change_rain("Exposure", exposure_s=camera_s if own else None)
    imgui.pop_style_color()
    imgui.end_disabled()
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        why = " Not while the exposure has keys." if is_keyed else ""
        imgui.set_tooltip(f"Take the camera's own shutter time, {1000 * camera_s:.1f} ms.{why}")
    key_button(session, "exposure_s")


def _wind(session: Session) -> None:
    fields.label("wind_m_s")
    imgui.set_next_item_width(-key_button_width())
    colors = tint_keyed(session, "wind_m_s")
    changed, wind = imgui.slider_float2("##wind_m_s", list(session.rain_now.wind_m_s), -20, 20, "%.1f")
    imgui.pop_style_color(colors)
    if changed:
        session.change_rain("Wind", "wind_m_s", wind_m_s=tuple(wind))
    fields.end_gesture_when_released(session)
    key_button(session, "wind_m_s")


def _regions(session: Session) -> None:
    view = session.view
    _, view.show_streak_region = imgui.checkbox("Show streak region", view.show_streak_region)
    imgui.set_item_tooltip("Draw the region's edges in the view.")
    fields.box(session, "streak_region")
    _, view.show_haze_region = imgui.checkbox("Show haze region", view.show_haze_region)
    imgui.set_item_tooltip("Draw the region's edges in the view.")
    fields.box(session, "haze_region")

"""Rain panel and Read-out panel."""

from functools import cache, lru_cache

import msgspec
from imgui_bundle import ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.properties import intensity_for_density
from gsrain_engine.rain.settings import CALIBRATED_UP_TO_MM_H, RainSettings, load_preset, preset_names

from ..widgets import fields
from ..widgets.fields import keyframe_button, keyframe_button_width, keyframed_slider, tint_keyframed
from ..widgets.text import readings

WARNING = ImVec4(1.0, 0.72, 0.3, 1.0)
_HIGHEST_MM_H = 100.0


def rain_panel(session: Editor) -> None:
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
def _shipped() -> dict[str, RainSettings]:
    return {name: load_preset(name) for name in preset_names()}


def _presets(session: Editor) -> None:
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


def _intensity(session: Editor) -> None:
    intensity = session.rain_now.intensity_mm_h
    beyond = session.view.beyond_calibration or intensity > CALIBRATED_UP_TO_MM_H
    keyframed_slider(session, "intensity_mm_h", high=_HIGHEST_MM_H if beyond else CALIBRATED_UP_TO_MM_H)
    changed, wanted = imgui.checkbox("up to 100 mm/h", beyond)
    imgui.set_item_tooltip("Above 13 mm/h the calibration is extrapolated.")
    if changed:
        session.view.beyond_calibration = wanted
        if not wanted and intensity > CALIBRATED_UP_TO_MM_H:
            session.change_rain("Intensity", intensity_mm_h=CALIBRATED_UP_TO_MM_H)
    if intensity > CALIBRATED_UP_TO_MM_H:
        imgui.same_line()
        imgui.text_colored(WARNING, "beyond calibration")


def _exposure(session: Editor) -> None:
    exposure, is_keyed = session.rain_now.exposure_s, session.weather.is_keyed("exposure_s")
    own = exposure is None
    camera_s = session.shot(16, 16).camera.exposure_s
    fields.plain_label("Exposure (ms)", fields.field_info("exposure_s").help)
    imgui.set_next_item_width(
        -1.3 * imgui.get_frame_height() - imgui.get_style().item_spacing.x - keyframe_button_width()
    )
    colors = tint_keyframed(session, "exposure_s")
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
    keyframe_button(session, "exposure_s")


def _wind(session: Editor) -> None:
    fields.label("wind_m_s")
    imgui.set_next_item_width(-keyframe_button_width())
    colors = tint_keyframed(session, "wind_m_s")
    changed, wind = imgui.slider_float2("##wind_m_s", list(session.rain_now.wind_m_s), -20, 20, "%.1f")
    imgui.pop_style_color(colors)
    if changed:
        session.change_rain("Wind", "wind_m_s", wind_m_s=tuple(wind))
    fields.end_gesture_when_released(session)
    keyframe_button(session, "wind_m_s")


def _regions(session: Editor) -> None:
    view = session.view
    _, view.show_streak_region = imgui.checkbox("Show streak region", view.show_streak_region)
    imgui.set_item_tooltip("Draw the region's edges in the view.")
    fields.box(session, "streak_region")
    _, view.show_haze_region = imgui.checkbox("Show haze region", view.show_haze_region)
    imgui.set_item_tooltip("Draw the region's edges in the view.")
    fields.box(session, "haze_region")


# Drop color

PICK_TOOL = "Pick sky colour"


def drop_color(session: Editor) -> None:
    fields.label("drop_color")
    own = session.rain.drop_color
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.no_label
    changed, color = imgui.color_edit3("##drop_color", list(own or session.sky), flags)
    imgui.set_item_tooltip("Display colour of a drop (eq. 3).")
    if changed:
        red, green, blue = (min(max(channel, 0.0), 1.0) for channel in color)
        session.change_rain("Drop colour", "drop_color", drop_color=(red, green, blue))
    fields.end_gesture_when_released(session)
    imgui.same_line()
    is_on = session.view.tool == PICK_TOOL
    if is_on:
        imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active))
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_EYE_DROPPER}###pick sky"):
        session.view.tool = "" if is_on else PICK_TOOL
    if is_on:
        imgui.pop_style_color()
    imgui.set_item_tooltip("Pick it from the view: click a pixel there, or drag a rectangle.")
    imgui.same_line()
    imgui.begin_disabled(own is None)
    if imgui.button("from the sky"):
        session.change_rain("Drop colour from the sky", drop_color=None)
    imgui.end_disabled()
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        imgui.set_tooltip("Take the mean of the scene's own sky in linear light, as at first (eq. 3).")


# Wetness

_NO_WET_COLORS = 'The scene has no wet colours yet: the panel "Make it rainy" or recolouring in Capture makes them.'


def wetness_fields(session: Editor) -> None:
    own, now = session.rain.wetness, session.wetness_now
    has_colors = session.scene.has_wet_colors
    beside = imgui.calc_text_size("auto").x + imgui.get_frame_height() + 2 * imgui.get_style().item_spacing.x
    fields.label("wetness")
    imgui.set_next_item_width(-beside)
    imgui.begin_disabled(own is None or not has_colors)
    changed, value = imgui.slider_float("##wetness", now, 0.0, 1.0, "%.2f", imgui.SliderFlags_.always_clamp)
    if changed:
        session.change_rain("Wetness", "wetness", wetness=value)
    fields.end_gesture_when_released(session)
    imgui.end_disabled()
    imgui.set_item_tooltip(fields.field_info("wetness").help if has_colors else _NO_WET_COLORS)
    imgui.same_line()
    imgui.begin_disabled(not has_colors)
    changed, automatic = imgui.checkbox("auto", own is None)
    if changed:
        session.change_rain("Wetness by the intensity" if automatic else "Wetness", wetness=None if automatic else now)
    imgui.end_disabled()
    help_text = "Let the wetness follow the rainfall intensity (docs/physics.md, 11)."
    imgui.set_item_tooltip(help_text if has_colors else _NO_WET_COLORS)


# Read-out panel: quantities derived from the intensity


def rain_properties_panel(session: Editor) -> None:
    state = session.displayed_rain.state_at(session.clock.time_s)
    if state.intensity_mm_h == 0:
        imgui.text_wrapped("0 mm/h now: no rain at all." if session.weather.keys else "0 mm/h: no rain at all.")
        return
    drawn = int(session.statistics.get("drops drawn", 0))
    haze = int(session.statistics.get("haze Gaussians", 0))
    rows = (
        ("Asked for", f"{state.intensity_mm_h:.2f} mm/h", "Rainfall intensity R."),
        ("Drawn drops carry", f"{state.implied_mm_h:.2f} mm/h", "6e-4 pi N E[V D^3] of the drops as drawn."),
        ("Table would carry", f"{state.table_implied_mm_h:.2f} mm/h", "The same for the calibration's own density."),
        (
            "Drops per m\u00b3",
            f"{state.density_m3:,.0f}",
            f"Number density N; the table says {state.table_density_m3:,.0f}.",
        ),
        (
            "Table has as many at",
            _by_number(state.density_m3, session.displayed_rain.calibration),
            "Intensity at which the calibration's own table has as many drops as are drawn.",
        ),
        ("Gamma shape", f"{state.shape:.3f}", "mu of the gamma law of diameters."),
        ("Gamma scale", f"{state.scale_mm:.4f} mm", "theta of the gamma law of diameters."),
        ("Mean diameter", f"{state.mean_diameter_mm:.3f} mm", "Of all drops in the air."),
        ("Mean fall speed", f"{state.mean_fall_speed_m_s:.2f} m/s", "Of all drops in the air."),
        ("Drops in region", f"{state.drops:,}", "Density times the streak region's volume."),
        ("Drops drawn", f"{drawn:,}", "Seen by this camera, nearer than phi f D."),
        ("Haze Gaussians", f"{haze:,}", f"Around the view; {state.haze_gaussians:,} at full opacity in the region."),
        ("Extinction", f"{1000 * state.extinction_per_m:.3f} /km", "beta = (pi/4) Q N E[D^2], times the haze gain."),
        ("Visibility", f"{state.visibility_m / 1000:.2f} km", "Where 5 % of a beam is left."),
    )
    readings("readout", rows)
    if state.beyond_calibration:
        imgui.text_colored(WARNING, "beyond calibration (13 mm/h)")
    if session.rain.exaggeration:
        imgui.text_colored(WARNING, session.rain.exaggeration)


@lru_cache(maxsize=4)
def _by_number(density_m3: float, calibration: Calibration) -> str:
    try:
        return f"{intensity_for_density(density_m3, RainSettings(closure='published'), calibration):.2f} mm/h"
    except ValueError:
        return "over 100 mm/h"

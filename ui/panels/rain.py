"""Rain panel and Rain properties panel."""

from functools import cache, lru_cache
from pathlib import Path

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.lamps import LampFinder
from gsrain_engine.editor.live_rain import LiveRain
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.fields import field_of, fields_of
from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.properties import intensity_for_density, rain_class
from gsrain_engine.rain.settings import (
    CALIBRATED_UP_TO_MM_H,
    HEAVIEST_MM_H,
    RainSettings,
    RegionBox,
    load_preset,
)
from gsrain_engine.scene.sensor import DEFAULT_SENSOR, load_sensor, sensor_names

from ..commands.table import INTENSITIES_MM_H, intensity_command, set_intensity
from ..widgets import fields
from ..widgets.fields import (
    LOGARITHMIC,
    button,
    checkbox,
    disabled,
    keyframe_button,
    keyframe_button_width,
    keyframed_slider,
    same_line_if_fits,
    share_of_width,
    tint_keyframed,
    warn,
    warning_color,
)
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.numbers import compass, compass_name, slide
from ..widgets.text import readings
from ..widgets.type_ahead import combo_box
from .glass import glass_fields
from .lamps import lamp_choice, lamp_fields

_PAPER = "Paper settings"
PICK_TOOL = "Drop color"
_WIND = "Wind and seed"
_WIND_FIELDS = ("wind_speed_m_s", "wind_from_deg", "wind_m_s")
GROUPS = (_WIND, "Glass", "Regions", "Physics", "Camera", "Lamps", "Appearance")
"""Headings below which the fields with this `group` are drawn, but for those that are used most, above them."""
_ABOVE = (*_WIND_FIELDS, "glass", "lamps")

_NO_WET_COLORS = "The scene has no wet colors yet: create them in the Wet look panel, or by recoloring in Capture."


def rain_panel(
    document: Document, viewport: ViewportState, playback: Playback, live_rain: LiveRain, status: StatusBus,
    lamps: LampFinder, jobs: JobRunner, rollouts: RolloutPlayer,
) -> None:  # fmt: skip
    if rollouts.shows_rain:
        warn("A roll-out plays, in the rain of its drive.")
        rollouts.rain_as_driven = not button("Show this rain", "Play the roll-out in the rain of this panel instead.")
    _presets(document)
    _intensity(document, viewport, playback, live_rain)
    _exposure(document, viewport, playback)
    fields.toggles(document, "streaks", "roofs", "mirror", "splashes", "spray")
    fields.choice(document, "haze")
    fields.rain_field(document, "visibility_m")
    wetness_fields(document, live_rain, keyframe_button_width())
    keyframe_button(document, viewport, playback, "wetness")
    _wind(document, viewport, playback)
    fields.choice(document, "glass")
    lamp_choice(document, status)
    _drop_color(document, viewport, live_rain)
    if document.rain.exaggeration:
        imgui.text_colored(warning_color(), document.rain.exaggeration)
    for group in GROUPS:
        if imgui.collapsing_header(group):
            if group == _WIND:
                _wind_compass(document)
            if group == "Glass":
                glass_fields(document)
                continue
            if group == "Lamps":
                lamp_fields(document, viewport, lamps, jobs)
            for each in fields_of(RainSettings):
                if each.group != group or each.name in _ABOVE:
                    continue
                if each.name == "sensor":
                    _sensor(document, viewport, live_rain, status)
                elif each.name == "lamp_gain":
                    keyframed_slider(document, viewport, playback, "lamp_gain", high=each.slider_high)
                elif each.kind is RegionBox:
                    _region(document, viewport, each.name)
                else:
                    fields.rain_field(document, each.name)


def wetness_fields(document: Document, live_rain: LiveRain, beside_px: float = 0.0, *, label: str = "") -> None:
    """Edit the wetness; `beside_px` stays free, and `label` replaces the field's own."""
    own, now = document.rain_now.wetness, live_rain.wetness_now
    has_colors = document.scene.has_wet_colors
    auto_width = imgui.calc_text_size("Auto").x + imgui.get_frame_height() + 2 * imgui.get_style().item_spacing.x
    fields.field_label("wetness", label=label)
    imgui.set_next_item_width(-auto_width - beside_px)
    with disabled(own is None or not has_colors):
        changed, value = slide("##wetness", now, 0.0, 1.0, "%.2f")
        if changed:
            document.change_rain("Wetness", "wetness", wetness=value)
        fields.end_gesture_when_released(document)
    imgui.set_item_tooltip(field_of(RainSettings, "wetness").help if has_colors else _NO_WET_COLORS)
    imgui.same_line()
    help_text = "Compute the wetness from the intensity."
    with disabled(not has_colors):
        automatic = checkbox("Auto", own is None, help_text if has_colors else _NO_WET_COLORS)
    if automatic != (own is None):
        document.change_rain("Wetness by the intensity" if automatic else "Wetness", wetness=None if automatic else now)


def _presets(document: Document) -> None:
    """Draw the presets: of the intensity, and the settings of the paper."""
    needed = imgui.calc_text_size(_PAPER).x + 2 * imgui.get_style().frame_padding.x
    per_row = next((each for each in (3, 2) if share_of_width(each) >= needed), 1)
    width = share_of_width(per_row)
    for number, (name, rate) in enumerate(INTENSITIES_MM_H.items()):
        command = intensity_command(name)
        if number % per_row:
            imgui.same_line()
        is_on = document.rain_now.intensity_mm_h == rate
        title = f"{name} {rate:g}" if rate else name  # the unit is that of the slider below
        if button(f"{title}###{rate:g}", command.help, width=width, is_on=is_on):
            set_intensity(document, rate)
    if len(INTENSITIES_MM_H) % per_row:
        imgui.same_line()
    paper = _paper()
    help_text = "Set all rain settings to those of the GSRAIN paper (Wang, Zhang and Chen)."
    if button(f"{_PAPER}###paper", help_text, width=width, is_on=paper == document.rain_now):
        document.change_rain("Preset paper", **msgspec.structs.asdict(paper))


@cache
def _paper() -> RainSettings:
    return load_preset("paper")


def _intensity(document: Document, viewport: ViewportState, playback: Playback, live_rain: LiveRain) -> None:
    intensity = document.rain_now.intensity_mm_h
    is_beyond = viewport.options.beyond_calibration or intensity > CALIBRATED_UP_TO_MM_H
    keyframed_slider(
        document, viewport, playback, "intensity_mm_h", high=HEAVIEST_MM_H if is_beyond else CALIBRATED_UP_TO_MM_H
    )
    beyond = checkbox(
        "Up to 149 mm/h (extrapolated)", is_beyond, "Above 13 mm/h the calibration is extrapolated, up to 149 mm/h."
    )
    if beyond != is_beyond:
        viewport.options.beyond_calibration = beyond
        if not beyond and intensity > CALIBRATED_UP_TO_MM_H:
            document.change_rain("Intensity", intensity_mm_h=CALIBRATED_UP_TO_MM_H)
    if intensity > 0:
        same_line_if_fits(rain_class(intensity))
        imgui.text(rain_class(intensity))
    if live_rain.displayed.state_at(playback.clock.time_s).beyond_calibration:
        same_line_if_fits("beyond calibration")
        imgui.text_colored(warning_color(), "beyond calibration")


def _exposure(document: Document, viewport: ViewportState, playback: Playback) -> None:
    exposure, is_keyed = document.rain_now.exposure_s, document.keyframes.is_keyed("exposure_s")
    own = exposure is None
    camera_s = viewport.shot(16, 16).camera.exposure_s
    width = 1.3 * imgui.get_frame_height()
    fields.plain_label("Exposure (ms)", field_of(RainSettings, "exposure_s").help)
    imgui.set_next_item_width(-width - imgui.get_style().item_spacing.x - keyframe_button_width())
    colors = tint_keyframed(document, "exposure_s")
    with disabled(own):
        milliseconds = 1000 * (camera_s if exposure is None else exposure)
        changed, milliseconds = slide(
            "##exposure_s", milliseconds, 0.1, 100.0, "%.2f", LOGARITHMIC, bounds=(0.01, 1000.0), unit="ms"
        )
        if changed:
            document.change_rain("Exposure", "exposure_s", exposure_s=milliseconds / 1000)
        fields.end_gesture_when_released(document)
    imgui.pop_style_color(colors)
    imgui.same_line()
    help_text = f"Use the camera's own exposure, {1000 * camera_s:.1f} ms."
    why_not = "Not while the exposure has keyframes." if is_keyed else None
    if button(f"{icons_fontawesome_6.ICON_FA_CAMERA}###camera's", help_text, width=width, why_not=why_not, is_on=own):
        document.change_rain("Exposure", exposure_s=camera_s if own else None)
    keyframe_button(document, viewport, playback, "exposure_s")


_NO_SENSOR = f"lens of {DEFAULT_SENSOR}"


def _sensor(document: Document, viewport: ViewportState, live_rain: LiveRain, status: StatusBus) -> None:
    """Choose a sensor, and list its values for the present camera."""
    own = document.rain.sensor
    names = [None, *_shipped_sensors()] + ([own] if own not in (None, *_shipped_sensors()) else [])
    titles = [_NO_SENSOR if each is None else Path(each).stem for each in names]
    fields.field_label("sensor")
    imgui.set_next_item_width(-fields.keyframe_button_width())
    changed, at = combo_box("##sensor", names.index(own), titles)
    if changed:
        document.change_rain("Camera model", sensor=names[at])
    imgui.same_line()
    if fields.square_button(icons_fontawesome_6.ICON_FA_FOLDER_OPEN, "choose sensor"):
        ask_what_to_open("Sensor", "Sensors{.yaml,.yml}", lambda chosen: _use(document, status, chosen[0]))
    imgui.set_item_tooltip("Choose a sensor file...")
    simulation, camera = live_rain.simulation, viewport.shot(960, 640).camera
    sensor, lens = simulation.sensor, simulation.lens(camera)
    rows = [("Exposure", f"{1e3 * simulation.exposure_s(camera):.2f} ms", "Exposure time of drops.")]
    rows.append(("Aperture", f"{1e3 * lens.aperture_m:.2f} mm", "Diameter of the lens: focal length / f-number."))
    if lens.aperture_m:
        rows.append(("Focus distance", f"{lens.focus_m:.2f} m", "Distance that is sharp."))
    if sensor.readout_s:
        text = f"{1e3 * sensor.readout_s:.0f} ms {sensor.readout_direction}"
        rows.append(("Rolling shutter readout", text, "Time from the first row to the last; it acts on drops."))
    if simulation.picture_sensor is not None:
        if sensor.full_well_e is not None:
            text = f"{sensor.full_well_e / sensor.gain:,.0f} e-, read noise {sensor.read_noise_e:g} e-"
            rows.append(("White", text, "Electrons of white; shot noise is the root of a pixel's electrons."))
        rows.append(("Tone curve", sensor.tone_curve, "In recorded images and videos; the viewport is without it."))
        if sensor.processes_signal:
            text = f"noise reduction {sensor.noise_reduction:g}, sharpening {sensor.sharpening:g}"
            rows.append(("Processing", text, "Strengths. In recorded images and videos."))
        if sensor.jpeg_quality is not None:
            rows.append(("JPEG quality", f"{sensor.jpeg_quality}", "In recorded images and videos."))
    fields.faint("In effect:")
    readings("sensor values", rows, faint=True)


def _use(document: Document, status: StatusBus, path: Path) -> None:
    """Use a sensor file, if it can be read."""
    try:
        load_sensor(path)
    except (ValueError, OSError) as error:
        status.report(error)
    else:
        document.change_rain("Camera model", sensor=str(path))


@cache
def _shipped_sensors() -> tuple[str, ...]:
    return tuple(sensor_names())


_COMPASS_EM = 6.8
_COMPASS_HELP = (
    "Wind, north up: the needle comes from where the wind does; at the rim it has {high:g} m/s.\n"
    "Drag the needle; Ctrl: in steps of 15 degrees. Arrow keys turn it and change its speed.\n"
    "Right click: back to the default."
)


def _wind(document: Document, viewport: ViewportState, playback: Playback) -> None:
    """Edit speed and direction of the wind as numbers; with keyframes both go into one."""
    rain, speed = document.rain_now, field_of(RainSettings, "wind_speed_m_s")
    colors = tint_keyframed(document, "wind_m_s")
    fields.plain_label("Wind (m/s), from", f"{speed.help} The heading below has a compass.")
    gap = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - gap - keyframe_button_width()) / 2
    imgui.set_next_item_width(width)
    bounds = (0.0, speed.high)
    changed, speed_m_s = slide(
        "##wind_speed_m_s", rain.wind_speed_m_s, 0.0, speed.slider_high, "%.1f", bounds=bounds, unit="m/s"
    )
    if changed:
        document.change_rain("Wind speed", "wind_speed_m_s", wind_speed_m_s=speed_m_s, wind_from_deg=rain.wind_from_deg)
    fields.end_gesture_when_released(document)
    imgui.set_item_tooltip(f"{speed.help} Double click: type a value.")
    imgui.same_line()
    imgui.set_next_item_width(width)
    changed, from_deg = slide("##wind_from_deg", rain.wind_from_deg, 0.0, 360.0, "%.0f\u00b0", unit="\u00b0")
    imgui.set_item_tooltip(f"{field_of(RainSettings, 'wind_from_deg').help} Double click: type a value.")
    if changed:
        document.change_rain("Wind from", "wind_from_deg", wind_speed_m_s=rain.wind_speed_m_s, wind_from_deg=from_deg)
    fields.end_gesture_when_released(document)
    imgui.pop_style_color(colors)
    keyframe_button(document, viewport, playback, "wind_m_s")


def _wind_compass(document: Document) -> None:
    rain, speed = document.rain_now, field_of(RainSettings, "wind_speed_m_s")
    high, diameter = speed.slider_high, _COMPASS_EM * imgui.get_font_size()
    help_text = _COMPASS_HELP.format(high=high)
    changed, from_deg, speed_m_s = compass("wind", rain.wind_from_deg, rain.wind_speed_m_s, high, diameter, help_text)
    if imgui.is_item_clicked(imgui.MouseButton_.right):
        changed, from_deg, speed_m_s = True, field_of(RainSettings, "wind_from_deg").default, speed.default
    if changed:
        gesture = "wind" if imgui.is_mouse_down(imgui.MouseButton_.left) else None  # a key is a step of its own
        document.change_rain("Wind", gesture, wind_speed_m_s=speed_m_s, wind_from_deg=from_deg)
    fields.end_gesture_when_released(document)
    imgui.same_line()
    imgui.text(f"Wind from {compass_name(rain.wind_from_deg)}")


def _region(document: Document, viewport: ViewportState, name: str) -> None:
    shows = f"show_{name}"
    title = f"Show {field_of(RainSettings, name).title.lower()}"
    is_shown = checkbox(title, getattr(viewport.options, shows), "Draw the region's edges in the viewport.")
    setattr(viewport.options, shows, is_shown)
    if name == "haze_region":
        own = document.rain.haze_region is not None
        limited = checkbox("Limit haze to a region", own, field_of(RainSettings, name).help)
        if limited != own:
            region = document.rain.haze_box if limited else None
            document.change_rain("Limit haze to a region" if limited else "Haze everywhere", haze_region=region)
    if getattr(document.rain, name) is not None:
        fields.box(document, name)


def _drop_color(document: Document, viewport: ViewportState, live_rain: LiveRain) -> None:
    fields.field_label("drop_color")
    own, is_picking = document.rain.drop_color, viewport.options.tool == PICK_TOOL
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.no_label
    changed, color = imgui.color_edit3("##drop_color", list(own or live_rain.sky.drops), flags)
    imgui.set_item_tooltip("Display color of a drop.")
    if changed:
        drop_color = tuple(min(max(channel, 0.0), 1.0) for channel in color[:3])
        document.change_rain("Drop color", "drop_color", drop_color=drop_color)
    fields.end_gesture_when_released(document)
    imgui.same_line()
    help_text = "Pick the color in the viewport: click a pixel, or drag a rectangle."
    if button(f"{icons_fontawesome_6.ICON_FA_EYE_DROPPER}###pick sky", help_text, is_on=is_picking):
        viewport.options.tool = "" if is_picking else PICK_TOOL
    imgui.same_line()
    help_text = "Use the mean color of the scene's sky in linear light, the default."
    if button("From sky", help_text, enabled=own is not None):
        document.change_rain("Drop color from sky", drop_color=None)


# Rain properties panel: quantities derived from the intensity

_VISIBILITY_HELP = "Distance at which 5 % of a contrast is left (meteorological optical range)."


def rain_properties_panel(document: Document, viewport: ViewportState, playback: Playback, live_rain: LiveRain) -> None:
    state = live_rain.displayed.state_at(playback.clock.time_s)
    if state.intensity_mm_h == 0 and not state.is_clear:
        visibility = f"{state.visibility_m:,.0f} m"
        readings("fog properties", [
            ("Fog extinction", f"{1000 * state.extinction_per_m:.3f} /km", "Of light, by the fog: 3.0 / visibility."),
            ("Fog visibility", visibility, _VISIBILITY_HELP),
        ])  # fmt: skip
        return
    if state.intensity_mm_h == 0:
        imgui.text_wrapped("No rain at this time." if document.keyframes.keys else "No rain.")
        return
    per_km = 1000 * (state.extinction_per_m - state.fog_extinction_per_m)
    measured_per_km = 1000 * state.marshall_palmer_extinction_per_m
    ratio = f" ({per_km / measured_per_km:.2f} x Marshall-Palmer)" if measured_per_km > 0 else ""
    has_fog = state.fog_extinction_per_m > 0
    readings("readout", [
        ("Simulated rain rate", f"{state.implied_mm_h:.2f} mm/h", "Of the simulated drops: 6e-4 pi N E[V D^3]."),
        ("Class", state.rain_class, "Very light to very heavy rain, after ASAM OSI."),
        ("Rain extinction", f"{per_km:.3f} /km{ratio}",
         "Of light, by the drops: (pi/4) Q N E[D^2], times the haze gain; and how many times that of as much rain with "
         f"the drops of Marshall and Palmer (1948), {measured_per_km:.3f} /km."),
        ("Visibility in both" if has_fog else "Rain visibility", f"{state.visibility_m / 1000:.2f} km",
         _VISIBILITY_HELP),
    ])  # fmt: skip
    if state.beyond_calibration:
        imgui.text_colored(warning_color(), f"beyond calibration ({state.calibrated_up_to_mm_h:.3g} mm/h)")
    warn(document.rain.exaggeration)
    if not imgui.collapsing_header("More quantities"):
        return
    drawn, haze = (int(viewport.statistics.get(name, 0)) for name in ("drops drawn", "haze Gaussians"))
    rows = [
        ("Set rain rate", f"{state.intensity_mm_h:.2f} mm/h", "Rainfall intensity R."),
        ("Rain rate of the calibration", f"{state.table_implied_mm_h:.2f} mm/h",
         "Rain rate with as many drops as the calibration's table has at this intensity."),
        ("Drops per m\u00b3", f"{state.density_m3:,.0f}",
         f"Number density N; {state.table_density_m3:,.0f} in the calibration's table."),
        ("Calibration has this density at", _intensity_in_table(state.density_m3, live_rain.displayed.calibration),
         "Intensity at which the calibration's table has this density."),
        ("Gamma shape", f"{state.shape:.3f}", "mu of the gamma distribution of drop diameters."),
        ("Gamma scale", f"{state.scale_mm:.4f} mm", "theta of the gamma distribution of drop diameters."),
        ("Mean diameter", f"{state.mean_diameter_mm:.3f} mm", "Of all drops in the air."),
        ("Mean fall speed", f"{state.mean_fall_speed_m_s:.2f} m/s", "Of all drops in the air."),
        ("Drops in region", f"{state.drops:,}", "Density times the streak region's volume."),
        ("Drops drawn", f"{drawn:,}", "In the image, near enough to be streaks."),
    ]  # fmt: skip
    if document.rain.haze == "gaussians":
        help_text = f"Around the camera; {state.haze_gaussians:,} at full opacity in the region."
        rows.append(("Haze Gaussians", f"{haze:,}", help_text))
    if has_fog:
        help_text = "Of light, by the fog: 3.0 / visibility."
        rows.append(("Fog extinction", f"{1000 * state.fog_extinction_per_m:.3f} /km", help_text))
    readings("more readings", rows)


@lru_cache(maxsize=4)
def _intensity_in_table(density_m3: float, calibration: Calibration) -> str:
    try:
        return f"{intensity_for_density(density_m3, RainSettings(closure='published'), calibration):.2f} mm/h"
    except ValueError:
        return "over 149 mm/h"

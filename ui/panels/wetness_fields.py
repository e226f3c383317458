"""The row of the wetness: how much of the scene's wet colours is shown, by the intensity or as a person sets it."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..widgets import fields

_NO_WET_COLORS = 'The scene has no wet colours yet: the panel "Make it rainy" or recolouring in Capture makes them.'


def wetness_fields(session: Session) -> None:
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

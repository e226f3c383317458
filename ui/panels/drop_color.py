"""The row of the drops' colour: edited, picked from the view, or taken from the scene's sky again."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session

from ..widgets import fields

PICK_TOOL = "Pick sky colour"


def drop_color(session: Session) -> None:
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

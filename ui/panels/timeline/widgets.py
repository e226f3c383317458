"""Small buttons of the Timeline panel."""

from imgui_bundle import imgui


def icon_button(icon: str, name: str, help_text: str) -> bool:
    """Draw a button with a symbol; `name` is what tests and tools call it."""
    clicked = imgui.button(f"{icon}###{name}")
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        imgui.set_tooltip(help_text)
    return clicked


def typed_number(name: str, value: float, text_format: str) -> float | None:
    """Draw a field for a number; returns what was typed once it is done: with Enter, or when the field is left."""
    changed, typed = imgui.input_float(name, value, 0, 0, text_format)
    storage, item = imgui.get_state_storage(), imgui.get_item_id()
    if changed:
        storage.set_float(item, typed)
    return storage.get_float(item, value) if imgui.is_item_deactivated_after_edit() else None


def switch(icon: str, name: str, help_text: str, *, is_on: bool) -> bool:
    """Draw a button that stays lit while something is on."""
    color = imgui.Col_.button_active if is_on else imgui.Col_.button
    imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(color))
    clicked = icon_button(icon, name, help_text)
    imgui.pop_style_color()
    return clicked

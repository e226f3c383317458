"""A button as wide as it is high, for an icon."""

from imgui_bundle import ImVec2, imgui


def square_button(icon: str, name: str) -> bool:
    """Draw it, in the middle of its square; returns whether it was clicked. `name` tells it from the panel's others."""
    side = imgui.get_frame_height()
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, imgui.get_style().frame_padding.y))
    clicked = imgui.button(f"{icon}###{name}", ImVec2(side, side))
    imgui.pop_style_var()
    return clicked

"""Colours that the timeline and what is drawn over the picture share."""

from imgui_bundle import ImVec4, imgui

KEY = ImVec4(0.93, 0.93, 0.95, 1.0)
CHOSEN = ImVec4(1.0, 0.66, 0.2, 1.0)
PLAYHEAD = ImVec4(0.95, 0.33, 0.28, 1.0)
PLAYED = ImVec4(0.38, 0.6, 0.85, 1.0)
FLIGHT = ImVec4(0.38, 0.6, 0.85, 0.45)
TOO_FAST = ImVec4(0.95, 0.33, 0.28, 0.75)
RAIN = ImVec4(0.45, 0.85, 1.0, 1.0)
PRESENT = ImVec4(0.45, 0.7, 0.5, 0.6)
OUTLINE = ImVec4(0.0, 0.0, 0.0, 0.65)


def color(value: ImVec4 | int) -> int:
    """Number of a colour for draw lists; numbers of style colours (`imgui.Col_`) follow the theme."""
    if isinstance(value, ImVec4):
        return imgui.get_color_u32(value)
    return imgui.get_color_u32(imgui.get_style_color_vec4(value))


DIM = int(imgui.Col_.text_disabled)
FAINT = int(imgui.Col_.separator)
BACKGROUND = int(imgui.Col_.frame_bg)
STRIPE = int(imgui.Col_.table_row_bg_alt)
TEXT = int(imgui.Col_.text)

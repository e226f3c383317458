"""The bar of tools at the left edge of the picture."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session

from ..shortcuts import chord_name
from ..tools import TOOLS

_GAP = 3.0
_NAVIGATE = icons_fontawesome_6.ICON_FA_ARROW_POINTER


def tool_bar(session: Session, corner: ImVec2, height: float) -> float:
    """Draw the bar over the picture; a click picks a tool, a second one puts it away. Returns how far right it goes."""
    side = 1.9 * imgui.get_font_size()
    columns = -(-(len(TOOLS) + 1) // max(int((height - 24) / (side + _GAP)), 1))
    imgui.set_cursor_screen_pos(ImVec2(corner.x + 8, corner.y + 8))
    imgui.push_style_color(imgui.Col_.child_bg, (*_panel_color(), 0.82))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(4, 4))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(_GAP, _GAP))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags = imgui.ChildFlags_.auto_resize_x | imgui.ChildFlags_.auto_resize_y
    if imgui.begin_child("tools", ImVec2(0, 0), flags | imgui.ChildFlags_.always_use_window_padding):
        if _button(_NAVIGATE, "Navigate", session.view.tool == "", side):
            session.view.tool = ""
        imgui.set_item_tooltip("Navigate: the left button orbits (Esc).")
        for number, tool in enumerate(TOOLS, start=1):
            if number % columns:
                imgui.same_line()
            if _button(tool.icon, tool.name, session.view.tool == tool.name, side):
                session.view.tool = "" if session.view.tool == tool.name else tool.name
            key = f" ({chord_name(int(tool.key))})" if tool.key is not None else ""
            imgui.set_item_tooltip(f"{tool.name}{key}: {tool.help}")
    imgui.end_child()
    imgui.pop_style_var(3)
    imgui.pop_style_color()
    return 8 + columns * (side + _GAP) + 8


def _button(icon: str, name: str, is_on: bool, side: float) -> bool:
    color = imgui.Col_.button_active if is_on else imgui.Col_.child_bg
    imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(color))
    clicked = imgui.button(f"{icon}##{name}", ImVec2(side, side))
    imgui.pop_style_color()
    return clicked


def _panel_color() -> tuple[float, float, float]:
    color = imgui.get_style_color_vec4(imgui.Col_.window_bg)
    return color.x, color.y, color.z

"""The settings of the tool in use, in a bar along the upper edge of the picture."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

from ..tools import TOOLS

_PADDING = 5.0


def tool_options(session: Session, corner: ImVec2, left: float, width: float) -> None:
    """Draw the bar over the picture, from `left` on; nothing while no tool is in use."""
    tool = next((each for each in TOOLS if each.name == session.view.tool), None)
    if tool is None:
        return
    imgui.set_cursor_screen_pos(ImVec2(corner.x + left, corner.y + 8))
    color = imgui.get_style_color_vec4(imgui.Col_.window_bg)
    imgui.push_style_color(imgui.Col_.child_bg, (color.x, color.y, color.z, 0.82))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(8, _PADDING))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("tool options", ImVec2(max(width - left - 8, 50), 0), flags):
        imgui.align_text_to_frame_padding()
        imgui.text(tool.name)
        imgui.set_item_tooltip(tool.help)
        imgui.same_line(0, 12)
        tool.options(session)
    imgui.end_child()
    imgui.pop_style_var(2)
    imgui.pop_style_color()

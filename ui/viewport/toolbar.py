"""Bars of the viewport: tools, settings of the active tool, and view options."""

from typing import get_args

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.viewport.options import Split, ViewOptions
from gsrain_engine.render.renderer import RenderMode

from ..commands.base import chord_name
from ..tools.registry import TOOLS

_GAP = 3.0
_NAVIGATE = icons_fontawesome_6.ICON_FA_ARROW_POINTER


def tool_bar(session: Editor, corner: ImVec2, height: float) -> float:
    """Draw the bar over the viewport; a click activates a tool or deactivates it. Returns its right edge."""
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


# Settings of the active tool

_PADDING = 5.0


def tool_options(session: Editor, corner: ImVec2, left: float, width: float) -> None:
    """Draw the bar over the viewport, starting at `left`; nothing without an active tool."""
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


# View options

_ICONS = icons_fontawesome_6


def view_bar(session: Editor) -> None:
    playing = session.clock.playing
    icon = _ICONS.ICON_FA_PAUSE if playing else _ICONS.ICON_FA_PLAY
    if _view_button(icon, "Play", "Start or stop time (Space)."):
        session.clock.toggle()
    if _view_button(
        _ICONS.ICON_FA_EXPAND,
        "Frame",
        "Move back until the active layer or actor, or else the whole scene, is visible (F).",
    ):
        session.frame_scene()
    if _view_button(_ICONS.ICON_FA_HOUSE, "Home", "Return to the initial view of the scene (R)."):
        session.go_home()
    if _view_button(_ICONS.ICON_FA_CAMERA, "Screenshot", "Save the viewport as PNG (F12); the log has its path."):
        session.take_screenshot()
    _, session.view.follow_path = imgui.checkbox("Follow path", session.view.follow_path)
    imgui.set_item_tooltip("Follow the camera path: your own keyframes, else the ego vehicle's drive or a swing (V).")
    imgui.same_line()
    _choice("##look", session.view, "look", get_args(RenderMode), "Render mode of the viewport.", 9, "Mode: ")
    imgui.same_line()
    _choice("##split", session.view, "split", get_args(Split), "Compare two images side by side.", 11, "Compare: ")
    imgui.same_line()
    words = f"{session.clock.time_s:.2f} s   Fly speed {session.navigation.speed_m_s:.3g} m/s"
    if imgui.calc_text_size(words).x < imgui.get_content_region_avail().x:
        imgui.text_disabled(words)
        imgui.set_item_tooltip("Time in the scene, and speed of W A S D (Ctrl+wheel). F1 shows all keys.")
    else:
        imgui.new_line()


def _view_button(icon: str, name: str, help_text: str) -> bool:
    clicked = imgui.button(f"{icon}###{name}")
    imgui.set_item_tooltip(f"{name}: {help_text}")
    imgui.same_line()
    return clicked


def _choice(
    name: str, options: ViewOptions, field: str, choices: tuple[str, ...], help_text: str, width_em: float, title: str
) -> None:
    imgui.set_next_item_width(width_em * imgui.get_font_size())
    present = getattr(options, field)
    if imgui.begin_combo(name, f"{title}{present}"):
        for each in choices:
            if imgui.selectable(each, each == present)[0]:
                setattr(options, field, each)
        imgui.end_combo()
    imgui.set_item_tooltip(help_text)

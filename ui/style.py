"""Window style: dark and light theme."""

from imgui_bundle import ImVec2, hello_imgui, imgui

from gsrain_engine.editor.preferences import Preferences

_THEMES = {"dark": hello_imgui.ImGuiTheme_.darcula_darker, "light": hello_imgui.ImGuiTheme_.light_rounded}
_MIN_TAB_PX = 30.0  # tabs shrink to this width in a narrow window before they scroll
_BEHIND_QUESTIONS = (0.0, 0.0, 0.0, 0.45)
"""Darkens the rest of the window in both themes; the dark theme's default would brighten it."""


def apply_style(preferences: Preferences) -> None:
    for_screen = imgui.get_style().font_scale_dpi
    hello_imgui.apply_theme(_THEMES[preferences.theme])
    style = imgui.get_style()
    style.frame_rounding = style.grab_rounding = 3.0
    style.frame_border_size = 1.0  # the light theme has none: unchecked boxes would be white on white
    style.window_rounding = 0.0
    style.popup_rounding = 4.0
    style.window_menu_button_position = imgui.Dir.none
    style.tab_min_width_shrink = _MIN_TAB_PX
    style.docking_node_has_close_button = False
    style.item_spacing = ImVec2(8, 5)
    style.frame_padding = ImVec2(7, 4)
    style.scale_all_sizes(preferences.ui_scale)
    style.font_scale_main = preferences.font_scale
    style.font_scale_dpi = for_screen
    style.set_color_(imgui.Col_.modal_window_dim_bg, _BEHIND_QUESTIONS)
    color = style.color_(imgui.Col_.popup_bg)
    style.set_color_(imgui.Col_.popup_bg, (color.x, color.y, color.z, 0.98))

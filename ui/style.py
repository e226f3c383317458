"""The look of the window: dark, quiet, a little room around things."""

from imgui_bundle import ImVec2, hello_imgui, imgui


def apply_style() -> None:
    """Set colours and spacing."""
    hello_imgui.apply_theme(hello_imgui.ImGuiTheme_.darcula_darker)
    style = imgui.get_style()
    style.frame_rounding = style.grab_rounding = 3.0
    style.window_rounding = 0.0
    style.item_spacing = ImVec2(8, 5)
    style.frame_padding = ImVec2(7, 4)

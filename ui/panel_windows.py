"""The windows that panels are drawn in: shown, hidden, brought to the front."""

from imgui_bundle import hello_imgui


def panel_windows() -> list[hello_imgui.DockableWindow]:
    """All but the picture, which is always there."""
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows
    return [each for each in windows if each.include_in_view_menu]


def bring_to_front(window: hello_imgui.DockableWindow) -> None:
    """Show a panel in front of those that share its place."""
    window.is_visible = window.focus_window_at_next_frame = True

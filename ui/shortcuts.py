"""Keys that work everywhere in the window, unless a text field has them."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

_CTRL, _SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift


def handle_shortcuts(session: Session) -> None:
    """Act on the keys that were pressed since the last frame."""
    if imgui.get_io().want_text_input:
        return
    actions = {
        _CTRL | imgui.Key.z: session.undo,
        _CTRL | _SHIFT | imgui.Key.z: session.redo,
        _CTRL | imgui.Key.y: session.redo,
        imgui.Key.f: session.frame_scene,
        imgui.Key.r: session.go_home,
        imgui.Key.home: session.go_home,
        imgui.Key.space: session.clock.toggle,
        imgui.Key.f12: session.take_screenshot,
    }
    for chord, action in actions.items():
        if imgui.is_key_chord_pressed(chord):
            action()

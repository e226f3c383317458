"""Keys that work everywhere in the window, unless a text field has them."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session


def chord(*keys: imgui.Key) -> int:
    """Combine modifiers and a key; as numbers, since Python before 3.11.4 can't combine these enumerations."""
    combined = 0
    for key in keys:
        combined |= int(key)
    return combined


def handle_shortcuts(session: Session) -> None:
    """Act on the keys that were pressed since the last frame."""
    if imgui.get_io().want_text_input:
        return
    key = imgui.Key
    actions = {
        chord(key.mod_ctrl, key.z): session.undo,
        chord(key.mod_ctrl, key.mod_shift, key.z): session.redo,
        chord(key.mod_ctrl, key.y): session.redo,
        chord(key.f): session.frame_scene,
        chord(key.r): session.go_home,
        chord(key.home): session.go_home,
        chord(key.space): session.clock.toggle,
        chord(key.f12): session.take_screenshot,
    }
    for keys, action in actions.items():
        if imgui.is_key_chord_pressed(keys):
            action()

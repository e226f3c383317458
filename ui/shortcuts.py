"""Keys as numbers that Dear ImGui understands, and as words that a person reads."""

from imgui_bundle import imgui

_MODIFIERS = ((imgui.Key.mod_ctrl, "Ctrl"), (imgui.Key.mod_shift, "Shift"), (imgui.Key.mod_alt, "Alt"))
_WORDS = {
    "LeftBracket": "[", "RightBracket": "]", "Comma": ",", "Period": ".", "LeftArrow": "Left", "RightArrow": "Right",
    "UpArrow": "Up", "DownArrow": "Down", "Escape": "Esc", "Slash": "/", "Minus": "-", "Equal": "=",
}  # fmt: skip


def chord(*keys: imgui.Key) -> int:
    """Combine modifiers and a key; as numbers, since Python before 3.11.4 can't combine these enumerations."""
    combined = 0
    for key in keys:
        combined |= int(key)
    return combined


def chord_name(keys: int) -> str:
    """Write a chord as people do, such as "Ctrl+Shift+Z"."""
    words: list[str] = []
    for modifier, word in _MODIFIERS:
        if keys & int(modifier):
            words.append(word)
            keys &= ~int(modifier)
    name = imgui.get_key_name(imgui.Key(keys))
    return "+".join([*words, _WORDS.get(name, name)])

"""Key chords as numbers and text."""

from functools import cache

from imgui_bundle import imgui

from .table import Command

_MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}

_SHORT_NAMES = {
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
    """Format a chord, such as "Ctrl+Shift+Z"."""
    modifiers = [name for name, key in _MODIFIERS.items() if keys & int(key)]
    return "+".join([*modifiers, _key_name(keys & ~chord(*_MODIFIERS.values()))])


@cache
def parse_chord(name: str) -> int:
    """Return the chord of a name, such as "Ctrl+Shift+Z"."""
    *modifiers, key = name.split("+")
    named = range(int(imgui.Key.named_key_begin), int(imgui.Key.named_key_end))
    return chord(*(_MODIFIERS[each] for each in modifiers)) | next(each for each in named if _key_name(each) == key)


def chords_of(command: Command) -> tuple[int, ...]:
    return tuple(map(parse_chord, command.key_names.split(" or "))) if command.key_names else ()


def _key_name(key: int) -> str:
    name = imgui.get_key_name(imgui.Key(key))
    return _SHORT_NAMES.get(name, name)

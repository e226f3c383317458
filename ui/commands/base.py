"""Commands with a name and keys, as listed in menus, command palette and keyboard page."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor

from ..parts import bind_parts


@dataclass(frozen=True)
class Command:
    """A user command. Its functions get the editor's parts that their parameters name."""

    name: str
    """Unique title in menu and palette, starting with a verb."""
    run: Callable[..., object]
    menu: str = ""
    """Title of its menu; "" for commands in palette and keys only."""
    key_names: str = ""
    """Key chords, such as "Ctrl+Shift+Z or Ctrl+Y"; the menu shows the first."""
    help: str = ""
    """One sentence, with the units of any numbers."""
    is_possible: Callable[..., bool] = lambda: True
    is_on: Callable[..., bool] | None = None
    """State of a toggle command."""
    more: Callable[..., str] | None = None
    """Suffix of the name in the menu, such as the step that undo would revert."""

    @property
    def chords(self) -> tuple[int, ...]:
        return tuple(map(parse_chord, self.key_names.split(" or "))) if self.key_names else ()

    def title(self, editor: Editor) -> str:
        return self.name if self.more is None else f"{self.name} {bind_parts(self.more, editor)()}".strip()

    def can_run(self, editor: Editor) -> bool:
        return bind_parts(self.is_possible, editor)()

    def is_checked(self, editor: Editor) -> bool:
        """State of a toggle command."""
        return self.is_on is not None and bind_parts(self.is_on, editor)()

    def perform(self, editor: Editor) -> None:
        """Run the command, if that is possible."""
        if self.can_run(editor):
            bind_parts(self.run, editor)()


# Key chords as numbers and text

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


def _key_name(key: int) -> str:
    name = imgui.get_key_name(imgui.Key(key))
    return _SHORT_NAMES.get(name, name)

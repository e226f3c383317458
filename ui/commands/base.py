"""Commands with a name and keys, as listed in menus, command palette and keyboard page."""

from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor


def always(session: Editor) -> bool:
    return True


@dataclass(frozen=True)
class Command:
    """A user command."""

    name: str
    """Unique title in menu and palette, starting with a verb."""
    run: Callable[[Editor], None]
    menu: str = ""
    """Title of its menu; "" for commands in palette and keys only."""
    keys: int | tuple[int, ...] = ()
    """Key chords, the first of which is shown; see `chord`."""
    help: str = ""
    """One sentence, with the units of any numbers."""
    is_possible: Callable[[Editor], bool] = always
    is_on: Callable[[Editor], bool] | None = None
    """State of a toggle command."""
    more: Callable[[Editor], str] | None = None
    """Suffix of the name in the menu, such as the step that undo would revert."""

    @property
    def chords(self) -> tuple[int, ...]:
        return (self.keys,) if isinstance(self.keys, int) else self.keys

    @property
    def key_names(self) -> str:
        return " or ".join(map(chord_name, self.chords))

    def title(self, session: Editor) -> str:
        return f"{self.name} {self.more(session)}".strip() if self.more is not None else self.name

    def perform(self, session: Editor) -> None:
        if self.is_possible(session):
            self.run(session)


# Key chords as numbers and text

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
    """Format a chord, such as "Ctrl+Shift+Z"."""
    words: list[str] = []
    for modifier, word in _MODIFIERS:
        if keys & int(modifier):
            words.append(word)
            keys &= ~int(modifier)
    name = imgui.get_key_name(imgui.Key(keys))
    return "+".join([*words, _WORDS.get(name, name)])

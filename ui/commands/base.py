"""What a person can do, with a name and a key: menus, keys, command palette and keyboard page show the same list."""

from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor


def always(session: Editor) -> bool:
    """Whether it can be done: at any time."""
    return True


@dataclass(frozen=True)
class Command:
    """One thing to do."""

    name: str
    """As in menu and palette: a verb first. Unique."""
    run: Callable[[Editor], None]
    menu: str = ""
    """Title of the menu that it stands in; "" is in none, only in palette and keys."""
    keys: int | tuple[int, ...] = ()
    """Key chords, the first one shown; see `chord`."""
    help: str = ""
    """One sentence, with units where there are numbers."""
    is_possible: Callable[[Editor], bool] = always
    is_on: Callable[[Editor], bool] | None = None
    """For what is switched on and off: whether it is on."""
    more: Callable[[Editor], str] | None = None
    """What follows the name in the menu, such as the step that undo would take back."""

    @property
    def chords(self) -> tuple[int, ...]:
        return (self.keys,) if isinstance(self.keys, int) else self.keys

    @property
    def key_names(self) -> str:
        return " or ".join(map(chord_name, self.chords))

    def title(self, session: Editor) -> str:
        """Name with what follows it now."""
        return f"{self.name} {self.more(session)}".strip() if self.more is not None else self.name

    def perform(self, session: Editor) -> None:
        """Do it, if it is possible."""
        if self.is_possible(session):
            self.run(session)


# § Keys as numbers that Dear ImGui understands, and as words that a person reads.

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

"""The command palette: every action, tool and panel by its name, with its key."""

from collections.abc import Callable
from typing import NamedTuple

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

from ..actions import ACTIONS
from ..panel_windows import bring_to_front, panel_windows
from ..shortcuts import chord_name
from ..tools import TOOLS

TITLE = "Find a command"
_WIDTH_EM, _LINES = 34.0, 14


class _Command(NamedTuple):
    name: str
    keys: str
    help: str
    is_possible: bool
    run: Callable[[], None]


class CommandPalette:
    """A list that narrows while a person types; keeps what was typed and which line is chosen."""

    def __init__(self) -> None:
        self._typed = ""
        self._line = 0

    def draw(self, session: Session) -> None:
        if session.view.dialog == "commands" and not imgui.is_popup_open(TITLE):
            self._typed, self._line = "", 0
            imgui.open_popup(TITLE)
        middle = imgui.get_main_viewport().get_center()
        imgui.set_next_window_pos(ImVec2(middle.x, 0.14 * 2 * middle.y), imgui.Cond_.appearing, ImVec2(0.5, 0))
        imgui.set_next_window_size(ImVec2(_WIDTH_EM * imgui.get_font_size(), 0))
        if not imgui.begin_popup(TITLE):
            if session.view.dialog == "commands":
                session.view.dialog = ""
            return
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        changed, self._typed = imgui.input_text_with_hint("##typed", "Type a command", self._typed)
        found = [each for each in _commands(session) if matches(each.name, self._typed)]
        self._move(changed, len(found))
        chosen = self._list(found)
        if chosen is not None or imgui.is_key_pressed(imgui.Key.escape):
            session.view.dialog = ""
            imgui.close_current_popup()
        imgui.end_popup()
        if chosen is not None:
            chosen.run()

    def _move(self, changed: bool, count: int) -> None:
        step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
        self._line = 0 if changed else min(max(self._line + step, 0), max(count - 1, 0))

    def _list(self, found: list[_Command]) -> _Command | None:
        chosen = None
        enter = imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter)
        if imgui.begin_child("lines", ImVec2(0, _LINES * imgui.get_text_line_height_with_spacing())):
            for number, each in enumerate(found):
                imgui.begin_disabled(not each.is_possible)
                clicked, _ = imgui.selectable(f"{each.name}##{number}", number == self._line)
                if each.help:
                    imgui.set_item_tooltip(each.help)
                if number == self._line:
                    imgui.set_scroll_here_y(0.5) if not imgui.is_item_visible() else None
                size = imgui.calc_text_size(each.keys)
                imgui.same_line(imgui.get_window_width() - size.x - 2 * imgui.get_font_size())
                imgui.text_disabled(each.keys)
                imgui.end_disabled()
                if each.is_possible and (clicked or (enter and number == self._line)):
                    chosen = each
            if not found:
                imgui.text_disabled("Nothing of that name.")
        imgui.end_child()
        return chosen


def matches(name: str, typed: str) -> bool:
    """Whether every word that was typed is somewhere in the name."""
    return all(word in name.lower() for word in typed.lower().split())


def _commands(session: Session) -> list[_Command]:
    tools = [
        _Command(
            f"Tool: {tool.name}",
            chord_name(int(tool.key)) if tool.key is not None else "",
            tool.help,
            True,
            lambda tool=tool: setattr(session.view, "tool", tool.name),
        )
        for tool in TOOLS
    ]
    actions = [
        _Command(
            action.title(session),
            action.key_names,
            action.help,
            action.is_possible(session),
            lambda action=action: action.perform(session),
        )
        for action in ACTIONS
    ]
    panels = [
        _Command(f"Panel: {each.label}", "", "Bring it to the front.", True, lambda each=each: bring_to_front(each))
        for each in panel_windows()
    ]
    return actions + tools + panels

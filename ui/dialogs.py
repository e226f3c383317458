"""Dialogs: About page, keyboard page, questions, and the command palette."""

from collections.abc import Callable
from importlib.metadata import version
from typing import NamedTuple

from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.notifications import Answer, Question

from .commands.base import chord_name
from .commands.registry import ACTIONS
from .shell import bring_to_front, panel_windows
from .tools.registry import TOOLS
from .widgets.fields import SCENE_FOLDERS, ask_where_to_save

ABOUT_TITLE = "About GSRAIN"


def about_page(session: Editor) -> None:
    if session.view.dialog == "about" and not imgui.is_popup_open(ABOUT_TITLE):
        imgui.open_popup(ABOUT_TITLE)
    imgui.set_next_window_size(ImVec2(30 * imgui.get_font_size(), 0))
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, ImVec2(0.5, 0.5))
    is_open, _ = imgui.begin_popup_modal(ABOUT_TITLE, True)
    if not is_open:
        if session.view.dialog == "about":
            session.view.dialog = ""
        return
    imgui.text(f"GSRAIN {version('gsrain')}, Apache-2.0")
    imgui.text_wrapped("Calibrated rain in captured 3D Gaussian Splatting scenes: a viewer, an editor, a test bench.")
    imgui.text(f"Drawn by: {session.backend or 'nothing yet'}")
    imgui.text_wrapped("docs/physics.md gives each equation with its source.")
    if imgui.is_key_pressed(imgui.Key.escape):
        session.view.dialog = ""
        imgui.close_current_popup()
    imgui.end_popup()


# Keyboard and mouse page

KEYBOARD_TITLE = "Keyboard and mouse"

MOUSE_AND_FLIGHT = (
    ("Left drag", "Orbit, or what the tool does"),
    ("Right drag", "Look around"),
    ("Middle drag", "Move sideways and up"),
    ("Wheel", "Nearer, farther"),
    ("Ctrl+Wheel", "Fly faster or slower"),
    ("W A S D", "Fly forward, left, back, right"),
    ("Q E", "Fly down, up"),
    ("Shift", "Fly four times as fast"),
)


def keyboard_page(session: Editor) -> None:
    if session.view.dialog == "keys" and not imgui.is_popup_open(KEYBOARD_TITLE):
        imgui.open_popup(KEYBOARD_TITLE)
    size = imgui.get_main_viewport().size
    imgui.set_next_window_size(ImVec2(0.8 * size.x, 0.8 * size.y), imgui.Cond_.appearing)
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, ImVec2(0.5, 0.5))
    is_open, _ = imgui.begin_popup_modal(KEYBOARD_TITLE, True)
    if not is_open:
        if session.view.dialog == "keys":
            session.view.dialog = ""
        return
    tools = [(chord_name(int(tool.key)), f"Tool: {tool.name}") for tool in TOOLS if tool.key is not None]
    groups = [("Mouse and flight", list(MOUSE_AND_FLIGHT)), ("Tools", tools)]
    for menu in dict.fromkeys(action.menu for action in ACTIONS):
        actions = [(action.key_names, action.name) for action in ACTIONS if action.menu == menu and action.chords]
        groups.append((menu or "Other", actions))
    columns = max(1, int(imgui.get_content_region_avail().x / (26 * imgui.get_font_size())))
    if imgui.begin_table("groups", columns):
        for title, rows in groups:
            if rows:
                imgui.table_next_column()
                _group(title, rows)
        imgui.end_table()
    if imgui.is_key_pressed(imgui.Key.escape):
        session.view.dialog = ""
        imgui.close_current_popup()
    imgui.end_popup()


def _group(title: str, rows: list[tuple[str, str]]) -> None:
    imgui.separator_text(title)
    if imgui.begin_table(title, 2, imgui.TableFlags_.sizing_fixed_fit):
        for keys, what in rows:
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text_disabled(keys)
            imgui.table_next_column()
            imgui.text(what)
        imgui.end_table()


# Questions of the session

_WIDTH_EM = 34.0


def draw_questions(session: Editor) -> None:
    """Draw the current question until it is answered, and the save dialog if one is requested."""
    wanted, session.files.place_wanted = session.files.place_wanted, None
    if wanted is not None:
        ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: wanted(chosen[0]))
    question = session.questions.present
    _let_keys_choose(question is not None)
    if question is None:
        return
    session.view.dialog = ""  # nothing else is on top of it
    if not imgui.is_popup_open(question.title):
        imgui.open_popup(question.title)
    imgui.set_next_window_size(ImVec2(_WIDTH_EM * imgui.get_font_size(), 0))
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
    flags = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse
    if not imgui.begin_popup_modal(question.title, None, flags | imgui.WindowFlags_.no_saved_settings)[0]:
        return
    imgui.spacing()
    imgui.text_wrapped(question.text)
    if question.progress is not None:
        progress = question.progress()
        imgui.spacing()
        imgui.progress_bar(progress.fraction, ImVec2(-1, 0), f"{progress.message}: {100 * progress.fraction:.0f} %")
    imgui.spacing()
    imgui.spacing()
    given = _clicked_answer(question)
    if given is not None:
        imgui.close_current_popup()
    imgui.end_popup()
    if given is not None:
        session.questions.answer(given)


def _clicked_answer(question: Question) -> Answer | None:
    """Draw the buttons, aligned right; returns the answer clicked in this frame."""
    style = imgui.get_style()
    least = 6 * imgui.get_font_size()
    widths = [
        max(least, imgui.calc_text_size(each.label).x + 2 * style.frame_padding.x + imgui.get_font_size())
        for each in question.answers
    ]
    wide = sum(widths) + style.item_spacing.x * (len(widths) - 1)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(0.0, imgui.get_content_region_avail().x - wide))
    given: Answer | None = None
    for n, (answer, width) in enumerate(zip(question.answers, widths, strict=True)):
        if n > 0:
            imgui.same_line()
        if imgui.button(answer.label, ImVec2(width, 0)):
            given = answer
        if n == 0:
            imgui.set_item_default_focus()
            if imgui.is_window_appearing():  # Enter and Space act on the focused button if the focus is visible
                imgui.set_nav_cursor_visible(question.enter_answers)
        keys = {0: " (Enter)" if question.enter_answers else "", len(question.answers) - 1: " (Escape)"}.get(n, "")
        imgui.set_item_tooltip(f"{answer.help or answer.label}{keys}")
    if imgui.is_key_pressed(imgui.Key.escape):
        return question.answers[-1]
    if given is not None:
        return given
    is_entered = imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter)
    if is_entered and question.enter_answers:
        return question.answers[0]
    return None


def _let_keys_choose(is_asking: bool) -> None:
    """Use Tab and arrows to move between answers while a question is open; otherwise they are keys of the view."""
    io, keyboard = imgui.get_io(), int(imgui.ConfigFlags_.nav_enable_keyboard)
    io.config_flags = io.config_flags | keyboard if is_asking else io.config_flags & ~keyboard


# Command palette

PALETTE_TITLE = "Find a command"
_PALETTE_WIDTH_EM, _LINES = 34.0, 14


class _Command(NamedTuple):
    name: str
    keys: str
    help: str
    is_possible: bool
    run: Callable[[], None]


class CommandPalette:
    """Searchable list of commands, tools and panels; stores the typed text and the active line."""

    def __init__(self) -> None:
        self._typed = ""
        self._line = 0

    def draw(self, session: Editor) -> None:
        if session.view.dialog == "commands" and not imgui.is_popup_open(PALETTE_TITLE):
            self._typed, self._line = "", 0
            imgui.open_popup(PALETTE_TITLE)
        middle = imgui.get_main_viewport().get_center()
        imgui.set_next_window_pos(ImVec2(middle.x, 0.14 * 2 * middle.y), imgui.Cond_.appearing, ImVec2(0.5, 0))
        imgui.set_next_window_size(ImVec2(_PALETTE_WIDTH_EM * imgui.get_font_size(), 0))
        if not imgui.begin_popup(PALETTE_TITLE):
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
    return all(word in name.lower() for word in typed.lower().split())


def _commands(session: Editor) -> list[_Command]:
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
        _Command(
            f"Panel: {each.label.partition('###')[0]}",
            "",
            "Bring it to the front.",
            True,
            lambda each=each: bring_to_front(each),
        )
        for each in panel_windows()
    ]
    return actions + tools + panels

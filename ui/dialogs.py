"""Dialogs: About page, keyboard page, import of a measured series, questions, and the command palette."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache, lru_cache, partial
from importlib.metadata import version
from typing import NamedTuple

from imgui_bundle import ImVec2, imgui

from gsrain_engine.disdrometer.rain_rates import MeasuredKeyframes, keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerReading
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.rain_keyframes import replace_keyframes
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.news import News, read_news
from gsrain_engine.editor.status import Answer, Question, StatusBus
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.editor.views import NamedViews

from .commands.keys import chord_name, chords_of
from .commands.table import COMMANDS, VIEW_KEYS, all_commands, help_of
from .folding import bring_to_front, panel_windows
from .panels.registry import all_panels
from .panels.views import name_field, view_options
from .tools import TOOLS
from .widgets.fields import LOGARITHMIC, button
from .widgets.file_dialogs import SCENE_FOLDERS, ask_where_to_save
from .widgets.popups import free_height, place_dialog
from .widgets.text import key_names, visible_name
from .widgets.type_ahead import is_menu_open


@contextmanager
def _page(viewport: ViewportState, name: str, title: str, width_em: float, height_em: float = 0.0) -> Generator[bool]:
    """Begin the page that `viewport.options.dialog` names; yields True while it is open. Escape closes it.

    A height of 0 is that of the content; others can be changed.
    """
    if viewport.options.dialog == name and not imgui.is_popup_open(title):
        imgui.open_popup(title)
    place_dialog(width_em, height_em, imgui.Cond_.appearing if height_em else imgui.Cond_.none)
    is_open, _ = imgui.begin_popup_modal(title, True)
    yield is_open
    if is_open:
        if imgui.is_key_pressed(imgui.Key.escape):
            viewport.options.dialog = ""
            imgui.close_current_popup()
        imgui.end_popup()
    elif viewport.options.dialog == name:
        viewport.options.dialog = ""


def about_page(viewport: ViewportState) -> None:
    with _page(viewport, "about", "About GSRAIN", 30) as is_open:
        if is_open:
            imgui.text(f"GSRAIN {version('gsrain')}, Apache-2.0")
            imgui.text_wrapped(
                "Calibrated rain in captured 3D Gaussian Splatting scenes: a viewer, an editor, a test bench."
            )
            imgui.text(f"Drawn by: {viewport.backend or 'nothing yet'}")
            imgui.text_wrapped("The page Physics of the documentation gives each equation with its source.")


def news_page(viewport: ViewportState) -> None:
    """Draw what is new in this version."""
    with _page(viewport, "news", "What's new", 40) as is_open:
        if not is_open:
            return
        news = _news()
        imgui.text_disabled(f"GSRAIN {version('gsrain')}: {news.heading}")
        imgui.spacing()
        for each in news.lines:
            imgui.bullet()
            imgui.text_wrapped(each)
        imgui.spacing()
        if imgui.button("Close###close news"):
            viewport.options.dialog = ""
            imgui.close_current_popup()


@cache
def _news() -> News:
    try:
        return read_news()
    except OSError as error:
        return News(f"CHANGELOG.md can't be read: {error.strerror or error}", ())


_MOUSE_AND_FLIGHT = [
    ("Left drag", "Orbit, or what the tool does"), ("Right drag", "Look around"),
    ("Middle drag", "Move sideways and up"), ("Wheel", "Nearer, farther"), ("Wheel sideways", "Move sideways"),
    ("Ctrl+Wheel", "Fly faster or slower"),
    ("W A S D", "Fly forward, left, back, right"), ("Q E", "Fly down, up"), ("Shift", "Fly four times as fast"),
]  # fmt: skip


def keyboard_page(viewport: ViewportState) -> None:
    with _page(viewport, "keys", "Keyboard and mouse", 84, 48) as is_open:
        if not is_open:
            return
        tools = [(chord_name(int(tool.key)), f"Tool: {tool.name}") for tool in TOOLS if tool.key is not None]
        groups = [("Mouse and flight", _MOUSE_AND_FLIGHT), ("Tools", tools)]
        for menu in dict.fromkeys(command.menu for command in COMMANDS):
            commands = [
                (command.key_names, command.name) for command in COMMANDS if command.menu == menu and chords_of(command)
            ]
            groups.append((menu or "Other", commands))
        columns = max(1, int(imgui.get_content_region_avail().x / (26 * imgui.get_font_size())))
        if imgui.begin_table("groups", columns):
            for title, rows in groups:
                if rows:
                    imgui.table_next_column()
                    _group(title, rows)
            imgui.end_table()


def _group(title: str, rows: list[tuple[str, str]]) -> None:
    imgui.separator_text(title)
    if imgui.begin_table(title, 2):
        imgui.table_setup_column("keys", imgui.TableColumnFlags_.width_fixed)
        imgui.table_setup_column("effect", imgui.TableColumnFlags_.width_stretch)
        for keys, effect in rows:
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text_disabled(key_names(keys))
            imgui.table_next_column()
            imgui.text_wrapped(effect)
        imgui.end_table()


# Name of a view


def save_view_page(viewport: ViewportState, views: NamedViews) -> None:
    """Ask for the name of the present view."""
    with _page(viewport, "save view", "Save view", 24) as is_open:
        if not is_open:
            return
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        is_entered = name_field(views, -1)
        view_options(views)
        is_saved = button("Save", "Save the present view under this name (Enter).", enabled=views.can_save)
        imgui.same_line()
        if button("Cancel", "Save no view (Escape).") or ((is_saved or is_entered) and views.save_typed()):
            viewport.options.dialog = ""
            imgui.close_current_popup()


# Import of a measured series


def series_page(editor: Editor) -> None:
    """Draw how a disdrometer file that has been read becomes rain keyframes."""
    document, calibration, options = editor.document, editor.calibration, editor.viewport.options
    series = calibration.series
    if series is None or editor.status.question is not None:
        return
    try:
        measured = _keyframes_of(series.reading, series.speed_up, series.start_s)
    except ValueError as error:
        calibration.series = None
        editor.status.report(f"{series.name}: {error}")
        return
    options.dialog = "series"
    with _page(editor.viewport, "series", "Import disdrometer series", _WIDTH_EM) as is_open:
        if is_open:
            imgui.text_wrapped(series.name)
            imgui.text_wrapped(
                f"{measured.summary}. Maximum: {measured.weather.heaviest_mm_h(document.rain):.1f} mm/h."
            )
            imgui.set_next_item_width(5.5 * imgui.get_font_size())
            _, series.speed_up = imgui.drag_float(
                "Times faster", series.speed_up, 0.5, 1.0, 10_000.0, "%.0f", LOGARITHMIC
            )
            imgui.set_item_tooltip("Compresses time: at 60, a minute of the series takes a second of the scene.")
            imgui.set_next_item_width(5.5 * imgui.get_font_size())
            _, series.start_s = imgui.drag_float("Starts at (s)", series.start_s, 0.1, -1e6, 1e6, "%.1f")
            imgui.set_item_tooltip("Time of the first record in the scene, in seconds.")
            is_used = button("Use it", "Replace the present keyframes by the series.")
            imgui.same_line()
            if button("Cancel", "Do not change the keyframes.") or is_used:
                options.dialog = ""
                imgui.close_current_popup()
            if is_used:
                document.edit_keyframes(f"Series {series.name}", replace_keyframes, measured.weather)
                editor.playback.show_all()
    if options.dialog != "series":
        calibration.series = None


@lru_cache(maxsize=1)
def _keyframes_of(reading: DisdrometerReading, speed_up: float, start_s: float) -> MeasuredKeyframes:
    return keyframes_from_spectra(reading, speed_up=speed_up, start_s=start_s)


# Questions of the editor

_WIDTH_EM = 34.0


def draw_questions(viewport: ViewportState, files: Files, status: StatusBus) -> None:
    """Draw the current question until it is answered, and the save dialog if one is requested."""
    save, files.place_request = files.place_request, None
    if save is not None:
        name = files.proposed_name()
        ask_where_to_save(
            "Save the scene", SCENE_FOLDERS, lambda chosen: save(chosen[0]), proposed=name, confirms=False
        )
    question = status.question
    # Tab and arrows move between answers and items while a question, menu or list is open, else they are the view's.
    io, keyboard = imgui.get_io(), int(imgui.ConfigFlags_.nav_enable_keyboard)
    is_open = question is not None or is_menu_open()
    io.config_flags = io.config_flags | keyboard if is_open else io.config_flags & ~keyboard
    if question is None:
        return
    viewport.options.dialog = ""  # nothing else is on top of it
    if not imgui.is_popup_open(question.title):
        imgui.open_popup(question.title)
    place_dialog(_WIDTH_EM, pos_cond=imgui.Cond_.always)
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
    answer = _chosen_answer(question)
    if answer is not None:
        imgui.close_current_popup()
    imgui.end_popup()
    if answer is not None:
        status.answer(answer)


def _chosen_answer(question: Question) -> Answer | None:
    """Draw the buttons, aligned right, or below each other in a narrow window; returns the answer of this frame."""
    style, em = imgui.get_style(), imgui.get_font_size()
    margin = 2 * style.frame_padding.x + em
    widths = [max(6 * em, imgui.calc_text_size(each.label).x + margin) for each in question.answers]
    wide, room = sum(widths) + style.item_spacing.x * (len(widths) - 1), imgui.get_content_region_avail().x
    is_row = wide <= room
    if is_row:
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - wide)
    clicked: Answer | None = None
    for n, (answer, width) in enumerate(zip(question.answers, widths, strict=True)):
        if n > 0 and is_row:
            imgui.same_line()
        if imgui.button(answer.label, ImVec2(width if is_row else -1, 0)):
            clicked = answer
        if n == 0:
            imgui.set_item_default_focus()
            if imgui.is_window_appearing():  # Enter and Space act on the focused button if the focus is visible
                imgui.set_nav_cursor_visible(question.enter_answers)
        keys = {0: " (Enter)" if question.enter_answers else "", len(question.answers) - 1: " (Escape)"}.get(n, "")
        imgui.set_item_tooltip(f"{answer.help or answer.label}{keys}")
    if imgui.is_window_appearing():  # Enter and Escape have closed a dialog in this frame, and answer nothing yet
        return clicked
    if imgui.is_key_pressed(imgui.Key.escape, repeat=False):
        return question.answers[-1]
    is_entered = any(imgui.is_key_pressed(each, repeat=False) for each in (imgui.Key.enter, imgui.Key.keypad_enter))
    return question.answers[0] if clicked is None and is_entered and question.enter_answers else clicked


# Command palette

_PALETTE_TITLE = "Find a command"
_LINES = 14


class _PaletteRow(NamedTuple):
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

    def draw(self, editor: Editor) -> None:
        if editor.viewport.options.dialog == "commands" and not imgui.is_popup_open(_PALETTE_TITLE):
            self._typed, self._line = "", 0
            imgui.open_popup(_PALETTE_TITLE)
        place_dialog(_WIDTH_EM)
        if not imgui.begin_popup(_PALETTE_TITLE):
            if editor.viewport.options.dialog == "commands":
                editor.viewport.options.dialog = ""
            return
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        changed, self._typed = imgui.input_text_with_hint("##typed", "Type a command", self._typed)
        words = self._typed.lower().split()
        found = _found(_rows(editor), words)
        step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
        self._line = 0 if changed else min(max(self._line + step, 0), max(len(found) - 1, 0))
        chosen = self._list(found)
        if chosen is not None or imgui.is_key_pressed(imgui.Key.escape):
            editor.viewport.options.dialog = ""
            imgui.close_current_popup()
        imgui.end_popup()
        if chosen is not None:
            chosen.run()

    def _list(self, found: list[_PaletteRow]) -> _PaletteRow | None:
        """Draw the list; returns the row that is clicked or entered in this frame."""
        chosen = None
        enter = imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter)
        below = imgui.get_frame_height_with_spacing() + 3 * imgui.get_style().window_padding.y
        height = min(_LINES * imgui.get_text_line_height_with_spacing(), free_height(below))
        if imgui.begin_child("lines", ImVec2(0, height)):
            for number, each in enumerate(found):
                imgui.begin_disabled(not each.is_possible)
                clicked, _ = imgui.selectable(f"{each.name}##{number}", number == self._line)
                if each.help:
                    imgui.set_item_tooltip(each.help)
                if number == self._line and not imgui.is_item_visible():
                    imgui.set_scroll_here_y(0.5)
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


def _found(rows: list[_PaletteRow], words: list[str]) -> list[_PaletteRow]:
    """Return rows with all words: first those with them in the name, then those with some in the help."""
    by_name = [row for row in rows if all(word in row.name.lower() for word in words)]
    by_help = [row for row in rows if all(word in f"{row.name} {row.help}".lower() for word in words)]
    return by_name + [row for row in by_help if row not in by_name]


def _rows(editor: Editor) -> list[_PaletteRow]:
    rows = [
        _PaletteRow(
            each.title(editor),
            key_names(each.key_names),
            each.help,
            each.can_run(editor),
            partial(each.perform, editor),
        )
        for each in all_commands()
        if each.is_listed(editor)
    ]
    for tool in TOOLS:
        keys = chord_name(int(tool.key)) if tool.key is not None else ""
        choose = partial(setattr, editor.viewport.options, "tool", tool.name)
        rows.append(_PaletteRow(f"Tool: {tool.name}", keys, tool.help, True, choose))
    for view in editor.views.views[VIEW_KEYS:]:
        go = partial(editor.views.go_to, view.name)
        rows.append(_PaletteRow(f"Go to view {visible_name(view.name)}", "", help_of("Go to view 1"), True, go))
    for window in panel_windows():
        show = partial(bring_to_front, window)
        rows.append(_PaletteRow(f"Panel: {window.label.partition('###')[0]}", "", "Bring it to the front.", True, show))
    for panel in all_panels():
        show = partial(setattr, editor.viewport.options, "guide", panel.page)
        rows.append(_PaletteRow(f"Help: {panel.title}", "", "Open its page of the guide.", True, show))
    return rows

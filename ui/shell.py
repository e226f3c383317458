"""Window shell: key chords, menu bar, panel windows and status bar."""

import logging
import time
from datetime import datetime, timedelta

from imgui_bundle import ImVec2, hello_imgui, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.views import NamedViews

from .commands.keys import chord, chords_of, parse_chord
from .commands.table import COMMANDS, VIEW_KEYS, Command, all_command_groups
from .folding import bring_to_front, panel_windows
from .panels.jobs import job_tray, tray_width
from .tools import TOOLS
from .widgets.fields import warning_color
from .widgets.text import key_names, label, shortened
from .widgets.type_ahead import has_keys

_NO_OWNER = 0xFFFFFFFF  # ImGuiKeyOwner_NoOwner


def act_on_keys(editor: Editor) -> None:
    """Run the commands and tools of the keys pressed since the last frame.

    None of them if a text field has the focus, and none of keys that a widget uses, such as the arrows of a compass.
    """
    if imgui.get_io().want_text_input or has_keys():
        return
    for tool in TOOLS:
        if tool.key is not None and imgui.is_key_chord_pressed(chord(tool.key)):
            editor.viewport.options.tool = "" if editor.viewport.options.tool == tool.name else tool.name
    for command in COMMANDS:
        if any(imgui.is_key_chord_pressed(keys) and not _is_used(keys) for keys in chords_of(command)):
            command.perform(editor)


def _is_used(keys: int) -> bool:
    """Return True if a widget that has the focus uses the key of a chord."""
    key = imgui.Key(keys & ~int(imgui.Key.mod_mask_))
    return not imgui.internal.test_key_owner(key, _NO_OWNER)


# Menu bar

MENUS = ("File", "Edit", "Select", "Scene", "Rain", "Drive", "Timeline", "View", "Help")


_LETTERS = {title: "C" if title == "Scene" else title[0] for title in MENUS}
"""With Alt, each opens its menu; underlined while Alt is held."""


def draw_menus(editor: Editor) -> None:
    for title in MENUS:
        if _is_opened_by_key(title):
            imgui.open_popup(title)
        is_open = imgui.begin_menu(title)
        if imgui.get_io().key_alt:
            _underline(title)
        if is_open:
            groups = [
                [command for command in group if command.menu == title and command.is_listed(editor)]
                for group in all_command_groups()
            ]
            for number, group in enumerate(filter(None, groups)):
                if number:
                    imgui.separator()
                for command in group:
                    _item(editor, command)
                if title == "View" and number == 0:
                    _more_views(editor.views)
                if title == "File" and number == 0:
                    _recent(editor.files)
            if title == "View":
                imgui.separator()
                _panels()
            imgui.end_menu()


def _is_opened_by_key(title: str) -> bool:
    """Return True in the frame in which Alt and the letter of a menu are pressed, or F10 for the first one."""
    if imgui.internal.get_top_most_popup_modal() is not None:
        return False
    if title == MENUS[0] and imgui.is_key_pressed(imgui.Key.f10, False):
        return True
    return imgui.is_key_chord_pressed(parse_chord(f"Alt+{_LETTERS[title]}"))


def _underline(title: str) -> None:
    """Underline the letter of the menu that was drawn last."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    wide, at = imgui.calc_text_size(title).x, title.upper().index(_LETTERS[title])
    left = (low.x + high.x - wide) / 2 + imgui.calc_text_size(title[:at]).x
    y = (low.y + high.y + imgui.get_font_size()) / 2
    right = left + imgui.calc_text_size(title[at]).x
    ink = imgui.get_color_u32(imgui.Col_.text)
    imgui.get_window_draw_list().add_line(ImVec2(left, y), ImVec2(right, y), ink)


def _item(editor: Editor, command: Command) -> None:
    is_on = command.is_checked(editor)
    keys = key_names(command.key_names.split(" or ")[0])
    clicked, _ = imgui.menu_item(command.title(editor), keys, is_on, command.can_run(editor))
    if command.help:
        imgui.set_item_tooltip(command.help)
    if clicked:
        command.perform(editor)


def _recent(files: Files) -> None:
    if imgui.begin_menu("Open recent", bool(files.recent)):
        for path in files.recent:
            if imgui.menu_item(label(path.name, str(path)), "", False)[0]:
                files.open(str(path))
            imgui.set_item_tooltip(str(path))
        imgui.end_menu()


def _more_views(views: NamedViews) -> None:
    """Draw the menu of the views that have no key."""
    others = views.views[VIEW_KEYS:]
    if others and imgui.begin_menu("More views"):
        for view in others:
            if imgui.menu_item(label(view.name, view.name), "", False)[0]:
                views.go_to(view.name)
        imgui.end_menu()


def _panels() -> None:
    if imgui.begin_menu("Panels"):
        for window in panel_windows():
            clicked, window.is_visible = imgui.menu_item(window.label, "", window.is_visible)
            if clicked and window.is_visible:
                bring_to_front(window)
        imgui.separator()
        if imgui.menu_item("Put everything back in its place", "", False)[0]:
            hello_imgui.get_runner_params().docking_params.layout_reset = True
            for window in panel_windows():
                window.is_visible = True
        imgui.end_menu()


# Status bar: scene, selection, rain, current or last activity, and help on the tool

_NEW = timedelta(seconds=8)


def status_bar(editor: Editor) -> None:
    state = editor.live_rain.displayed.state_at(editor.playback.clock.time_s)
    selected = sum(
        each.marks.selected.size for each in editor.document.scene.members if each.marks.selected is not None
    )
    words = [
        editor.files.title,
        f"{editor.playback.clock.time_s:.1f} s",
        f"{state.intensity_mm_h:.1f} mm/h {state.rain_class}".rstrip(),
    ]
    if selected:
        words.append(f"{selected:,} selected")
    imgui.text("   ".join(words))
    for warning in filter(
        None, ["beyond calibration" if state.beyond_calibration else "", editor.document.rain.exaggeration]
    ):
        imgui.same_line()
        imgui.text_colored(warning_color(), warning)
    if editor.busy is not None:
        imgui.same_line()
        imgui.text(f"  {editor.busy}")
    tool = next((each for each in TOOLS if each.name == editor.viewport.options.tool), None)
    backend = f"({editor.viewport.backend})" if editor.viewport.backend else ""
    right = f"{editor.viewport.rate.words(time.perf_counter())} {backend}".strip()
    room = imgui.get_window_width() - imgui.calc_text_size(right).x - 2 * imgui.get_font_size()
    rate_at, room = room, room - tray_width(editor.jobs)
    hint = f"{tool.name}: {tool.help}" if tool is not None else ""
    newest = editor.status.log.lines[-1] if editor.status.log.lines else None
    age = datetime.now() - newest.at if newest is not None and newest.level == logging.INFO else _NEW
    is_new = timedelta() <= age < _NEW  # below 0 the clock was set back
    if newest is not None and is_new and newest.text not in ("", editor.busy):
        hint = newest.text  # such as "Exported out.ply"; errors appear over the viewport instead
    if hint:
        imgui.same_line()
        words = f"   {hint}"
        imgui.text_disabled(shown := shortened(words, room - imgui.get_cursor_pos_x() - imgui.get_font_size()))
        if shown != words:
            imgui.set_item_tooltip(hint)
    if room < rate_at:
        imgui.same_line(room)
        job_tray(editor.viewport, editor.jobs)
    imgui.same_line(rate_at)
    imgui.text_disabled(right)
    imgui.set_item_tooltip("Pictures of the view on the screen, their size in pixels, and the renderer.")

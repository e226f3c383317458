"""File dialogs: the desktop's own where it has one, else a browser in the window; answered in a later frame."""

import math
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from imgui_bundle import ImVec2, icons_fontawesome_6, imgui
from imgui_bundle import portable_file_dialogs as desktop

from gsrain_engine.editor.status import StatusBus
from gsrain_engine.fields import field_of, short_number
from gsrain_engine.scene.formats.registry import writable_suffixes
from gsrain_engine.scene.formats.scene_folder import SCENE_FILE

from .fields import keyframe_button_width, plain_label, square_button, warn
from .popups import place_dialog
from .text import label, shortened

Answer = Callable[[list[Path]], None]

ALL_FILES = "All files{.*}"
SCENE_FOLDERS = "Scene folders{.*}"


def exported_kinds() -> str:
    """Return the file types that a scene can be exported to, including those of installed packages."""
    return ",".join(f"{suffix.lstrip('.').upper()} files{{{suffix}}}" for suffix in writable_suffixes())


class FileKind(NamedTuple):
    """A row of a dialog's list of file types."""

    name: str
    suffixes: tuple[str, ...]
    """With their dots, in lower case; empty for all files."""

    def has(self, name: str) -> bool:
        return not self.suffixes or name.lower().endswith(self.suffixes)

    @property
    def label(self) -> str:
        return f"{self.name} ({', '.join(self.suffixes)})" if self.suffixes else self.name


def file_kinds(kinds: str) -> tuple[FileKind, ...]:
    """Read file types written as "Scenes{.ply,.spz},All files{.*}"."""
    return tuple(
        FileKind(name.strip(), tuple(each.strip().lower() for each in suffixes.split(",") if each.strip() != ".*"))
        for name, suffixes in re.findall(r"([^,{}]+)\{([^{}]*)\}", kinds)
    )


@dataclass(frozen=True, slots=True)
class FileRequest:
    """A question for files; `kinds` is empty where a folder is asked for."""

    title: str
    kinds: tuple[FileKind, ...]
    answer: Answer
    is_save: bool = False
    several: bool = False
    takes_scenes: bool = False
    """Scene folders are answers, too."""
    proposed: str = ""
    """File name in the field of a save dialog."""
    confirms: bool = True
    """Asks before a file is replaced, which the answer does not do itself."""

    def completed(self, path: Path, kind: FileKind) -> Path:
        """Append the kind's first suffix to a name that has none of those on offer."""
        known = tuple(suffix for each in self.kinds for suffix in each.suffixes)
        if not kind.suffixes or (known and path.name.lower().endswith(known)):
            return path
        return path.with_name(path.name + kind.suffixes[0])


def ask_what_to_open(
    title: str, kinds: str, answer: Answer, *, several: bool = False, takes_scenes: bool = False
) -> None:
    """Open a dialog for existing files; `kinds` as in "Scenes{.ply,.spz},All files{.*}", "" for a folder."""
    _dialogs.ask(FileRequest(title, file_kinds(kinds), answer, several=several, takes_scenes=takes_scenes))


def ask_where_to_save(title: str, kinds: str, answer: Answer, *, proposed: str = "", confirms: bool = True) -> None:
    """Open a dialog for a file or folder to write, with a `proposed` name; `confirms` asks before it is replaced."""
    _dialogs.ask(FileRequest(title, file_kinds(kinds), answer, is_save=True, proposed=proposed, confirms=confirms))


def path_field(
    settings: msgspec.Struct, name: str, kinds: str, take: Callable[[Path | None], None], *, label: str | None = None
) -> None:
    """Draw a path with a button that opens a dialog: `kinds` as in a file dialog, "" for a folder.

    `take` gets the typed or chosen path, a chosen one in a later frame; None for an empty text.
    """
    info, present = field_of(type(settings), name), getattr(settings, name)
    value = "" if present is None else str(present)
    plain_label(label or info.title, info.help)
    imgui.set_next_item_width(-keyframe_button_width())
    _, typed = imgui.input_text_with_hint(f"##{name}", "none chosen", value)
    # A half-typed path doesn't exist yet: accept it only after editing.
    if imgui.is_item_deactivated_after_edit():
        take(Path(typed).expanduser() if typed.strip() else None)
    imgui.set_item_tooltip(f"{info.help}\n{value}".strip())
    imgui.same_line()
    if square_button(icons_fontawesome_6.ICON_FA_FOLDER_OPEN, f"choose {name}"):
        ask_what_to_open(f"{info.title}{'' if kinds else ' (folder)'}", kinds, lambda chosen: take(chosen[0]))
    imgui.set_item_tooltip("Choose a file..." if kinds else "Choose a folder...")


def draw_file_dialogs(status: StatusBus, recent: Iterable[Path], *, use_desktop: bool) -> None:
    """Draw the open dialog, or look whether the desktop's has an answer. Call it once per frame.

    `recent` are files opened lately, whose folders are offered. Without `use_desktop`, or where the desktop has no
    dialogs, the window's own browser is drawn.
    """
    _dialogs.draw(status, recent, use_desktop)


def is_file_dialog_open() -> bool:
    """Tell whether a dialog is open, whose answer has to be looked for."""
    return _dialogs.is_open


def desktop_dialog_program() -> str | None:
    """Name of the program that shows the desktop's file dialogs; None where there is none."""
    return next((name for name in ("zenity", "kdialog", "matedialog", "qarma") if shutil.which(name)), None)


_MIN_LIST_EM, _MIN_DETAILS_EM = 7.0, 24.0  # height of the lists, and width with places, or with sizes and dates


class _FileDialogs:
    """Requests in the order in which they were made; the first one is open."""

    def __init__(self) -> None:
        self._requests: list[FileRequest] = []
        self._browser: FileBrowser | None = None
        self._desktop: Any = None
        self._folders: dict[str, Path] = {}
        """Last folder, by title; that of "" was used last of all."""

    @property
    def is_open(self) -> bool:
        return bool(self._requests)

    def ask(self, request: FileRequest) -> None:
        if request.title not in [each.title for each in self._requests]:
            self._requests.append(request)

    def draw(self, status: StatusBus, recent: Iterable[Path], use_desktop: bool) -> None:
        if not self._requests:
            return
        request = self._requests[0]
        if self._browser is None and self._desktop is None:
            opened = [path.parent for path in recent]
            folder = starting_folder(request.title, self._folders, opened)
            if use_desktop and desktop_dialog_program() is not None:
                self._desktop = _desktop_dialog(request, folder)
            else:
                self._browser = FileBrowser(request, folder, opened + list(self._folders.values()))
        chosen = self._browser.draw() if self._browser is not None else _desktop_answer(request, self._desktop)
        if chosen is None:
            return
        del self._requests[0]
        self._browser = self._desktop = None
        if chosen:
            self._folders[request.title] = self._folders[""] = chosen[0].parent
            try:
                request.answer(chosen)
            except OSError as error:
                status.report(error)


def starting_folder(title: str, last: Mapping[str, Path], opened: Sequence[Path]) -> Path:
    """Return the folder in which a dialog begins: its own last one, else the last one of all.

    `last` are these by title; that of "" was used last of all. The first dialog begins in the first of the folders
    `opened` from lately, or in the working directory.
    """
    own = [last[each] for each in (title, "") if each in last]
    for folder in (*own[:1], *opened[:1]):
        if folder.is_dir():
            return folder
    try:
        return Path.cwd()
    except OSError:  # it was removed
        return Path.home()


_dialogs = _FileDialogs()


# The desktop's own dialogs


def _desktop_dialog(request: FileRequest, folder: Path) -> Any:
    place = str(folder / request.proposed) if request.proposed else f"{folder}{os.sep}"
    filters = [text for kind in request.kinds for text in (kind.name, " ".join(f"*{s}" for s in kind.suffixes) or "*")]
    if request.is_save:
        options = desktop.opt.none if request.confirms else desktop.opt.force_overwrite
        return desktop.save_file(request.title, place, filters, options)
    if request.kinds:
        options = desktop.opt.multiselect if request.several else desktop.opt.none
        return desktop.open_file(request.title, place, filters, options)
    return desktop.select_folder(request.title, place)


def _desktop_answer(request: FileRequest, dialog: Any) -> list[Path] | None:
    """Return the chosen paths, none after a cancellation; None while the dialog is open."""
    if not dialog.ready(0):
        return None
    found = dialog.result()
    chosen = [Path(each) for each in ([found] if isinstance(found, str) else found) if each]
    return [request.completed(path, request.kinds[0]) for path in chosen] if request.is_save else chosen


# The window's own


class Entry(NamedTuple):
    """A row of the browser."""

    name: str
    is_folder: bool
    is_scene: bool
    """A folder with a scene in it."""
    size: int
    """Bytes."""
    modified_s: float
    """Seconds since 1970."""


@dataclass(slots=True)
class FolderListing:
    """Entries of a folder, folders first; read in a thread, since a network drive may take seconds."""

    folder: Path
    entries: tuple[Entry, ...] = ()
    problem: str = ""
    is_done: bool = False
    _thread: threading.Thread | None = field(default=None, repr=False)

    def start(self) -> "FolderListing":
        self._thread = threading.Thread(target=self.read, daemon=True)
        self._thread.start()
        return self

    def read(self) -> None:
        """Read the folder; a problem becomes one sentence."""
        try:
            with os.scandir(self.folder) as found:
                entries = [entry for each in found if (entry := _entry(each)) is not None]
            self.entries = tuple(sorted(entries, key=lambda each: (not each.is_folder, each.name.casefold())))
        except OSError as error:
            self.problem = f"{self.folder} can't be read: {error.strerror or error}"
        self.is_done = True


def _entry(found: "os.DirEntry[str]") -> Entry | None:
    """Return a row for an entry; None if it is gone meanwhile or leads nowhere."""
    try:
        stat, is_folder = found.stat(), found.is_dir()
    except OSError:
        return None
    is_scene = is_folder and Path(found.path, SCENE_FILE).is_file()
    return Entry(found.name, is_folder, is_scene, 0 if is_folder else stat.st_size, stat.st_mtime)


def size_text(size: int) -> str:
    """Size of a file with three digits: 950 B, 1.25 MB."""
    if size < 1000:
        return f"{size} B"
    power = min(int(math.log10(size) / 3 + 1e-4), 4)  # 999.8 kB are 1 MB
    return f"{short_number(size / 1000**power)} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"


_NAME, _SIZE, _MODIFIED = range(3)  # columns
_HOME_FOLDERS = ("Desktop", "Documents", "Downloads", "Pictures", "Videos")


class FileBrowser:
    """A dialog in the window, for keyboard and mouse: places, recent folders, a sorted list, a field for the name."""

    def __init__(self, request: FileRequest, folder: Path, used: Sequence[Path] = ()) -> None:
        self._request = request
        self._kind = request.kinds[0] if request.kinds else FileKind("Folders", ())
        self._used = tuple(dict.fromkeys(each for each in used if each.is_dir()))[:6]
        self._name, self._is_renamed = request.proposed, False
        self._chosen: list[str] = []
        self._line = -1
        self._problem = ""
        self._replaced: Path | None = None
        self._new_folder: str | None = None
        self._shows_hidden = False
        self._order = (_NAME, False)
        self._focus_name = True
        self._listing = FolderListing(folder).start()
        self._place = str(folder)

    def draw(self) -> list[Path] | None:
        """Draw the dialog; returns the chosen paths, none after Cancel, or None while it is open."""
        title, em = self._request.title, imgui.get_font_size()
        if not imgui.is_popup_open(title):
            imgui.open_popup(title)
        place_dialog(56, 34, imgui.Cond_.appearing)
        is_shown, stays = imgui.begin_popup_modal(title, True, imgui.WindowFlags_.no_saved_settings)
        if not is_shown:
            return None if stays is not False else []
        rows = self._rows()
        self._draw_place()
        below = 2 * imgui.get_frame_height_with_spacing() + imgui.get_style().item_spacing.y
        below += imgui.get_frame_height_with_spacing() if self._problem or self._replaced is not None else 0
        tall = max(imgui.get_content_region_avail().y - below, _MIN_LIST_EM * em)
        if imgui.get_content_region_avail().x > _MIN_DETAILS_EM * em:
            wide = min(max(0.25 * imgui.get_window_width(), 9 * em), 12 * em)
            if imgui.begin_child("places", ImVec2(wide, tall)):
                self._draw_places()
            imgui.end_child()
            imgui.same_line()
        answer = self._draw_list(rows, tall)
        answer = self._draw_name(rows) or answer
        buttons = self._draw_buttons(rows)
        answer = buttons if buttons is not None else answer
        if answer is not None or stays is False:
            imgui.close_current_popup()
            answer = answer or []
        imgui.end_popup()
        return answer

    # Parts, from above to below

    def _draw_place(self) -> None:
        """Draw the path, which can be typed, with buttons for the folder above and a new folder."""
        if imgui.button(icons_fontawesome_6.ICON_FA_ARROW_UP + "###up"):
            self._enter(self._listing.folder.parent)
        imgui.set_item_tooltip("Folder above (Alt+Up, or Backspace with an empty name)")
        imgui.same_line()
        can_make = self._request.is_save or not self._request.kinds
        button_width = imgui.calc_text_size("New folder").x + 2 * imgui.get_style().frame_padding.x
        imgui.set_next_item_width(-(button_width + imgui.get_style().item_spacing.x) if can_make else -1)
        entered, self._place = imgui.input_text("##folder", self._place, imgui.InputTextFlags_.enter_returns_true)
        imgui.set_item_tooltip("Folder: type one and press Enter.")
        if entered:
            self._enter(Path(self._place).expanduser())
        elif imgui.is_item_deactivated():
            self._place = str(self._listing.folder)
        if can_make:
            imgui.same_line()
            if imgui.button("New folder"):
                self._new_folder = "new folder"
                imgui.open_popup("new folder")
        self._draw_new_folder()

    def _draw_new_folder(self) -> None:
        if self._new_folder is None or not imgui.begin_popup("new folder"):
            return
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        entered, self._new_folder = imgui.input_text(
            "##new folder", self._new_folder, imgui.InputTextFlags_.enter_returns_true
        )
        imgui.same_line()
        if (imgui.button("Create") or entered) and self._new_folder.strip():
            made = self._listing.folder / self._new_folder.strip()
            try:
                made.mkdir()
            except OSError as error:
                self._problem = f"{made} can't be made: {error.strerror or error}"
            else:
                self._enter(made)
            self._new_folder = None
            imgui.close_current_popup()
        imgui.end_popup()

    def _draw_places(self) -> None:
        home = Path.home()
        folders = [(home, "Home"), *((home / name, name) for name in _HOME_FOLDERS), (Path(home.anchor), "Computer")]
        icon = icons_fontawesome_6.ICON_FA_FOLDER
        for folder, name in folders:
            if folder.is_dir() and imgui.selectable(f"{icon} {name}", folder == self._listing.folder)[0]:
                self._enter(folder)
        if self._used:
            imgui.separator_text("Recent")
        for n, folder in enumerate(self._used):
            room = imgui.get_content_region_avail().x - imgui.calc_text_size(f"{icon} ").x
            name = label(shortened(folder.name or str(folder), room), str(n))
            if imgui.selectable(f"{icon} {name}", folder == self._listing.folder)[0]:
                self._enter(folder)
            imgui.set_item_tooltip(str(folder))
        imgui.separator()
        changed, self._shows_hidden = imgui.checkbox("Hidden files", self._shows_hidden)
        if changed:
            self._line = -1

    def _draw_list(self, rows: Sequence[Entry], tall: float) -> list[Path] | None:
        """Draw the table of entries, in a narrow dialog only their names; returns paths if one is double-clicked."""
        has_details = imgui.get_content_region_avail().x > _MIN_DETAILS_EM * imgui.get_font_size()
        flags = imgui.TableFlags_.sortable | imgui.TableFlags_.scroll_y | imgui.TableFlags_.row_bg
        flags |= imgui.TableFlags_.resizable | imgui.TableFlags_.borders_outer
        if not imgui.begin_table(*(("entries", 3) if has_details else ("names", 1)), flags, ImVec2(0, tall)):
            return None
        em, fixed = imgui.get_font_size(), imgui.TableColumnFlags_.width_fixed
        imgui.table_setup_scroll_freeze(0, 1)
        imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch | imgui.TableColumnFlags_.default_sort)
        if has_details:
            imgui.table_setup_column("Size", fixed, 5.5 * em)
            imgui.table_setup_column("Modified", fixed, 9.5 * em)
        imgui.table_headers_row()
        specs = imgui.table_get_sort_specs()
        if specs.specs_dirty and specs.specs_count:
            first = specs.get_specs(0)
            self._order = first.column_index, first.get_sort_direction() == imgui.SortDirection_.descending
            specs.specs_dirty = False
        answer: list[Path] | None = None
        clipper = imgui.ListClipper()
        clipper.begin(len(rows))
        while clipper.step():
            for n in range(clipper.display_start, clipper.display_end):
                answer = self._draw_row(rows, n, has_details) or answer
        if not rows:
            imgui.table_next_row()
            imgui.table_next_column()
            is_read = self._listing.is_done
            imgui.text_disabled(self._listing.problem or ("Nothing of this type here." if is_read else "Reading..."))
        imgui.end_table()
        return answer

    def _draw_row(self, rows: Sequence[Entry], n: int, has_details: bool) -> list[Path] | None:
        entry = rows[n]
        icons = icons_fontawesome_6
        icon = icons.ICON_FA_CUBE if entry.is_scene else icons.ICON_FA_FOLDER if entry.is_folder else icons.ICON_FA_FILE
        imgui.table_next_row()
        imgui.table_next_column()
        flags = imgui.SelectableFlags_.span_all_columns | imgui.SelectableFlags_.allow_double_click
        flags |= imgui.SelectableFlags_.no_auto_close_popups
        clicked, _ = imgui.selectable(
            f"{icon} {label(entry.name, str(n))}", entry.name in self._chosen or n == self._line, flags
        )
        answer = None
        if clicked:
            self._choose(entry, n, adds=self._request.several and imgui.get_io().key_ctrl)
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                answer = self._accept_entry(entry)
        if not has_details:
            return answer
        imgui.table_next_column()
        imgui.text_disabled("" if entry.is_folder else size_text(entry.size))
        imgui.table_next_column()
        imgui.text_disabled(time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.modified_s)))
        return answer

    def _draw_name(self, rows: Sequence[Entry]) -> list[Path] | None:
        """Draw the field for the name and the list of file types; arrows and Enter work while it has the focus."""
        em = imgui.get_font_size()
        imgui.align_text_to_frame_padding()
        names_files = any(kind.suffixes for kind in self._request.kinds)
        imgui.text("File name" if names_files else "Folder name" if self._request.is_save else "Folder")
        imgui.same_line()
        imgui.set_next_item_width(-min(16 * em, imgui.get_content_region_avail().x / 2) if self._request.kinds else -1)
        if self._focus_name:
            imgui.set_keyboard_focus_here()
            self._focus_name = False
        state = imgui.internal.get_input_text_state(imgui.get_id("##name")) if self._is_renamed else None
        if state is not None:  # the active field keeps a text of its own
            state.reload_user_buf_and_select_all()
        self._is_renamed = False
        changed, self._name = imgui.input_text("##name", self._name)
        is_typing = imgui.is_item_focused() or imgui.is_item_active()
        if changed:
            self._problem, self._replaced, self._chosen = "", None, []
            if not self._request.is_save:
                start = self._name.casefold()
                found = (n for n, each in enumerate(rows) if start and each.name.casefold().startswith(start))
                self._line = next(found, -1)
        if self._request.kinds:
            imgui.same_line()
            imgui.set_next_item_width(-1)
            labels = [kind.label for kind in self._request.kinds]
            _, at = imgui.combo("##kind", self._request.kinds.index(self._kind), labels)
            if self._request.kinds[at] != self._kind:
                self._take_kind(self._request.kinds[at])
        if not is_typing:
            return None
        step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
        goes_up = imgui.get_io().key_alt and step < 0
        if goes_up or (not self._name and imgui.is_key_pressed(imgui.Key.backspace) and not changed):
            self._enter(self._listing.folder.parent)
        elif step and rows:
            line = min(max(self._line + step, 0), len(rows) - 1)
            self._choose(rows[line], line)
        if imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter):
            return self._accept(rows)
        return None

    def _draw_buttons(self, rows: Sequence[Entry]) -> list[Path] | None:
        """Draw the last line; returns the answer if a button is clicked, an empty one for Cancel."""
        em = imgui.get_font_size()
        if self._replaced is not None:
            warn(f"{self._replaced.name} is there already.")
        elif self._problem:
            warn(self._problem)
        labels = ("Replace" if self._replaced is not None else self._verb, "Cancel")
        spacing = imgui.get_style().item_spacing.x
        room = imgui.get_content_region_avail().x - (2 * 7 * em + spacing)
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(0.0, room))
        if imgui.button(labels[0], ImVec2(7 * em, 0)):
            if self._replaced is not None:
                return [self._replaced]
            return self._accept(rows)
        imgui.same_line()
        cancels = imgui.button(labels[1], ImVec2(7 * em, 0))
        if imgui.is_key_pressed(imgui.Key.escape) and not imgui.is_popup_open("new folder"):
            cancels = True
        return [] if cancels else None

    # What is chosen

    @property
    def _verb(self) -> str:
        return "Save" if self._request.is_save else "Open" if self._request.kinds else "Choose"

    def _rows(self) -> list[Entry]:
        """Entries of the chosen type, in the chosen order; folders come first."""
        entries = (
            each for each in self._listing.entries
            if (each.is_folder or (bool(self._request.kinds) and self._kind.has(each.name)))
            and (self._shows_hidden or not each.name.startswith("."))
        )  # fmt: skip
        column, descends = self._order
        if column == _NAME:
            ordered = sorted(entries, key=lambda each: each.name.casefold(), reverse=descends)
        else:
            ordered = sorted(
                entries, key=lambda each: each.size if column == _SIZE else each.modified_s, reverse=descends
            )
        return sorted(ordered, key=lambda each: not each.is_folder)

    def _enter(self, folder: Path) -> None:
        folder = Path(os.path.normpath(folder.absolute()))
        if not folder.is_dir():
            self._problem = f"{folder} is no folder."
            return
        self._listing = FolderListing(folder).start()
        self._place, self._line, self._chosen = str(folder), -1, []
        self._problem, self._replaced, self._focus_name = "", None, True
        if not self._request.is_save:
            self._rename("")

    def _choose(self, entry: Entry, line: int, *, adds: bool = False) -> None:
        others = [each for each in self._chosen if each != entry.name]
        if adds:
            self._chosen = others if entry.name in self._chosen else [*others, entry.name]
        else:
            self._chosen = [entry.name]
        self._line, self._problem, self._replaced = line, "", None
        if not (self._request.is_save and entry.is_folder):
            self._rename(entry.name if len(self._chosen) == 1 else "")

    def _rename(self, name: str) -> None:
        """Put a name into the field, also while it is typed in."""
        self._name, self._is_renamed = name, True

    def _take_kind(self, kind: FileKind) -> None:
        """Show another file type; a name in a save dialog gets its suffix."""
        if self._request.is_save and kind.suffixes and self._kind.suffixes:
            for suffix in self._kind.suffixes:
                if self._name.lower().endswith(suffix):
                    self._rename(self._name[: -len(suffix)] + kind.suffixes[0])
                    break
        self._kind, self._line, self._chosen = kind, -1, []

    def _accept_entry(self, entry: Entry) -> list[Path] | None:
        """Take an entry as a double click does: a folder is entered, a file is the answer."""
        path = self._listing.folder / entry.name
        if entry.is_folder and not (entry.is_scene and self._request.takes_scenes):
            self._enter(path)
            return None
        return self._checked([path])

    def _accept(self, rows: Sequence[Entry]) -> list[Path] | None:
        """Take what is typed or chosen; enters a folder where a file is asked for."""
        folder, typed = self._listing.folder, self._name.strip()
        if self._replaced is not None:
            return [self._replaced]
        if len(self._chosen) > 1:
            return self._checked([folder / name for name in self._chosen])
        if not typed:
            if not self._request.kinds:
                return [folder]
            self._problem = "Type a name." if self._request.is_save else "Choose a file."
            return None
        path = folder / Path(typed).expanduser()
        if not self._request.is_save and not path.exists() and 0 <= self._line < len(rows):
            path = folder / rows[self._line].name  # the first entry that begins with what was typed
        return self._checked([path])

    def _checked(self, paths: list[Path]) -> list[Path] | None:
        """Return paths that can be the answer; enters a folder, or says what is wrong, else."""
        path, request = paths[0], self._request
        if path.is_dir() and request.kinds and not self._takes_folder(path):
            self._enter(path)
            return None
        if request.is_save:
            path = request.completed(path, self._kind)
            if not path.parent.is_dir():
                self._problem = f"{path.parent} is no folder."
                return None
            if request.confirms and path.exists() and path != self._replaced:
                self._replaced = path
                return None
            return [path]
        missing = [each for each in paths if not each.exists()]
        if missing:
            self._problem = f"{missing[0]} does not exist."
            return None
        if not request.kinds and not path.is_dir():
            self._problem = f"{path.name} is no folder."
            return None
        return paths

    def _takes_folder(self, folder: Path) -> bool:
        """Tell whether a folder can be the answer where files are asked for: one to write into, or a scene."""
        if self._request.is_save:
            return not self._kind.suffixes
        return self._request.takes_scenes and (folder / SCENE_FILE).is_file()

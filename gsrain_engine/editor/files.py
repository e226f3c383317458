"""Files of the editor: open, import, save, export, revert, recent files, autosave, and crash recovery."""

import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import msgspec

from ..datasets.open_capture import capture_format
from ..rain.settings import load_preset
from ..safe_io.errors import SceneFormatError
from ..safe_io.files import lock_path, whole_file
from ..safe_io.limits import read_file
from ..safe_io.text_files import MAX_BYTES, printable_line
from ..scene.formats.registry import format_of, lost_in_file, writable_suffixes
from ..scene.formats.scene_files import names_scene_folder, write_scene
from ..scene.formats.scene_folder import SCENE_FILE, FileCache
from ..scene.open import folder_to_read, is_built_in, load_drawable_scene, scene_folder_of
from ..scene.scene import Scene
from .autosave import Autosave, FileFingerprint, RecoveryCandidate, fingerprint_of, has_changed, saved_scene
from .background import Background, Task
from .background_edits import import_file
from .capture_view import CaptureController
from .document import DocumentState, Recipe, rain_around
from .edits.layers import import_scene
from .jobs.job import JobRunner
from .preferences import PreferencesStore, state_folder
from .status import Answer, DeferredAction, Question, StatusBus, describe_error, do_nothing
from .viewport_state import PendingScene, ViewportState

logger = logging.getLogger("gsrain")
_CANCEL = Answer("Cancel", help="Change nothing.")


@dataclass(frozen=True, eq=False)
class LoadedDocument:
    """A scene that was read, and the origin and state of its files."""

    scene: Scene
    source: str
    home: Path | None
    stamp: FileFingerprint | None
    known: FileCache
    recovered: RecoveryCandidate | None = None


class SceneHome(NamedTuple):
    """Scene folder of a document, and its state when it was read or written last."""

    folder: Path
    stamp: FileFingerprint | None


class NotASceneError(SceneFormatError):
    """Raised for a capture where a scene is expected."""

    def __init__(self, path: Path, kind: str) -> None:
        """`kind` is the name of the capture's format."""
        super().__init__(path, f"this is a capture ({kind}), not a scene; File > Open capture folder... shows it")
        self.path, self.kind = path, kind


class Files:
    """The files of one document. Reading and writing runs in `background`, everything else on the main thread."""

    def __init__(
        self,
        viewport: ViewportState,
        jobs: JobRunner,
        captures: CaptureController,
        preferences: PreferencesStore,
        status: StatusBus,
        background: Background,
        enter: Callable[[LoadedDocument], None],
    ) -> None:
        """`enter` switches to another document."""
        self._viewport, self._document = viewport, viewport.document
        self._jobs, self._captures, self._status, self._enter = jobs, captures, status, enter
        self.source: str | None = None
        """Path or name that was opened last."""
        self._homes: dict[str, SceneHome] = {}
        """Scene folders of the document, by its origin."""
        self.recent: list[Path] = recent_files()
        """Latest first."""
        self.place_request: Callable[[Path], None] | None = None
        """Set while the user has to choose where to save; called with the answer."""
        self.loose_results: Callable[[], list[str]] = list
        """Returns the names of unsaved results that are lost with this document."""
        self.known = FileCache()
        """Map of files to the Gaussians they hold; for the thread that reads and writes."""
        self.saved: DocumentState = self._document.state
        """Document as on disk."""
        self.recovery = Recovery(viewport, self, preferences, status, background)
        self.deferred = DeferredAction(status)
        """Action that waits until jobs and files have ended."""
        self._background = background
        self._opening: Task[LoadedDocument] | None = None
        self._arriving: LoadedDocument | None = None
        self._saving: Task[FileFingerprint | None] | None = None
        self._next_saving: Callable[[], None] | None = None

    # State

    @property
    def home(self) -> Path | None:
        """Scene folder that the document came from or was saved to, used by Save.

        What a job has made of other data has none before it is saved; undo leads back to the one of before.
        """
        home = self._homes.get(self._document.state.origin)
        return None if home is None else home.folder

    @property
    def title(self) -> str:
        """Name of the document: that of its scene folder, else of the scene."""
        return self._document.scene.name if self.home is None else self.home.name

    @property
    def stamp(self) -> FileFingerprint | None:
        """State of the scene folder when it was read or written last."""
        home = self._homes.get(self._document.state.origin)
        return None if home is None else home.stamp

    @property
    def has_changes(self) -> bool:
        """True if the document differs from the one that was opened or saved."""
        return self._document.state is not self.saved

    @property
    def busy(self) -> str | None:
        """Description of the read or write that the user waits for, or None."""
        tasks = [*([] if self._opening is None else [self._opening]), *self._background.titled]
        return tasks[0].progress.message if tasks else None

    def close(self) -> None:
        """Remove the autosave, unless there are unsaved changes."""
        if self._opening is not None:
            self._opening.cancel()
        self.recovery.close(is_saved=not self.has_changes)

    # Opening

    def open(self, path: str) -> None:
        """Open another scene, after asking about unsaved changes."""
        self.confirm_unsaved_then(f"open {Path(path).name or path}", lambda: self.open_now(path))

    def open_now(self, path: str) -> None:
        """Read a scene in the background and switch to it; a later call supersedes an earlier one."""
        self._begin_opening(path, lambda: load_document(path))

    def recover(self, autosaved: RecoveryCandidate) -> None:
        """Open an autosave of a process that died; its changes count as unsaved."""
        self._begin_opening(autosaved.about.name, lambda: load_autosave(autosaved))

    def go_on_at(self, place: Path) -> None:
        """Open the autosave of the previous window without asking; its changes count as unsaved."""
        self._begin_opening("what was not saved", lambda: load_autosave(self.recovery.left_at(place)))

    def _begin_opening(self, label: str, read: Callable[[], LoadedDocument]) -> None:
        if self._opening is not None:
            self._opening.cancel()
        logger.info("Opening %s", label)
        self._status.dismiss()

        def stage(opened: LoadedDocument) -> None:
            self._opening, self._arriving, self._viewport.is_reading = None, opened, False
            self._viewport.staged = PendingScene(label, opened.scene, is_opened=True)

        def fail(error: Exception) -> None:
            self._opening, self._viewport.is_reading = None, False
            if isinstance(error, NotASceneError):
                self._ask_about_capture(error)
                return
            self._status.report(error, f"{label} can't be opened")
            if Path(label) in self.recent and not Path(label).exists():
                self._update_recent(Path(label), add=False)

        self._opening = self._background.start(read, stage, fail, message=f"Opening {label}", lane="opening")
        self._viewport.is_reading = True

    def _ask_about_capture(self, error: NotASceneError) -> None:
        text = (
            f"{error.path.name} is a capture ({error.kind}), not a scene: pictures, which the Capture panel shows "
            "and makes a scene of. Open it there?"
        )
        show = Answer("Open the capture", lambda: self._captures.open(error.path), f"Read {error.path}.")
        self._ask("Open capture", text, show)

    def import_from(self, path: str) -> None:
        """Read a scene in the background and add its layers and actors to the present one."""

        def take(opened: LoadedDocument) -> None:
            other = opened.scene
            recipe = Recipe(import_file, {"path": path})
            self._document.edit(f"Import {other.name}", import_scene, other, recipe=recipe)
            logger.info("Imported %s: %s Gaussians", path, f"{other.gaussian_count:,}")

        logger.info("Importing %s", path)
        title, message = f"Import {Path(path).name}", f"Importing {path}"
        self._begin_work(lambda: load_document(path), take, f"{path} can't be imported", title, message)

    def revert(self) -> None:
        """Return to the version on disk."""
        source = str(self.home) if self.home is not None else self.source
        if source is None:
            return
        text = f"All changes of {self.title} since it was last saved are lost."
        if self.has_changes:
            self._ask("Revert", text, Answer("Revert", lambda: self._reread(source), "Read the scene again."))
        else:
            self._reread(source)

    def close_scene(self) -> None:
        empty = LoadedDocument(Scene("no scene"), "", None, None, FileCache())
        self.confirm_unsaved_then("close the scene", lambda: self._enter(empty))

    def confirm_unsaved_then(self, what: str, act: Callable[[], None], *, ends_program: bool = False) -> None:
        """Call `act`, which replaces the document or ends the program; ask first if jobs run or changes are unsaved.

        Counts only jobs that end with the document, or all jobs if `ends_program`.
        """

        def when_saved() -> None:
            name, is_empty = self.title, self.source is None and not self._document.scene.members
            if is_empty or not self.has_changes:
                without_results()
                return
            save = Answer("Save", lambda: self.save(without_results), f"Save {name}, then {what}.")
            lose = Answer("Don't save", without_results, f"Lose the changes and {what}.")
            self._ask("Unsaved changes", f"Save the changes of {name} before you {what}?", save, lose)

        def without_results() -> None:
            self.confirm_losing(self.loose_results(), what, act)

        self._when_idle(what, when_saved, ends_program=ends_program)

    def confirm_losing(self, rollouts: Sequence[str], what: str, act: Callable[[], None]) -> None:
        """Call `act`, after asking if it loses roll-outs that were not saved, of which these are the titles."""
        if not rollouts:
            act()
            return
        one = len(rollouts) == 1
        listed = "".join(f"\n  -  {each}" for each in rollouts)
        text = (
            f"{'This roll-out was' if one else 'These roll-outs were'} not saved, and {'is' if one else 'are'} "
            f"lost if you {what}:\n{listed}\n\nTo save one, choose Save as... in the Drive panel."
        )
        lose = Answer(f"Lose {'it' if one else 'them'}", act, f"Lose the roll-outs and {what}.")
        self._ask("Roll-outs that were not saved", text, lose, enter_answers=False)

    def _when_idle(self, what: str, act: Callable[[], None], *, ends_program: bool = False) -> None:
        jobs = [each for each in self._jobs.pending if ends_program or each.ends_with_scene]
        self.deferred.when_idle(jobs, self._background.titled, what, act)

    def _reread(self, source: str) -> None:
        self._when_idle("revert", lambda: self.open_now(source))

    def arrive(self, scene: Scene) -> LoadedDocument:
        """Return the origin of a staged scene that was opened here."""
        opened, self._arriving = self._arriving, None
        if opened is not None and opened.scene is scene:
            return opened
        return LoadedDocument(scene, "", None, None, FileCache())

    def enter(self, opened: LoadedDocument, document: DocumentState) -> None:
        """Record that the editor switched to an opened document."""
        self.source, self.known, self.saved = opened.source or None, opened.known, document
        self._homes = {} if opened.home is None else {document.origin: SceneHome(opened.home, opened.stamp)}
        recovered = opened.recovered.place if opened.recovered is not None else None
        if recovered is not None:
            self.saved = replace(document)  # a new object, so that the document counts as changed
        self.recovery.enter(opened.home, document, recovered)
        if opened.source and not is_built_in(opened.source) and recovered is None:
            self._update_recent(Path(opened.source))

    def give_up(self) -> None:
        """Count the present document as saved."""
        self.saved = self._document.state

    # Saving

    def save(self, act: Callable[[], None] = do_nothing) -> None:
        """Save to the document's scene folder, then call `act`; ask for a folder if there is none."""
        if self.home is not None:
            self.save_to(self.home, act)
        else:
            self.place_request = lambda path: self.save_as(path, act)

    def proposed_name(self, suffix: str = "") -> str:
        """Title as the name of a file or folder: letters that a file system may refuse become `_`."""
        return re.sub(r"[^\w.+-]+", "_", self.title).strip("._") + suffix

    def save_to(self, path: Path, act: Callable[[], None] = do_nothing) -> None:
        """Save to a scene folder; ask first if another program has changed it."""
        home, path = self.home, path.parent if path.name == SCENE_FILE else path
        if not names_scene_folder(path):
            self._ask_about_file(path, act)
            return
        if home is None or path.resolve() != home or not has_changed(home, self.stamp):
            self._begin_saving(path, act)
            return

        def elsewhere() -> None:
            self.place_request = lambda chosen: self.save_as(chosen, act)

        self._ask(
            "Changed on disk",
            f"{home} holds something else than what was opened from it or saved to it here: another program or window, "
            "or another state of this document, has replaced it.",
            Answer("Save as...", elsewhere, "Save to another place; both versions stay."),
            Answer("Overwrite", lambda: self._begin_saving(path, act), "What the other program has saved is lost."),
            Answer("Reload", lambda: self._reread(str(home)), "Read what is on the disk; lose the changes here."),
        )

    def save_as(self, path: Path, act: Callable[[], None] = do_nothing) -> None:
        """Save to another place; ask first if it holds another scene folder."""
        other = scene_folder_of(path)
        if other is None or other == self.home:
            self.save_to(path, act)
            return
        replacing = Answer("Replace", lambda: self.save_to(path, act), "The scene that stands there now is lost.")
        self._ask("Replace a scene", f"There is another scene in {other}. Replace it?", replacing)

    def _ask_about_file(self, path: Path, act: Callable[[], None]) -> None:
        folder = path.with_name(path.name.removesuffix(path.suffix))
        text = (
            f"{path.name} names a single file. Save writes a scene folder, which keeps everything; "
            "Export writes a file of what can be seen."
        )
        into = Answer(f"Save as {folder.name}", lambda: self.save_as(folder, act), f"Write the scene folder {folder}.")
        file = Answer("Export visible...", lambda: self.export_to(path), f"Write {path}; changes stay unsaved.")
        self._ask("Save writes a scene folder", text, into, file)

    def _begin_saving(self, path: Path, act: Callable[[], None]) -> None:
        if self._saving is not None:  # only the latest save counts
            self._next_saving = lambda: self._begin_saving(path, act)
            return
        scene, document, known = saved_scene(self._viewport), self._document.state, self.known
        target = path.resolve()

        def write() -> FileFingerprint | None:
            write_scene(scene, path, known, in_drawing_order=True)
            return fingerprint_of(path)

        def take(stamp: FileFingerprint | None) -> None:
            next_saving, self._saving, self._next_saving = self._next_saving, None, None
            logger.info("Saved %s", target)
            self.saved = document
            self.recovery.forget()
            before, self._homes[document.origin] = self._homes.get(document.origin), SceneHome(target, stamp)
            if before is None or target != before.folder:
                self.recovery.enter(target, document)
            self.source = str(target)
            self._update_recent(target)
            act()
            if next_saving is not None:
                next_saving()

        def fail(error: Exception) -> None:
            self._saving = self._next_saving = None
            self._status.report(error, f"{target} can't be saved")

        self._status.dismiss()
        self._saving = self._background.start(write, take, fail, f"Save {path.name}", f"Saving {target}")

    def export_to(self, path: Path) -> None:
        """Write a single file of everything visible, a copy: the document keeps its path and its unsaved changes.

        Asks first about losses in the format and about replacing a file. Nothing is written into the document's folder.
        """
        try:
            row = format_of(path)
        except SceneFormatError as error:  # raised by an installed package
            self._status.report(error)
            return
        if row is None or row.write is None or path.is_dir():
            *first, last = writable_suffixes()
            kinds = f"{', '.join(first)} or {last}"
            self._status.report(f"{path}: Export writes one file, whose name ends in {kinds}.")
            return
        if any(path.resolve().is_relative_to(each.folder) for each in self._homes.values()):
            self._status.report(f"{path} is in the folder of the open scene, which Save writes: choose another place.")
            return
        scene = saved_scene(self._viewport)
        if self._document.rain == rain_around(scene, load_preset("clear")):
            scene = replace(scene, rain=None)
        try:
            missing = lost_in_file(scene, path)
        except SceneFormatError as error:  # raised by an installed package
            self._status.report(error)
            return

        def begin() -> None:
            self._begin_work(
                lambda: write_scene(scene, path), lambda _: logger.info("Exported %s", path),
                f"{path} can't be exported", f"Export {path.name}", f"Exporting {path}",
            )  # fmt: skip

        if not missing and not path.exists():
            begin()
            return
        lines = [f"{path.name} will hold the Gaussians that can be seen, as they are at 0 s."]
        if missing:
            lines.append("\nIt leaves out:\n" + "\n".join(f"  -  {each}" for each in missing))
            lines.append("\nThe document itself stays as it is; Save keeps all of it, in a scene folder.")
        if path.exists():
            lines.append(f"\nThe {path.name} that is there already is replaced.")
        self._ask(f"Export {path.name}", "\n".join(lines), Answer("Export", begin, f"Write {path}."))

    # Shared by the above

    def _ask(self, title: str, text: str, *answers: Answer, enter_answers: bool = True) -> None:
        self._status.ask(Question(title, text, (*answers, _CANCEL), enter_answers=enter_answers))

    def _begin_work(
        self, work: Callable[[], Any], take: Callable[[Any], None], trouble: str, title: str, message: str
    ) -> None:
        """Read or write in the background; an error is reported, after `trouble`."""
        self._status.dismiss()
        self._background.start(work, take, partial(self._status.report, what=trouble), title, message)

    def _update_recent(self, path: Path, *, add: bool = True) -> None:
        def take(paths: list[Path]) -> None:
            self.recent = paths

        self._background.start(lambda: update_recent_files(path, add=add), take, lambda _: None)


def load_document(path: str) -> LoadedDocument:
    """Read a scene as `load_drawable_scene` does, and raise what that raises.

    Raises `NotASceneError` if the path is a capture.
    """
    known = FileCache()
    try:
        home = folder_to_read(Path(path)) if not is_built_in(path) else None
        stamp = fingerprint_of(home) if home is not None else None  # before reading, to detect a change meanwhile
        source = path if is_built_in(path) else str(home or Path(path).absolute())
        return LoadedDocument(load_drawable_scene(path, known), source, home, stamp, known)
    except SceneFormatError:
        kind = capture_format(path) if scene_folder_of(Path(path)) is None else None
        if kind is None:
            raise
        raise NotASceneError(Path(path), kind.name) from None


def load_autosave(autosaved: RecoveryCandidate) -> LoadedDocument:
    """Read an autosave; raises what `load_drawable_scene` raises."""
    known, about = FileCache(), autosaved.about
    scene = load_drawable_scene(str(autosaved.scene), known)
    home = about.folder
    return LoadedDocument(scene, str(home or ""), home, about.stamp, known, autosaved)


# Recent files, shared by all windows

MAX_RECENT_FILES = 12


class _Recent(msgspec.Struct):
    paths: list[str] = []


def recent_files() -> list[Path]:
    """Latest first."""
    try:
        recent = msgspec.json.decode(read_file(_recent_file(), MAX_BYTES), type=_Recent)
    except FileNotFoundError:
        return []
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        logger.warning("%s: the list of recent scenes can't be read: %s", _recent_file(), error)
        return []
    return [Path(each) for each in recent.paths[:MAX_RECENT_FILES]]


def update_recent_files(path: Path, *, add: bool = True) -> list[Path]:
    """Put a scene at the head of the list, or remove it, keeping entries of other windows; return the list.

    Raises OSError if it can't be written.
    """
    folder = state_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with lock_path(folder):
        paths = [each for each in recent_files() if each != path.absolute()]
        if add:
            paths = [path.absolute(), *paths][:MAX_RECENT_FILES]
        with whole_file(_recent_file()) as file:
            names = [str(each).encode(errors="replace").decode() for each in paths]
            file.write_bytes(msgspec.json.encode(_Recent(names)))
    return paths


def _recent_file() -> Path:
    return state_folder() / "recent.json"


# Crash recovery


class Recovery:
    """The autosave of a session: written in `background`, everything else on the main thread."""

    def __init__(
        self,
        viewport: ViewportState,
        files: Files,
        preferences: PreferencesStore,
        status: StatusBus,
        background: Background,
    ) -> None:
        self.now: Callable[[], float] = monotonic
        """Clock in seconds."""
        self._viewport, self._files, self._preferences = viewport, files, preferences
        self._status, self._background = status, background
        self._autosave = Autosave()
        self._home: Path | None = None
        self._autosaved: DocumentState = viewport.document.state
        """Document of the last autosave."""
        self._changed_at: float | None = None
        self._entering: Task[tuple[bool, RecoveryCandidate | None]] | None = None
        self._writing: Task[None] | None = None
        self._has_failed = False
        self._put_off: set[Path] = set()

    def enter(self, home: Path | None, document: DocumentState, recovered: Path | None = None) -> None:
        """Switch to a document from a scene folder, or just saved to it; `recovered` is the path of its autosave."""
        self._home, self._autosaved, self._changed_at = home, document, None
        if self._entering is not None:
            self._entering.state = "cancelled"
        self._entering = self._background.start(
            lambda: self._autosave.enter(home, recovered), self._take_entered,
            lambda error: describe_error("The autosave has no place", error),
        )  # fmt: skip

    def forget(self) -> None:
        """Remove the autosave after the document was saved."""
        self._autosaved, self._changed_at = self._files.saved, None
        self._background.submit(self._autosave.remove)

    def look(self) -> None:
        """Look for autosaves of dead processes, of recent and of unsaved scenes, and offer to recover them."""
        homes = tuple(self._files.recent)
        self._background.start(lambda: self._autosave.abandoned(homes), self._offer, lambda _: None)

    def poll(self) -> None:
        """Write an autosave some time after a change. Once a frame."""
        if not self._is_due or self._viewport.is_opening:
            self._changed_at = None
            return
        if self._changed_at is None:
            self._changed_at = self.now()
        if self._writing is None and self.now() - self._changed_at >= self._preferences.value.autosave_s:
            self._write()

    def keep(self) -> None:
        """Write an autosave of a changed document now, when the program ends without asking."""
        if self._is_due:
            self._write()

    @property
    def autosaved_path(self) -> Path | None:
        """Path of the autosave, for use after closing; None if there is none."""
        try:
            if self._writing is not None:
                self._writing.future.result()
        except Exception as error:  # any disk error
            describe_error("The autosave can't be written", error)
        return self._autosave.place

    def left_at(self, place: Path) -> RecoveryCandidate:
        """Return the autosave of the previous window and never ask about it; for the thread.

        Raises OSError if it is gone or belongs to another process.
        """
        self._put_off.add(place)
        found = self._autosave.found(place)
        if found is None:
            raise OSError(f"{place}: nothing is kept there any more")
        return found

    def close(self, *, is_saved: bool) -> None:
        """Close; the autosave of an unsaved document stays for the next start."""
        if is_saved:
            self._background.submit(self._autosave.remove)
        self._background.submit(self._autosave.close)

    @property
    def _is_due(self) -> bool:
        """True if the document has changes that are neither saved nor in the autosave."""
        return self._viewport.document.state not in (self._files.saved, self._autosaved)

    def _write(self) -> None:
        self._autosaved, self._changed_at = self._viewport.document.state, None
        scene, known, home, stamp = saved_scene(self._viewport), self._files.known, self._files.home, self._files.stamp

        def take(_: None) -> None:
            self._writing, self._has_failed = None, False

        def fail(error: Exception) -> None:  # tried again, reported once
            self._writing, self._autosaved = None, self._files.saved
            if not self._has_failed:
                self._status.report(error, "The autosave can't be written")
            self._has_failed = True

        self._writing = self._background.start(lambda: self._autosave.write(scene, home, stamp, known), take, fail)

    def _take_entered(self, entered: tuple[bool, RecoveryCandidate | None]) -> None:
        is_alone, found = entered
        if is_alone:
            self._offer([found] if found is not None else [])
            return
        text = (
            f"{self._home} is open in another window of the program. "
            "The one that saves last overwrites what the other has saved."
        )
        stay = Answer("Go on", help="Keep both open.")
        close = Answer("Close it here", self._files.close_scene, "Go to an empty window.")
        self._status.ask(Question("Open twice", text, (stay, close)))

    def _offer(self, found: list[RecoveryCandidate]) -> None:
        """Ask about the first candidate, then about the next, until the user recovers one."""
        found = [each for each in found if each.place not in self._put_off]
        if not found:
            return
        first, *others = found
        self._put_off.add(first.place)

        def drop() -> None:
            self._background.submit(self._autosave.discard, first.place)
            self._offer(others)

        when, about, home = datetime.fromtimestamp(first.saved_at), first.about, first.about.folder
        where = f"Scene folder: {printable_line(home)}" if home else "It was never saved to a place of its own."
        text = (
            f"The program ended before the last changes of {about.name} were saved.\n"
            f"Autosaved on {when:%A %d %B %Y at %H:%M:%S}.\n\n{where}"
        )
        answers = (
            Answer("Recover", lambda: self._files.recover(first), "Go on with them; saving is up to you."),
            Answer("Discard", drop, "Remove them; the scene stays as it was last saved."),
            Answer("Later", lambda: self._offer(others), "Leave them; the next start asks again."),
        )
        self._status.ask(Question("Recover unsaved changes", text, answers))

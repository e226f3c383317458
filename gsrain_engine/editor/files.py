"""Files of the editor: open, import, save, export, revert, recent files, autosave, and crash recovery."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from ..datasets.open_capture import capture_format
from ..rain.settings import load_preset
from ..safe_io.limits import read_file
from ..safe_io.text_files import MAX_BYTES, printable_line
from ..scene.files import SceneFormatError, lock_path, whole_file
from ..scene.formats.registry import format_of, writable_suffixes
from ..scene.formats.scene_files import names_scene_folder, write_scene
from ..scene.formats.scene_folder import SCENE_FILE, FileCache
from ..scene.open import folder_to_read, is_built_in_street, load_sorted_scene, scene_folder_of
from ..scene.progress import Progress
from ..scene.scene import Scene
from ..scene.transforms import lost_when_flattened
from .autosave import (
    Autosave,
    FileFingerprint,
    FolderClaim,
    RecoveryCandidate,
    fingerprint_of,
    has_changed,
    saved_scene,
)
from .document import Document
from .edits.layers import import_scene
from .jobs.job import BackgroundWork
from .jobs.process import JobState
from .notifications import Answer, Question, describe_error, do_nothing
from .preferences import state_folder
from .services import EditorServices
from .viewport_state import PendingScene

logger = logging.getLogger("gsrain")

# Loading documents


@dataclass(frozen=True, eq=False)
class LoadedDocument:
    """A scene that was read, and the origin and state of its files."""

    scene: Scene
    source: str
    home: Path | None
    stamp: FileFingerprint | None
    known: FileCache
    recovered: RecoveryCandidate | None = None


class NotASceneError(SceneFormatError):
    """Raised for a capture where a scene is expected."""

    def __init__(self, path: Path, kind: str) -> None:
        """`kind` is the name of the capture's format."""
        super().__init__(path, f"this is a capture ({kind}), not a scene; File > Open a capture shows it")
        self.path, self.kind = path, kind


class SceneFiles:
    """The files of one session. Reading and writing runs in `thread`, everything else on the main thread."""

    def __init__(
        self, session: EditorServices, enter: Callable[[LoadedDocument], None], thread: ThreadPoolExecutor
    ) -> None:
        """`enter` switches to another document."""
        self._session, self._enter = session, enter
        self._thread = thread
        self.source: str | None = None
        """Path or name that was opened last."""
        self.home: Path | None = None
        """Scene folder that the document came from or was saved to, used by Save."""
        self.recent: list[Path] = recent_files()
        """Latest first."""
        self.place_wanted: Callable[[Path], None] | None = None
        """Set while the user has to choose where to save; called with the answer."""
        self.recovery = Recovery(session, self.recover, self.close_scene, thread)
        self._known = FileCache()
        self._stamp: FileFingerprint | None = None
        self._saved: Document = session.history.present
        self._opening: tuple[str, Future[LoadedDocument]] | None = None
        self._arriving: LoadedDocument | None = None
        self._saving: _SaveJob | None = None
        self._next_saving: Callable[[], None] | None = None
        self._importing: list[_ImportJob] = []
        self._exporting: list[_ExportJob] = []
        self._recent: Future[list[Path]] | None = None

    # State

    @property
    def has_changes(self) -> bool:
        """True if the document differs from the one that was opened or saved."""
        return self._session.history.present is not self._saved

    @property
    def known(self) -> FileCache:
        """Map of files to the Gaussians they hold; for the thread that reads and writes."""
        return self._known

    @property
    def is_opening(self) -> bool:
        return self._opening is not None

    @property
    def busy(self) -> str | None:
        """Description of the read or write that the user waits for, or None."""
        if self._opening is not None:
            return f"Opening {self._opening[0]}"
        if self._importing:
            return f"Importing {self._importing[0].path}"
        if self._saving is not None:
            return f"Saving {self._saving.target}"
        return f"Exporting {self._exporting[0].target}" if self._exporting else None

    @property
    def work(self) -> list[BackgroundWork]:
        """Reading and writing that would be lost if the document were closed, or the program ended, now."""
        return [*self._importing, *([self._saving] if self._saving is not None else []), *self._exporting]

    @property
    def pending(self) -> list[Future[Any]]:
        opening = [self._opening[1]] if self._opening is not None else []
        saving = [self._saving.future] if self._saving is not None else []
        recent = [self._recent] if self._recent is not None else []
        files = [*(each.future for each in self._importing), *(each.future for each in self._exporting)]
        return [*opening, *saving, *recent, *files, *self.recovery.pending]

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

    def import_from(self, path: str) -> None:
        """Read a scene in the background and add its layers and actors to the present one."""
        logger.info("Importing %s", path)
        self._session.problem = None
        self._importing.append(_ImportJob(f"Import {Path(path).name}", self._thread.submit(load_document, path), path))

    def revert(self) -> None:
        """Return to the version on disk."""
        source = str(self.home) if self.home is not None else self.source
        if source is None:
            return
        title, text = "Revert", f"All changes of {self._session.scene.name} since it was last saved are lost."
        back = Answer("Revert", lambda: self._reread(source), "Read the scene again.")
        if self.has_changes:
            self._session.questions.ask(Question(title, text, (back, _CANCEL)))
        else:
            self._reread(source)

    def close_scene(self) -> None:
        empty = LoadedDocument(Scene("no scene"), "", None, None, FileCache())
        self.confirm_unsaved_then("close the scene", lambda: self._enter(empty))

    def confirm_unsaved_then(self, what: str, act: Callable[[], None], *, ends_program: bool = False) -> None:
        """Call `act`, which replaces the document or ends the program; ask first if jobs run or changes are unsaved.

        Counts only jobs that end with the document, or all jobs if `ends_program`.
        """
        self._session.when_idle(
            self._ended_work(ends_program),
            what,
            lambda: self._when_saved(what, lambda: self._without_results(what, act)),
        )

    def _ended_work(self, ends_program: bool = False) -> list[BackgroundWork]:
        jobs = [each for each in self._session.jobs if ends_program or each.ends_with_scene]
        return [*jobs, *self.work]

    def _reread(self, source: str) -> None:
        self._session.when_idle(self._ended_work(), "revert", lambda: self.open_now(source))

    def _when_saved(self, what: str, act: Callable[[], None]) -> None:
        if not self.has_changes:
            act()
            return
        name = self._session.scene.name
        answers = (
            Answer("Save", lambda: self.save_then(act), f"Save {name}, then {what}."),
            Answer("Don't save", act, f"Lose the changes and {what}."),
            _CANCEL,
        )
        self._session.questions.ask(
            Question("Unsaved changes", f"Save the changes of {name} before you {what}?", answers)
        )

    def _without_results(self, what: str, act: Callable[[], None]) -> None:
        """Call `act`, after the user agrees to lose unsaved roll-outs."""
        results = self._session.loose_results
        if not results:
            act()
            return
        one = len(results) == 1
        listed = "".join(f"\n  -  {each}" for each in results)
        text = (
            f"{'This roll-out was' if one else 'These roll-outs were'} not saved, and {'is' if one else 'are'} lost "
            f"if you {what}:\n{listed}\n\nTo save one, choose Save as... in the Drive panel."
        )
        lose = Answer(f"Lose {'it' if one else 'them'}", act, f"Lose the roll-outs and {what}.")
        question = Question("Roll-outs that were not saved", text, (lose, _CANCEL), enter_answers=False)
        self._session.questions.ask(question)

    def enter(self, opened: LoadedDocument, document: Document) -> None:
        """Record that the session switched to an opened document."""
        self.source, self.home, self._known = opened.source or None, opened.home, opened.known
        self._stamp, self._saved = opened.stamp, document
        recovered = opened.recovered.place if opened.recovered is not None else None
        if recovered is not None:
            self._saved = replace(document)  # a new object, so that the document counts as changed
        self.recovery.enter(opened.home, document, recovered)
        if opened.source and not is_built_in_street(opened.source) and recovered is None:
            self._recent = self._thread.submit(add_recent_file, Path(opened.source))

    # Saving

    def save(self) -> None:
        """Save to the document's scene folder; ask for a folder if there is none."""
        self.save_then(do_nothing)

    def save_then(self, act: Callable[[], None]) -> None:
        """Save as `save` does, and call `act` after success."""
        if self.home is not None:
            self.save_to(self.home, act)
        else:
            self.place_wanted = lambda path: self.save_as(path, act)

    def save_to(self, path: Path, act: Callable[[], None] = do_nothing) -> None:
        """Save to a scene folder; ask first if another program has changed it."""
        home, path = self.home, path.parent if path.name == SCENE_FILE else path
        if not names_scene_folder(path):
            self._session.questions.ask(self._folder_question(path, act))
            return
        if home is None or path.resolve() != home or not has_changed(home, self._stamp):
            self._begin_saving(path, act)
            return

        def elsewhere() -> None:
            self.place_wanted = lambda chosen: self.save_as(chosen, act)

        answers = (
            Answer("Save as...", elsewhere, "Save to another place; both versions stay."),
            Answer("Overwrite", lambda: self._begin_saving(path, act), "What the other program has saved is lost."),
            Answer("Reload", lambda: self._reread(str(home)), "Read what is on the disk; lose the changes here."),
            _CANCEL,
        )
        text = f"{home} was changed by another program or window since it was opened or saved here."
        self._session.questions.ask(Question("Changed on disk", text, answers))

    def save_as(self, path: Path, act: Callable[[], None] = do_nothing) -> None:
        """Save to another place; ask first if it holds another scene folder."""
        other = scene_folder_of(path)
        if other is None or other == self.home:
            self.save_to(path, act)
            return
        replacing = Answer("Replace", lambda: self.save_to(path, act), "The scene that stands there now is lost.")
        text = f"There is another scene in {other}. Replace it?"
        self._session.questions.ask(Question("Replace a scene", text, (replacing, _CANCEL)))

    def export_to(self, path: Path) -> None:
        """Write a single file of everything visible, a copy: the document keeps its path and its unsaved changes.

        Asks first about losses in the format and about replacing a file.
        """
        try:
            row = format_of(path)
        except SceneFormatError as error:  # raised by an installed package
            self._session.problem = str(error)
            return
        if row is None or row.write is None or path.is_dir():
            *first, last = writable_suffixes()
            kinds = f"{', '.join(first)} or {last}"
            self._session.problem = f"{path}: Export writes one file, whose name ends in {kinds}."
            return
        scene = saved_scene(self._session)
        if self._session.rain == load_preset("clear"):
            scene = replace(scene, rain=None)
        missing = lost_when_flattened(scene)
        if not row.keeps_harmonics and any(each.gaussians.sh_degree for each in scene.members if each.visible):
            missing.append(f"how colors depend on the direction of view ({row.suffix} has no place for it)")
        if not missing and not path.exists():
            self._begin_exporting(scene, path)
            return
        lines = [f"{path.name} will hold the Gaussians that can be seen, as they are at 0 s."]
        if missing:
            lines.append("\nIt leaves out:\n" + "\n".join(f"  -  {each}" for each in missing))
            lines.append("\nThe document itself stays as it is; Save keeps all of it, in a scene folder.")
        if path.exists():
            lines.append(f"\nThe {path.name} that is there already is replaced.")
        yes = Answer("Export", lambda: self._begin_exporting(scene, path), f"Write {path}.")
        self._session.questions.ask(Question(f"Export {path.name}", "\n".join(lines), (yes, _CANCEL)))

    def _folder_question(self, path: Path, act: Callable[[], None]) -> Question:
        folder = path.with_name(path.name.removesuffix(path.suffix))
        text = (
            f"{path.name} names a single file. Save writes a scene folder, which keeps everything; "
            "Export writes a file of what can be seen."
        )
        into = Answer(f"Save as {folder.name}", lambda: self.save_as(folder, act), f"Write the scene folder {folder}.")
        file = Answer("Export...", lambda: self.export_to(path), f"Write {path}; changes stay unsaved.")
        return Question("Save writes a scene folder", text, (into, file, _CANCEL))

    def _capture_question(self, named: NotASceneError) -> Question:
        text = (
            f"{named.path.name} is a capture ({named.kind}), not a scene: pictures, which the Capture panel shows "
            "and makes a scene of. Open it there?"
        )
        show = Answer("Open the capture", lambda: self._session.captures.open(named.path), f"Read {named.path}.")
        return Question("Open a capture", text, (show, _CANCEL))

    def give_up(self) -> None:
        self._saved = self._session.history.present

    # Updates

    def offer_recovery(self) -> None:
        """Look for autosaves of dead processes and offer to recover them."""
        self.recovery.look(self.recent)

    def poll(self) -> None:
        """Process finished reads and writes. Once a frame."""
        if self._opening is not None and self._opening[1].done():
            (path, opening), self._opening = self._opening, None
            try:
                self._arriving = opening.result()
                self._session.stage(PendingScene(path, self._arriving.scene, is_opened=True))
            except NotASceneError as error:
                self._session.questions.ask(self._capture_question(error))
            except Exception as error:  # any file error: the window must survive
                self._session.problem = describe_error(f"{path} can't be opened", error)
                if Path(path) in self.recent and not Path(path).exists():
                    self._recent = self._thread.submit(forget_recent_file, Path(path))
        if self._saving is not None and self._saving.future.done():
            saving, self._saving = self._saving, None
            self._take_saved(saving)
        if self._importing and self._importing[0].future.done():
            self._take_imported(self._importing.pop(0))
        if self._exporting and self._exporting[0].future.done():
            self._take_exported(self._exporting.pop(0))
        if self._recent is not None and self._recent.done():
            recent, self._recent = self._recent, None
            if recent.exception() is None:
                self.recent = recent.result()
        self.recovery.poll(self._saved, self._stamp, self._known)

    def keep(self) -> None:
        """Write unsaved changes to the autosave at once, when the program ends without asking."""
        self.recovery.keep(self._saved, self._stamp, self._known)

    def arrive(self, scene: Scene) -> LoadedDocument:
        """Return the origin of a staged scene that was opened here."""
        opened, self._arriving = self._arriving, None
        return (
            opened
            if opened is not None and opened.scene is scene
            else LoadedDocument(scene, "", None, None, FileCache())
        )

    def close(self) -> None:
        """Finish pending writes. Removes the autosave, unless there are unsaved changes."""
        if self._opening is not None:
            self._opening[1].cancel()
        self.recovery.close(is_saved=not self.has_changes)

    def _begin_opening(self, label: str, read: Callable[[], LoadedDocument]) -> None:
        if self._opening is not None:
            self._opening[1].cancel()
        logger.info("Opening %s", label)
        self._session.problem = None
        self._opening = label, self._thread.submit(read)

    def _begin_saving(self, path: Path, act: Callable[[], None]) -> None:
        if self._saving is not None:  # only the latest save counts
            self._next_saving = lambda: self._begin_saving(path, act)
            return
        self._session.problem = None
        scene, document, known = saved_scene(self._session), self._session.history.present, self._known
        future = self._thread.submit(_write, scene, path, known)
        self._saving = _SaveJob(f"Save {path.name}", future, path.resolve(), document, act)

    def _begin_exporting(self, scene: Scene, path: Path) -> None:
        self._session.problem = None
        future = self._thread.submit(write_scene, scene, path)
        self._exporting.append(_ExportJob(f"Export {path.name}", future, path))

    def _take_saved(self, saving: "_SaveJob") -> None:
        again, self._next_saving = self._next_saving, None
        try:
            stamp = saving.future.result()
        except Exception as error:
            saving.state = "failed"
            self._session.problem = describe_error(f"{saving.target} can't be saved", error)
            return
        saving.state = "finished"
        logger.info("Saved %s", saving.target)
        self._saved = saving.document
        self.recovery.forget()
        if saving.target != self.home:
            self.recovery.enter(saving.target, saving.document)
        self.home, self.source, self._stamp = saving.target, str(saving.target), stamp
        self._recent = self._thread.submit(add_recent_file, saving.target)
        saving.act()
        if again is not None:
            again()

    def _take_imported(self, importing: "_ImportJob") -> None:
        if importing.state == "cancelled":
            return
        try:
            other = importing.future.result().scene
        except Exception as error:  # any file error: the window must survive
            importing.state = "failed"
            self._session.problem = describe_error(f"{importing.path} can't be imported", error)
        else:
            importing.state = "finished"
            self._session.edit(f"Import {other.name}", import_scene, other)
            logger.info("Imported %s: %s Gaussians", importing.path, f"{other.gaussian_count:,}")

    def _take_exported(self, exporting: "_ExportJob") -> None:
        try:
            exporting.future.result()
        except Exception as error:  # any disk error
            exporting.state = "failed"
            self._session.problem = describe_error(f"{exporting.target} can't be exported", error)
        else:
            exporting.state = "finished"
            logger.info("Exported %s", exporting.target)


@dataclass(eq=False)
class _FileJob:
    """Reading or writing in the thread, as background work; it ends when its result is processed."""

    title: str
    future: "Future[Any]"
    state: JobState = field(default="running", init=False)
    progress: Progress = field(default=Progress(0.0, ""), init=False)

    def cancel(self) -> None:
        """Discard the result; a file in writing is completed nevertheless."""
        self.state = "cancelled"


@dataclass(eq=False)
class _ImportJob(_FileJob):
    path: str


@dataclass(eq=False)
class _ExportJob(_FileJob):
    target: Path


@dataclass(eq=False)
class _SaveJob(_FileJob):
    target: Path
    document: Document
    act: Callable[[], None]


_CANCEL = Answer("Cancel", do_nothing, "Change nothing.")


def _write(scene: Scene, path: Path, known: FileCache) -> FileFingerprint | None:
    """Save, and return the state of the scene folder afterwards."""
    write_scene(scene, path, known, in_drawing_order=True)
    return fingerprint_of(path)


def load_document(path: str) -> LoadedDocument:
    """Read a scene as `load_sorted_scene` does, and raise what that raises.

    Raises `NotASceneError` if the path is a capture.
    """
    try:
        return _read(path)
    except SceneFormatError:
        kind = capture_format(path) if scene_folder_of(Path(path)) is None else None
        if kind is None:
            raise
        raise NotASceneError(Path(path), kind.name) from None


def _read(path: str) -> LoadedDocument:
    known = FileCache()
    home = folder_to_read(Path(path)) if not is_built_in_street(path) else None
    stamp = fingerprint_of(home) if home is not None else None  # before reading, to detect a change meanwhile
    source = path if is_built_in_street(path) else str(home or Path(path).absolute())
    return LoadedDocument(load_sorted_scene(path, known), source, home, stamp, known)


def load_autosave(autosaved: RecoveryCandidate) -> LoadedDocument:
    """Read an autosave; raises what `load_sorted_scene` raises."""
    known, about = FileCache(), autosaved.about
    scene = load_sorted_scene(str(autosaved.scene), known)
    home = about.folder
    return LoadedDocument(scene, str(home or ""), home, about.stamp, known, autosaved)


# Recent files, shared by all windows

MAX_RECENT_FILES = 12


class _Recent(msgspec.Struct):
    paths: list[str] = []


def recent_files() -> list[Path]:
    """Latest first."""
    try:
        return [
            Path(each)
            for each in msgspec.json.decode(read_file(_file(), MAX_BYTES), type=_Recent).paths[:MAX_RECENT_FILES]
        ]
    except FileNotFoundError:
        return []
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        logger.warning("%s: the list of recent scenes can't be read: %s", _file(), error)
        return []


def add_recent_file(path: Path) -> list[Path]:
    """Put a scene at the head of the list, keeping entries of other windows; return the list.

    Raises:
        OSError: If the list can't be written.
    """
    return _rewritten(path.absolute(), at_head=True)


def forget_recent_file(path: Path) -> list[Path]:
    """Remove a scene from the list; return the list.

    Raises:
        OSError: If the list can't be written.
    """
    return _rewritten(path.absolute(), at_head=False)


def _rewritten(path: Path, *, at_head: bool) -> list[Path]:
    folder = state_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with lock_path(folder):
        others = [each for each in recent_files() if each != path]
        paths = [path, *others][:MAX_RECENT_FILES] if at_head else others
        with whole_file(_file()) as beside:
            names = [str(each).encode(errors="replace").decode() for each in paths]
            beside.write_bytes(msgspec.json.encode(_Recent(names)))
    return paths


def _file() -> Path:
    return state_folder() / "recent.json"


# Screenshots


def new_screenshot(folder: Path) -> Path:
    """Choose an unused file name in a folder by the present date and time."""
    name = f"gsrain_{datetime.now():%Y-%m-%d_%H-%M-%S}"
    taken = {each.name for each in folder.glob(f"{name}*.png")}
    chosen, number = f"{name}.png", 1
    while chosen in taken:
        number += 1
        chosen = f"{name}_{number}.png"
    return folder / chosen


# Crash recovery


class Recovery:
    """The autosave of a session: written in `thread`, everything else on the main thread."""

    def __init__(
        self,
        session: EditorServices,
        recover: Callable[[RecoveryCandidate], None],
        close_scene: Callable[[], None],
        thread: ThreadPoolExecutor,
    ) -> None:
        """`recover` opens an autosave, `close_scene` switches to an empty window."""
        self._session, self._recover, self._close_scene = session, recover, close_scene
        self._thread = thread
        self.now: Callable[[], float] = monotonic
        """Clock in seconds."""
        self._autosave = Autosave()
        self._home: Path | None = None
        self._kept: Document = session.history.present
        self._changed_at: float | None = None
        self._keeping: Future[None] | None = None
        self._entering: Future[FolderClaim] | None = None
        self._looking: Future[list[RecoveryCandidate]] | None = None
        self._has_failed = False
        self._put_off: set[Path] = set()

    @property
    def pending(self) -> list[Future[Any]]:
        return [each for each in (self._keeping, self._entering, self._looking) if each is not None]

    def enter(self, home: Path | None, document: Document, recovered: Path | None = None) -> None:
        """Switch to a document from a scene folder, or just saved to it; `recovered` is the path of its autosave."""
        self._home, self._kept, self._changed_at = home, document, None
        self._entering = self._thread.submit(self._autosave.enter, home, recovered)

    def forget(self) -> None:
        """Remove the autosave after the document was saved."""
        self._changed_at = None
        self._thread.submit(self._autosave.remove)

    def look(self, homes: Sequence[Path]) -> None:
        """Look for autosaves of dead processes, for these scene folders and for unsaved scenes, and ask about them."""
        self._looking = self._thread.submit(self._autosave.abandoned, tuple(homes))

    def poll(self, saved: Document, stamp: FileFingerprint | None, known: FileCache) -> None:
        """Process finished tasks, and write an autosave some time after a change. Once a frame.

        `saved` is the document as on disk, `stamp` the folder's state, `known` the cache of its files.
        """
        if self._entering is not None and self._entering.done():
            entering, self._entering = self._entering, None
            self._take_entered(entering)
        if self._looking is not None and self._looking.done():
            looking, self._looking = self._looking, None
            if looking.exception() is None:
                self._offer(looking.result())
        if self._keeping is not None and self._keeping.done():
            keeping, self._keeping = self._keeping, None
            self._take_autosave(keeping, saved)
        self._keep(saved, stamp, known)

    def keep(self, saved: Document, stamp: FileFingerprint | None, known: FileCache) -> None:
        """Write an autosave of a changed document at once, when the program ends without asking."""
        present = self._session.history.present
        if present not in (saved, self._kept):
            self._begin_keeping(present, stamp, known)

    @property
    def autosaved_path(self) -> Path | None:
        """Path of the autosave, for use after closing; None if there is none."""
        try:
            if self._keeping is not None:
                self._keeping.result()
        except Exception as error:  # any disk error
            describe_error("The autosave can't be written", error)
        return self._autosave.place

    def left_at(self, place: Path) -> RecoveryCandidate:
        """Return the autosave of the previous window and never ask about it; for the thread.

        Raises:
            OSError: If it is gone or belongs to another process.
        """
        self._put_off.add(place)
        found = self._autosave.found(place)
        if found is None:
            raise OSError(f"{place}: nothing is kept there any more")
        return found

    def close(self, *, is_saved: bool) -> None:
        """Close; the autosave of an unsaved document stays for the next start."""
        if is_saved:
            self._thread.submit(self._autosave.remove)
        self._thread.submit(self._autosave.close)

    def _keep(self, saved: Document, stamp: FileFingerprint | None, known: FileCache) -> None:
        present = self._session.history.present
        if present in (saved, self._kept) or self._session.is_opening:
            self._changed_at = None
            return
        if self._changed_at is None:
            self._changed_at = self.now()
        if self._keeping is not None or self.now() - self._changed_at < self._session.preferences.autosave_s:
            return
        self._begin_keeping(present, stamp, known)

    def _begin_keeping(self, present: Document, stamp: FileFingerprint | None, known: FileCache) -> None:
        self._kept, self._changed_at = present, None
        self._keeping = self._thread.submit(self._autosave.write, saved_scene(self._session), stamp, known)

    def _take_autosave(self, keeping: "Future[None]", saved: Document) -> None:
        try:
            keeping.result()
        except Exception as error:  # any disk error: tried again, reported once
            self._kept = saved
            if not self._has_failed:
                self._session.problem = describe_error("The autosave can't be written", error)
            self._has_failed = True
        else:
            self._has_failed = False

    def _take_entered(self, entering: "Future[FolderClaim]") -> None:
        try:
            entered = entering.result()
        except OSError as error:
            describe_error("The autosave has no place", error)
            return
        if not entered.is_alone:
            text = (
                f"{self._home} is open in another window of the program. "
                "The one that saves last overwrites what the other has saved."
            )
            away = Answer("Close it here", self._close_scene, "Go to an empty window.")
            self._session.questions.ask(
                Question("Open twice", text, (Answer("Go on", do_nothing, "Keep both open."), away))
            )
        elif entered.found is not None and entered.found.place not in self._put_off:
            self._offer([entered.found])

    def _offer(self, found: list[RecoveryCandidate]) -> None:
        """Ask about the first candidate, then about the next, until the user recovers one."""
        found = [each for each in found if each.place not in self._put_off]
        if not found:
            return
        first, *others = found
        self._put_off.add(first.place)

        def drop() -> None:
            self._thread.submit(self._autosave.discard, first.place)
            self._offer(others)

        when, about = datetime.fromtimestamp(first.saved_at), first.about
        home = about.folder
        where = (
            f"Scene folder: {printable_line(home)}" if home is not None else "It was never saved to a place of its own."
        )
        text = (
            f"The program ended before the last changes of {about.name} were saved.\n"
            f"Autosaved on {when:%A %d %B %Y at %H:%M:%S}.\n\n{where}"
        )
        answers = (
            Answer("Recover", lambda: self._recover(first), "Go on with them; saving is up to you."),
            Answer("Discard", drop, "Remove them; the scene stays as it was last saved."),
            Answer("Later", lambda: self._offer(others), "Leave them; the next start asks again."),
        )
        self._session.questions.ask(Question("Recover unsaved changes", text, answers))

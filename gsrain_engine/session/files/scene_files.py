"""Opening, saving and keeping the document of a session, and what has to be asked on the way."""

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.flattening import left_out_when_flat
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.formats.gaussian_files import format_of, writable_suffixes
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.formats.scene_files import names_scene_folder
from gsrain_engine.scene.formats.scene_folder import SCENE_FILE
from gsrain_engine.scene.open_scene import is_built_in, scene_folder_of
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..desk import Desk
from ..document.document import Document
from ..document.staged_scene import StagedScene
from ..edits.importing import import_scene
from ..jobs.background_job import Work
from ..jobs.worker import JobState
from ..log import told
from ..questions import Answer, Question, nothing
from .autosave import Autosaved
from .disk_stamp import DiskStamp, has_changed, stamp_of
from .opened import CaptureNamedError, Opened, read_kept, read_opened
from .recent_files import add_recent_file, forget_recent_file, recent_files
from .recovery import Recovery
from .saved_scene import saved_scene

logger = logging.getLogger("gsrain")


class SceneFiles:
    """The files of one session. Reading and writing happens in `thread`, everything else on the main thread."""

    def __init__(self, session: Desk, enter: Callable[[Opened], None], thread: ThreadPoolExecutor) -> None:
        """`enter` goes to another document."""
        self._session, self._enter = session, enter
        self._thread = thread
        self.source: str | None = None
        """What was opened last, as it was named."""
        self.home: Path | None = None
        """The scene folder that the document came from or was saved to: where Save writes."""
        self.recent: list[Path] = recent_files()
        """Scenes that were used last, the latest first."""
        self.place_wanted: Callable[[Path], None] | None = None
        """Set while somebody has to be asked where to save; called with the answer."""
        self.recovery = Recovery(session, self.recover, self.close_scene, thread)
        self._known = KnownFiles()
        self._stamp: DiskStamp | None = None
        self._saved: Document = session.history.present
        self._opening: tuple[str, Future[Opened]] | None = None
        self._arriving: Opened | None = None
        self._saving: _Saving | None = None
        self._next_saving: Callable[[], None] | None = None
        self._importing: list[_Importing] = []
        self._exporting: list[_Exporting] = []
        self._recent: Future[list[Path]] | None = None

    # What is known

    @property
    def has_changes(self) -> bool:
        """Whether the document is another than the one that was opened or saved."""
        return self._session.history.present is not self._saved

    @property
    def known(self) -> KnownFiles:
        """Which files hold which Gaussians; for the thread that reads and writes."""
        return self._known

    @property
    def is_opening(self) -> bool:
        return self._opening is not None

    @property
    def busy(self) -> str | None:
        """What is being read or written for a person who waits for it; None when nothing is."""
        if self._opening is not None:
            return f"Opening {self._opening[0]}"
        if self._importing:
            return f"Importing {self._importing[0].path}"
        if self._saving is not None:
            return f"Saving {self._saving.target}"
        return f"Exporting {self._exporting[0].target}" if self._exporting else None

    @property
    def work(self) -> list[Work]:
        """Reading and writing that would be lost if the document went, or the program ended, now."""
        return [*self._importing, *([self._saving] if self._saving is not None else []), *self._exporting]

    @property
    def pending(self) -> list[Future[Any]]:
        """Everything that goes on in the thread."""
        opening = [self._opening[1]] if self._opening is not None else []
        saving = [self._saving.future] if self._saving is not None else []
        recent = [self._recent] if self._recent is not None else []
        files = [*(each.future for each in self._importing), *(each.future for each in self._exporting)]
        return [*opening, *saving, *recent, *files, *self.recovery.pending]

    # Opening

    def open(self, path: str) -> None:
        """Go to another scene, once a person has said what becomes of unsaved changes."""
        self.when_safe(f"open {Path(path).name or path}", lambda: self.open_now(path))

    def open_now(self, path: str) -> None:
        """Read a scene in the background and go to it; of several, the one that was asked for last."""
        self._begin_opening(path, lambda: read_opened(path))

    def recover(self, autosaved: Autosaved) -> None:
        """Go on with what a process that died has kept; its changes are still to be saved."""
        self._begin_opening(autosaved.about.name, lambda: read_kept(autosaved))

    def go_on_at(self, place: Path) -> None:
        """Go on with what the window before this one has kept; nobody is asked, its changes are still to be saved."""
        self._begin_opening("what was not saved", lambda: read_kept(self.recovery.left_at(place)))

    def import_from(self, path: str) -> None:
        """Read a scene in the background and add its layers and actors to the present one."""
        logger.info("Importing %s", path)
        self._session.problem = None
        self._importing.append(_Importing(f"Import {Path(path).name}", self._thread.submit(read_opened, path), path))

    def revert(self) -> None:
        """Go back to what is on the disk."""
        source = str(self.home) if self.home is not None else self.source
        if source is None:
            return
        title, text = "Revert", f"All changes of {self._session.scene.name} since it was last saved are lost."
        back = Answer("Revert", lambda: self._read_again(source), "Read the scene again.")
        if self.has_changes:
            self._session.questions.ask(Question(title, text, (back, _CANCEL)))
        else:
            self._read_again(source)

    def close_scene(self) -> None:
        """Go to an empty scene."""
        empty = Opened(Scene("no scene"), "", None, None, KnownFiles())
        self.when_safe("close the scene", lambda: self._enter(empty))

    def when_safe(self, what: str, act: Callable[[], None], *, ends_program: bool = False) -> None:
        """Do what takes the place of the document or ends the program; with work or unsaved changes, ask first.

        Of jobs, those count that end with it: all where it ends the program.
        """
        self._session.when_idle(
            self._ended_work(ends_program),
            what,
            lambda: self._when_saved(what, lambda: self._without_results(what, act)),
        )

    def _ended_work(self, ends_program: bool = False) -> list[Work]:
        jobs = [each for each in self._session.jobs if ends_program or each.ends_with_scene]
        return [*jobs, *self.work]

    def _read_again(self, source: str) -> None:
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
        """Do it, once a person agrees to lose the roll-outs that were not saved."""
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

    def enter(self, opened: Opened, document: Document) -> None:
        """Take note that the session went to a document that was opened."""
        self.source, self.home, self._known = opened.source or None, opened.home, opened.known
        self._stamp, self._saved = opened.stamp, document
        recovered = opened.recovered.place if opened.recovered is not None else None
        if recovered is not None:
            self._saved = replace(document)  # another value: there are changes
        self.recovery.enter(opened.home, document, recovered)
        if opened.source and not is_built_in(opened.source) and recovered is None:
            self._recent = self._thread.submit(add_recent_file, Path(opened.source))

    # Saving

    def save(self) -> None:
        """Save where the document came from; where that is no scene folder, ask for a place."""
        self.save_then(nothing)

    def save_then(self, act: Callable[[], None]) -> None:
        """Save as `save` does, and do something once that has succeeded."""
        if self.home is not None:
            self.save_to(self.home, act)
        else:
            self.place_wanted = lambda path: self.save_as(path, act)

    def save_to(self, path: Path, act: Callable[[], None] = nothing) -> None:
        """Save to a scene folder, unless somebody else has changed what is there: then ask first."""
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
            Answer("Reload", lambda: self._read_again(str(home)), "Read what is on the disk; lose the changes here."),
            _CANCEL,
        )
        text = f"{home} was changed by another program or window since it was opened or saved here."
        self._session.questions.ask(Question("Changed on disk", text, answers))

    def save_as(self, path: Path, act: Callable[[], None] = nothing) -> None:
        """Save to another place; where another scene folder stands there, ask first."""
        other = scene_folder_of(path)
        if other is None or other == self.home:
            self.save_to(path, act)
            return
        replacing = Answer("Replace", lambda: self.save_to(path, act), "The scene that stands there now is lost.")
        text = f"There is another scene in {other}. Replace it?"
        self._session.questions.ask(Question("Replace a scene", text, (replacing, _CANCEL)))

    def export_to(self, path: Path) -> None:
        """Write one file of what can be seen, a copy: the document stays as unsaved, and where, as it is.

        Before, a person hears what the file leaves out, and which one it replaces.
        """
        try:
            row = format_of(path)
        except SceneFormatError as error:  # of an installed package
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
        missing = left_out_when_flat(scene)
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

    def _capture_question(self, named: CaptureNamedError) -> Question:
        text = (
            f"{named.path.name} is a capture ({named.kind}), not a scene: pictures, which the Capture panel shows "
            "and makes a scene of. Open it there?"
        )
        show = Answer("Open the capture", lambda: self._session.captures.open(named.path), f"Read {named.path}.")
        return Question("Open a capture", text, (show, _CANCEL))

    def give_up(self) -> None:
        """Take it that a person does not want the changes: nothing is kept of them."""
        self._saved = self._session.history.present

    # Over time

    def offer_recovery(self) -> None:
        """Look for what processes that died have kept, and ask what becomes of it."""
        self.recovery.look(self.recent)

    def poll(self) -> None:
        """Take in what the thread has finished. Once a frame."""
        if self._opening is not None and self._opening[1].done():
            (path, opening), self._opening = self._opening, None
            try:
                self._arriving = opening.result()
                self._session.stage(StagedScene(path, self._arriving.scene, is_opened=True))
            except CaptureNamedError as error:
                self._session.questions.ask(self._capture_question(error))
            except Exception as error:  # whatever a file can do to its reader: the window lives on
                self._session.problem = told(f"{path} can't be opened", error)
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
        """Keep unsaved changes at once: the program is about to end, and nobody was asked."""
        self.recovery.keep(self._saved, self._stamp, self._known)

    def arrive(self, scene: Scene) -> Opened:
        """What is known about a staged scene that was opened here."""
        opened, self._arriving = self._arriving, None
        return opened if opened is not None and opened.scene is scene else Opened(scene, "", None, None, KnownFiles())

    def close(self) -> None:
        """End: wait for what is being written. What is kept of unsaved changes goes, unless nobody was asked."""
        if self._opening is not None:
            self._opening[1].cancel()
        self.recovery.close(is_saved=not self.has_changes)

    def _begin_opening(self, label: str, read: Callable[[], Opened]) -> None:
        if self._opening is not None:
            self._opening[1].cancel()
        logger.info("Opening %s", label)
        self._session.problem = None
        self._opening = label, self._thread.submit(read)

    def _begin_saving(self, path: Path, act: Callable[[], None]) -> None:
        if self._saving is not None:  # the newest is what counts
            self._next_saving = lambda: self._begin_saving(path, act)
            return
        self._session.problem = None
        scene, document, known = saved_scene(self._session), self._session.history.present, self._known
        future = self._thread.submit(_write, scene, path, known)
        self._saving = _Saving(f"Save {path.name}", future, path.resolve(), document, act)

    def _begin_exporting(self, scene: Scene, path: Path) -> None:
        self._session.problem = None
        future = self._thread.submit(write_scene, scene, path)
        self._exporting.append(_Exporting(f"Export {path.name}", future, path))

    def _take_saved(self, saving: "_Saving") -> None:
        again, self._next_saving = self._next_saving, None
        try:
            stamp = saving.future.result()
        except Exception as error:
            saving.state = "failed"
            self._session.problem = told(f"{saving.target} can't be saved", error)
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

    def _take_imported(self, importing: "_Importing") -> None:
        if importing.state == "cancelled":
            return
        try:
            other = importing.future.result().scene
        except Exception as error:  # whatever a file can do to its reader: the window lives on
            importing.state = "failed"
            self._session.problem = told(f"{importing.path} can't be imported", error)
        else:
            importing.state = "finished"
            self._session.edit(f"Import {other.name}", import_scene, other)
            logger.info("Imported %s: %s Gaussians", importing.path, f"{other.gaussian_count:,}")

    def _take_exported(self, exporting: "_Exporting") -> None:
        try:
            exporting.future.result()
        except Exception as error:  # whatever a disk can do
            exporting.state = "failed"
            self._session.problem = told(f"{exporting.target} can't be exported", error)
        else:
            exporting.state = "finished"
            logger.info("Exported %s", exporting.target)


@dataclass(eq=False)
class _FileWork:
    """Reading or writing in the thread, as work to wait for; it has ended when its result is taken in."""

    title: str
    future: "Future[Any]"
    state: JobState = field(default="running", init=False)
    progress: Progress = field(default=Progress(0.0, ""), init=False)

    def cancel(self) -> None:
        """Leave the result; a file that is being written becomes whole all the same."""
        self.state = "cancelled"


@dataclass(eq=False)
class _Importing(_FileWork):
    path: str


@dataclass(eq=False)
class _Exporting(_FileWork):
    target: Path


@dataclass(eq=False)
class _Saving(_FileWork):
    target: Path
    document: Document
    act: Callable[[], None]


_CANCEL = Answer("Cancel", nothing, "Change nothing.")


def _write(scene: Scene, path: Path, known: KnownFiles) -> DiskStamp | None:
    """Save; returns the state of the scene folder afterwards."""
    write_scene(scene, path, known, in_drawing_order=True)
    return stamp_of(path)

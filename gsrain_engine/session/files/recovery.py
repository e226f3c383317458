"""When a session keeps its unsaved document, and what it asks about documents that others have left behind."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import Any

from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.untrusted.printable import printable

from ..desk import Desk
from ..document.document import Document
from ..log import told
from ..questions import Answer, Question, nothing
from .autosave import Autosave, Autosaved, Entered
from .disk_stamp import DiskStamp
from .saved_scene import saved_scene


class Recovery:
    """The autosave of a session: written in `thread`, everything else on the main thread."""

    def __init__(
        self,
        session: Desk,
        recover: Callable[[Autosaved], None],
        close_scene: Callable[[], None],
        thread: ThreadPoolExecutor,
    ) -> None:
        """`recover` goes on with what was kept, `close_scene` goes to an empty window."""
        self._session, self._recover, self._close_scene = session, recover, close_scene
        self._thread = thread
        self.now: Callable[[], float] = monotonic
        """Seconds."""
        self._autosave = Autosave()
        self._home: Path | None = None
        self._kept: Document = session.history.present
        self._changed_at: float | None = None
        self._keeping: Future[None] | None = None
        self._entering: Future[Entered] | None = None
        self._looking: Future[list[Autosaved]] | None = None
        self._has_failed = False
        self._put_off: set[Path] = set()

    @property
    def pending(self) -> list[Future[Any]]:
        """What goes on in the thread."""
        return [each for each in (self._keeping, self._entering, self._looking) if each is not None]

    def enter(self, home: Path | None, document: Document, recovered: Path | None = None) -> None:
        """Go to a document that came from a scene folder or is now saved in it; `recovered` is where it was kept."""
        self._home, self._kept, self._changed_at = home, document, None
        self._entering = self._thread.submit(self._autosave.enter, home, recovered)

    def forget(self) -> None:
        """Remove what was kept: the document is saved."""
        self._changed_at = None
        self._thread.submit(self._autosave.remove)

    def look(self, homes: Sequence[Path]) -> None:
        """Look for what processes that died have kept, of these scene folders and of none, and ask about it."""
        self._looking = self._thread.submit(self._autosave.abandoned, tuple(homes))

    def poll(self, saved: Document, stamp: DiskStamp | None, known: KnownFiles) -> None:
        """Take in what the thread has finished, and keep a document that was changed a while ago. Once a frame.

        `saved` is the document as it is on the disk, in the state `stamp`, in the files that `known` knows.
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
            self._take_kept(keeping, saved)
        self._keep(saved, stamp, known)

    def keep(self, saved: Document, stamp: DiskStamp | None, known: KnownFiles) -> None:
        """Keep a document that was changed at once: the program is about to end, and nobody was asked."""
        present = self._session.history.present
        if present not in (saved, self._kept):
            self._begin_keeping(present, stamp, known)

    @property
    def kept(self) -> Path | None:
        """Where the document is kept, to be asked after the end; None where it is not."""
        try:
            if self._keeping is not None:
                self._keeping.result()
        except Exception as error:  # whatever a disk can do
            told("The autosave can't be written", error)
        return self._autosave.place

    def left_at(self, place: Path) -> Autosaved:
        """What the window before this one has kept, to go on with unasked; for the thread.

        Raises:
            OSError: When it is gone, or somebody else's.
        """
        self._put_off.add(place)
        found = self._autosave.found(place)
        if found is None:
            raise OSError(f"{place}: nothing is kept there any more")
        return found

    def close(self, *, is_saved: bool) -> None:
        """End; what is kept of a document that is not saved stays for the next start."""
        if is_saved:
            self._thread.submit(self._autosave.remove)
        self._thread.submit(self._autosave.close)

    def _keep(self, saved: Document, stamp: DiskStamp | None, known: KnownFiles) -> None:
        present = self._session.history.present
        if present in (saved, self._kept) or self._session.is_opening:
            self._changed_at = None
            return
        if self._changed_at is None:
            self._changed_at = self.now()
        if self._keeping is not None or self.now() - self._changed_at < self._session.preferences.autosave_s:
            return
        self._begin_keeping(present, stamp, known)

    def _begin_keeping(self, present: Document, stamp: DiskStamp | None, known: KnownFiles) -> None:
        self._kept, self._changed_at = present, None
        self._keeping = self._thread.submit(self._autosave.write, saved_scene(self._session), stamp, known)

    def _take_kept(self, keeping: "Future[None]", saved: Document) -> None:
        try:
            keeping.result()
        except Exception as error:  # whatever a disk can do: it is tried again, and told of once
            self._kept = saved
            if not self._has_failed:
                self._session.problem = told("The autosave can't be written", error)
            self._has_failed = True
        else:
            self._has_failed = False

    def _take_entered(self, entering: "Future[Entered]") -> None:
        try:
            entered = entering.result()
        except OSError as error:
            told("The autosave has no place", error)
            return
        if not entered.is_alone:
            text = (
                f"{self._home} is open in another window of the program. "
                "The one that saves last overwrites what the other has saved."
            )
            away = Answer("Close it here", self._close_scene, "Go to an empty window.")
            self._session.questions.ask(
                Question("Open twice", text, (Answer("Go on", nothing, "Keep both open."), away))
            )
        elif entered.found is not None and entered.found.place not in self._put_off:
            self._offer([entered.found])

    def _offer(self, found: list[Autosaved]) -> None:
        """Ask about the first; about the next once that is answered, unless a person goes on with it."""
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
        where = f"Scene folder: {printable(home)}" if home is not None else "It was never saved to a place of its own."
        text = (
            f"The program ended before the last changes of {about.name} were saved.\n"
            f"They were kept on {when:%A %d %B %Y at %H:%M:%S}.\n\n{where}"
        )
        answers = (
            Answer("Recover", lambda: self._recover(first), "Go on with them; saving is up to you."),
            Answer("Discard", drop, "Remove them; the scene stays as it was last saved."),
            Answer("Later", lambda: self._offer(others), "Leave them; the next start asks again."),
        )
        self._session.questions.ask(Question("Recover unsaved changes", text, answers))

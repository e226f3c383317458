"""What the Jobs panel shows of any work that goes on behind the window."""

import logging
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import platformdirs

from ...scene.files import lock_path, sentence_of, try_lock_path
from ...scene.formats.scene_folder import FileCache, write_scene_folder
from ...scene.progress import Progress
from ...scene.scene import Scene
from ..viewport_state import PendingScene, ViewportState
from .process import JobState, Work, WorkerProcess


@runtime_checkable
class BackgroundWork(Protocol):
    """Something that goes on in the background and can be waited for or stopped."""

    title: str
    state: JobState
    progress: Progress

    def cancel(self) -> None:
        """Stop, wherever it is, without waiting; the document stays as it was."""
        ...


@runtime_checkable
class BackgroundJob(BackgroundWork, Protocol):
    """One run of something. Its own threads and processes never touch the session: `poll` does."""

    ends_with_scene: bool
    """Whether it ends when the session goes to another scene: its result belongs to this one."""
    error: str | None
    """What went wrong, as one line; `details` has the rest."""
    details: str | None

    def poll(self, session: ViewportState) -> None:
        """Go on, without waiting; once a frame while it runs. Whoever finishes brings the result into the session."""
        ...


# § A job whose worker gets a copy of the document: save it aside, work in another process, take what came of it.


class CopiedSceneJob:
    """One run, a `BackgroundJob`. A kind of job says what comes of it in `_take`."""

    ends_with_scene = True

    def __init__(
        self,
        title: str,
        scene: Scene,
        known: FileCache,
        files: ThreadPoolExecutor,
        start: Callable[[Path], WorkerProcess],
    ) -> None:
        """Start on a document as it goes into files; `files` is the thread where reading and writing happens.

        What `known` says to be in a file already is taken from there. `start` begins the work on the copy's folder.
        """
        self.title = title
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Saving the scene for the worker")
        self.error: str | None = None
        self.details: str | None = None
        self._start = start
        self._folder = JobTempDir(files)
        self._copying: Future[Path] | None = self._folder.do(lambda folder: write_copy(scene, folder, known))
        self._worker: WorkerProcess | None = None

    def poll(self, session: ViewportState) -> None:
        """Go on to the next stage when the present one is through; never waits."""
        if self.state != "running":
            return
        try:
            if self._copying is not None and self._copying.done():
                copying, self._copying = self._copying, None
                self._worker = self._start(copying.result())
            if self._worker is not None:
                self._follow(self._worker)
        except Exception as error:  # whatever a disk or a worker can do: the window lives on
            self.error = self._describe(error)
            self._end("failed")

    def cancel(self) -> None:
        if self.state == "running":
            self._end("cancelled")

    def _take(self, last: Progress) -> None:
        """Take what the worker has ended with; raises what stands in the way of that."""
        raise NotImplementedError

    def _describe(self, error: Exception) -> str:
        return sentence_of(error)

    def _follow(self, worker: WorkerProcess) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            self._take(worker.progress)
            self._end("finished")

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._copying is not None:
            self._copying.cancel()
        self._folder.remove(self._worker)
        self._worker = self._copying = None


# § A job whose result is a scene, from click to swap: prepare, work in another process, load, hand over.
#
# Preparing and loading happen in the session's thread, the work in a process of its own, and only `poll`, on the main
# thread, touches the session.

logger = logging.getLogger("gsrain")


@dataclass(frozen=True, slots=True)
class WorkerCall:
    """What a worker is to do."""

    work: Work
    arguments: tuple[Any, ...]


@runtime_checkable
class JobKind(Protocol):
    """What one kind of job does at each stage; `folder` is an empty one of its own, removed in the end."""

    title: str
    preparing: str
    """Said while `prepare` runs."""

    @property
    def report(self) -> Path | None:
        """HTML page that the worker writes, if any."""
        ...

    def prepare(self, folder: Path) -> WorkerCall:
        """Write what the worker needs."""
        ...

    def snapshot(self, folder: Path) -> Scene | None:
        """Read how far the work has come, where that is worth a look; None for nothing new."""
        ...

    def load(self, folder: Path) -> Scene:
        """Read the result."""
        ...

    def staged(self, scene: Scene) -> PendingScene:
        """Say how the result comes into the document."""
        ...


class SceneJob:
    """One run of a task, a `BackgroundJob`."""

    ends_with_scene = True

    def __init__(self, task: JobKind, files: ThreadPoolExecutor) -> None:
        """Start; `files` is where reading and writing happens."""
        self.title = task.title
        self.state: JobState = "running"
        self.progress = Progress(0.0, task.preparing)
        self.error: str | None = None
        self.details: str | None = None
        self.report: Path | None = None
        """The report, once it is there."""
        self.task = task
        self._folder = JobTempDir(files)
        self._preparing: Future[WorkerCall] | None = self._folder.do(task.prepare)
        self._worker: WorkerProcess | None = None
        self._snapshot: Future[Scene | None] | None = None
        self._looked_at = ""
        """What the worker had said when its last snapshot was asked for."""
        self._loading: Future[Scene] | None = None
        self._gesture = f"job {secrets.token_hex(8)}"
        self._has_shown = False
        """Whether a snapshot has been on its way into the document."""

    def poll(self, session: ViewportState) -> None:
        """Go on to the next stage when the present one is through; never waits. The result is staged at the end."""
        if self.state != "running":
            return
        try:
            if self._preparing is not None and self._preparing.done():
                assignment, self._preparing = self._preparing.result(), None
                self._worker = WorkerProcess(self.title, assignment.work, *assignment.arguments)
            if self._worker is not None:
                self._follow(self._worker, session)
            if self._loading is not None and self._loading.done():
                self._stage(self._loading.result(), session, is_finished=True)
                self.report = self.task.report
                logger.info("%s: done%s", self.title, "" if self.report is None else f"; report: {_short(self.report)}")
                self._end("finished")
        except Exception as error:  # whatever a disk or a worker can do: the window lives on
            self.error = sentence_of(error)
            self._end("failed")

    def cancel(self) -> None:
        if self.state == "running":
            self._end("cancelled")

    def _follow(self, worker: WorkerProcess, session: ViewportState) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            self._worker = None
            self.progress = Progress(1.0, "Loading the result", self.progress.preview)
            self._loading = self._folder.do(partial(self._load, worker))
        else:
            self._follow_snapshots(session)

    def _follow_snapshots(self, session: ViewportState) -> None:
        if self._snapshot is not None and self._snapshot.done():
            scene, self._snapshot = self._snapshot.result(), None
            if scene is not None and session.staged is None:
                self._stage(scene, session, is_finished=False)
        if self._snapshot is None and self.progress.message != self._looked_at:
            self._looked_at = self.progress.message
            self._snapshot = self._folder.do(self.task.snapshot)

    def _stage(self, scene: Scene, session: ViewportState, *, is_finished: bool) -> None:
        if not session.is_opening:  # else it would take the place of the scene that comes
            goes_on = self._has_shown and not is_finished
            self._has_shown = True
            session.stage(replace(self.task.staged(scene), gesture=self._gesture, goes_on=goes_on))

    def _load(self, worker: WorkerProcess, folder: Path) -> Scene:
        worker.close()
        return self.task.load(folder)

    def _end(self, state: JobState) -> None:
        self.state = state
        if state == "finished":
            self.progress = Progress(1.0, "Done", self.progress.preview)
        if self._worker is not None:
            self._worker.cancel()
        if self._preparing is not None:
            self._preparing.cancel()
        self._folder.remove(self._worker)
        self._worker = None


def _short(file: Path) -> str:
    """The path of a file, with ~ for the user's home."""
    home = Path.home()
    return str(Path("~") / file.relative_to(home)) if file.is_relative_to(home) else str(file)


# § The temporary folder of one job: made, used and removed in the thread where a session reads and writes files.

_Result = TypeVar("_Result")

_PREFIX = "gsrain-job-"


class JobTempDir:
    """Not there before something is done with it; `files` has one thread, so that all happens in turn.

    A lock says that its process lives: where that was killed, the next one removes the folder.
    """

    def __init__(self, files: ThreadPoolExecutor) -> None:
        self._files = files
        self._path: Path | None = None
        self._open = ExitStack()

    def do(self, work: Callable[[Path], _Result]) -> Future[_Result]:
        """Do something with the folder in the thread."""
        return self._files.submit(self._done, work)

    def remove(self, worker: WorkerProcess | None) -> None:
        """End the process that works with the folder, then remove it: behind what was asked for before, not waited for.

        Ending a process and emptying a folder take their time, in which the window goes on.
        """
        self._files.submit(self._removed, worker)

    def _done(self, work: Callable[[Path], _Result]) -> _Result:
        if self._path is None:
            self._path = self._open.enter_context(temporary_folder())
        return work(self._path)

    def _removed(self, worker: WorkerProcess | None) -> None:
        if worker is not None:
            worker.close()
        self._open.close()


@contextmanager
def temporary_folder() -> Generator[Path]:
    """Make a folder that is there for as long as the block runs; see `remove_abandoned_job_folders`."""
    with ExitStack() as lock:
        path = _locked_folder(lock)
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)


def _locked_folder(lock: ExitStack) -> Path:
    while True:
        path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        with suppress(FileNotFoundError):
            lock.enter_context(lock_path(path))
        if path.is_dir():
            return path
        lock.close()  # another process took it for an abandoned one before it was locked


def remove_abandoned_job_folders() -> None:
    """Remove the folders of this user's processes that were killed. Without effect where the system knows no locks."""
    if os.name != "posix":
        return
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if path.is_symlink() or path.stat().st_uid != os.getuid():
                continue
            with try_lock_path(path) as is_free:
                if is_free:
                    shutil.rmtree(path, ignore_errors=True)


# § The document on the disk for another process: a scene folder in a job's temporary one.

_SCENE = "scene"


def write_copy(scene: Scene, folder: Path, known: FileCache) -> Path:
    """Write a scene into a temporary folder; returns the scene folder. Files that are known are linked, not written."""
    copy = folder / _SCENE
    write_scene_folder(scene, copy, known, linking=True, in_drawing_order=True)
    known.forget(copy)  # it will be gone soon
    return copy


# § Where the reports of the window's jobs stay.

_LONGEST = 120
"""Bytes of what a report is about that go into its file's name."""


def new_report(name: str) -> Path:
    """Choose a file for one about `name`, by the present date and time; its folder need not be there yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    about = re.sub(r"[/\x00-\x1f\x7f]", "_", name).encode(errors="replace")[:_LONGEST].decode(errors="ignore")
    when = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    places = (folder / f"{about}_{when}{suffix}.html" for suffix in ("", *(f"_{number}" for number in range(2, 100))))
    return next((place for place in places if not place.exists()), folder / f"{about}_{when}.html")

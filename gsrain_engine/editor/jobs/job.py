"""Base of background jobs: protocols, jobs on a copy of the document, jobs that return a scene, and their folders."""

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
    """Background work that can be waited for or stopped."""

    title: str
    state: JobState
    progress: Progress

    def cancel(self) -> None:
        """Stop without waiting; the document stays unchanged."""
        ...


@runtime_checkable
class BackgroundJob(BackgroundWork, Protocol):
    """One run of a job. Its threads and processes never touch the session; only `poll` does."""

    ends_with_scene: bool
    """True if the job ends when the session switches to another scene, because its result belongs to this one."""
    error: str | None
    """Error in one line; `details` has the traceback."""
    details: str | None

    def poll(self, session: ViewportState) -> None:
        """Continue without blocking; once a frame while it runs. Brings the final result into the session."""
        ...


# Jobs on a copy of the document


class CopiedSceneJob:
    """One run, a `BackgroundJob`: save a copy, work in another process, process the result in `_take`."""

    ends_with_scene = True

    def __init__(
        self,
        title: str,
        scene: Scene,
        known: FileCache,
        files: ThreadPoolExecutor,
        start: Callable[[Path], WorkerProcess],
    ) -> None:
        """Start on a document as saved in files; `files` is the thread for reading and writing.

        Links files that `known` already holds. `start` starts the worker on the copy's folder.
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
        """Start the next stage after the present one has finished; never blocks."""
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
        """Process the worker's result; raises if that fails."""
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


# Jobs that return a scene: prepare, work in another process, load, stage
# Preparing and loading run in the session's thread, the work in its own process, and only `poll`, on the main thread,
# touches the session.

logger = logging.getLogger("gsrain")


@dataclass(frozen=True, slots=True)
class WorkerCall:
    """Function and arguments for a worker."""

    work: Work
    arguments: tuple[Any, ...]


@runtime_checkable
class JobKind(Protocol):
    """Stages of one kind of job; `folder` is an empty folder of its own, removed in the end."""

    title: str
    preparing: str
    """Message while `prepare` runs."""

    @property
    def report(self) -> Path | None:
        """HTML page that the worker writes, if any."""
        ...

    def prepare(self, folder: Path) -> WorkerCall:
        """Write the worker's input."""
        ...

    def snapshot(self, folder: Path) -> Scene | None:
        """Read an intermediate result to show; None if there is nothing new."""
        ...

    def load(self, folder: Path) -> Scene: ...

    def staged(self, scene: Scene) -> PendingScene:
        """Return the scene with the way it enters the document."""
        ...


class SceneJob:
    """One run of a `JobKind`, a `BackgroundJob`."""

    ends_with_scene = True

    def __init__(self, task: JobKind, files: ThreadPoolExecutor) -> None:
        """Start; `files` is the thread for reading and writing."""
        self.title = task.title
        self.state: JobState = "running"
        self.progress = Progress(0.0, task.preparing)
        self.error: str | None = None
        self.details: str | None = None
        self.report: Path | None = None
        """Path of the report, after the job has finished."""
        self.task = task
        self._folder = JobTempDir(files)
        self._preparing: Future[WorkerCall] | None = self._folder.do(task.prepare)
        self._worker: WorkerProcess | None = None
        self._snapshot: Future[Scene | None] | None = None
        self._looked_at = ""
        """Worker's message at the last snapshot request."""
        self._loading: Future[Scene] | None = None
        self._gesture = f"job {secrets.token_hex(8)}"
        self._has_shown = False
        """True if a snapshot was staged."""

    def poll(self, session: ViewportState) -> None:
        """Start the next stage after the present one has finished; never blocks. Stages the result at the end."""
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
        except Exception as error:  # any disk or worker error: the window must survive
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
        if not session.is_opening:  # otherwise it would replace the scene that is being opened
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
    """Path of a file, with ~ for the user's home."""
    home = Path.home()
    return str(Path("~") / file.relative_to(home)) if file.is_relative_to(home) else str(file)


# Temporary folders

_Result = TypeVar("_Result")
_PREFIX = "gsrain-job-"


class JobTempDir:
    """The temporary folder of one job, created on first use; `files` has one thread, so that all access is in order.

    A lock marks the process as alive; after it was killed, a later process removes the folder.
    """

    def __init__(self, files: ThreadPoolExecutor) -> None:
        self._files = files
        self._path: Path | None = None
        self._open = ExitStack()

    def do(self, work: Callable[[Path], _Result]) -> Future[_Result]:
        """Call `work` with the folder in the thread."""
        return self._files.submit(self._done, work)

    def remove(self, worker: WorkerProcess | None) -> None:
        """End the worker, then remove the folder, after all earlier tasks and without waiting.

        Both take time, during which the window continues.
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
    """Create a folder for the duration of the block; see `remove_abandoned_job_folders`."""
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
        lock.close()  # another process removed it as abandoned before it was locked


def remove_abandoned_job_folders() -> None:
    """Remove folders of this user's killed processes. Does nothing on systems other than POSIX."""
    if os.name != "posix":
        return
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if path.is_symlink() or path.stat().st_uid != os.getuid():
                continue
            with try_lock_path(path) as is_free:
                if is_free:
                    shutil.rmtree(path, ignore_errors=True)


# Copy of the document

_SCENE = "scene"


def write_copy(scene: Scene, folder: Path, known: FileCache) -> Path:
    """Write a scene into a temporary folder and return the scene folder. Links known files instead of writing them."""
    copy = folder / _SCENE
    write_scene_folder(scene, copy, known, linking=True, in_drawing_order=True)
    known.forget(copy)  # it will be removed soon
    return copy


# Reports

_LONGEST = 120  # maximum number of bytes of the report's subject in its file name


def new_report(name: str) -> Path:
    """Choose a report file for `name`, by the present date and time; its folder may not exist yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    about = re.sub(r"[/\x00-\x1f\x7f]", "_", name).encode(errors="replace")[:_LONGEST].decode(errors="ignore")
    when = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    places = (folder / f"{about}_{when}{suffix}.html" for suffix in ("", *(f"_{number}" for number in range(2, 100))))
    return next((place for place in places if not place.exists()), folder / f"{about}_{when}.html")

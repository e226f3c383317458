"""Background jobs: write the input, work in another process, read the result, hand it over; and their folders."""

import logging
import os
import re
import secrets
import shutil
import tempfile
import traceback
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import platformdirs

from ...scene.files import lock_path, sentence_of, try_lock_path
from ...scene.formats.scene_folder import FileCache, write_scene_folder
from ...scene.progress import Progress
from ...scene.scene import Scene
from ..viewport_state import PendingScene, ViewportState
from .process import JobState, Work, WorkerProcess, WorkerThread

logger = logging.getLogger("gsrain")
_Result = TypeVar("_Result")
_SAVING = Progress(0.0, "Saving the scene for the worker")
JobKind = Literal[
    "reconstruct", "recolor", "make rainy", "preview", "fine-tune", "floaters", "drive", "drive video", "export"
]


@dataclass(eq=False)
class Job(Generic[_Result]):
    """One run of a job. Its threads and processes never touch the editor; only the functions that `poll` calls do."""

    kind: JobKind
    title: str
    work: Work
    """Function for the worker, which gets the arguments that `inputs` returns."""
    read: Callable[[Path], _Result]
    """Reads the result from the job's folder; in the thread for files."""
    on_result: Callable[[_Result, bool], str | None]
    """Takes the result (True) or a snapshot (False) on the main thread; may return the last message."""
    inputs: Callable[[Path], tuple[Any, ...]] = lambda _: ()
    """Writes the worker's input into the job's folder, and returns the arguments; in the thread for files."""
    snapshot: Callable[[Path], _Result | None] | None = None
    """Reads an intermediate result after a message, None if there is nothing new; in the thread for files."""
    on_cancel: Callable[[], object] = lambda: None
    ends_with_scene: bool = True
    """True if the job ends when the editor switches to another scene, because its result belongs to this one."""
    in_thread: bool = False
    """True for work in a thread instead of another process."""
    report: Path | None = None
    """HTML page that the worker writes, if any."""
    progress: Progress = _SAVING
    state: JobState = field(default="running", init=False)
    error: str | None = field(default=None, init=False)
    """Error in one line; `details` has the traceback."""
    details: str | None = field(default=None, init=False)
    _preparing: Future[tuple[Any, ...]] | None = field(default=None, init=False)
    _worker: WorkerProcess | WorkerThread | None = field(default=None, init=False)
    _snapshot: Future[_Result | None] | None = field(default=None, init=False)
    _snapshot_message: str = field(default="", init=False)
    """Worker's message at the last snapshot request."""
    _reading: Future[_Result] | None = field(default=None, init=False)

    def start(self, files: ThreadPoolExecutor) -> None:
        """Start; `files` is the thread for reading and writing."""
        self._folder = JobTempDir(files)
        self._preparing = self._folder.do(self.inputs)

    def poll(self) -> None:
        """Start the next stage after the present one has finished; never blocks. Once a frame while it runs."""
        if self.state != "running":
            return
        try:
            if self._preparing is not None and self._preparing.done():
                arguments, self._preparing = self._preparing.result(), None
                self._worker = (WorkerThread if self.in_thread else WorkerProcess)(self.work, *arguments)
            if self._worker is not None:
                self._follow(self._worker)
            if self._reading is not None and self._reading.done():
                message = self.on_result(self._reading.result(), True)
                self.progress = self.progress._replace(message=message or "Done")
                self._end("finished")
        except Exception as error:  # any error of a disk, a worker or odd values: the window must survive
            self.error, self.details = sentence_of(error), traceback.format_exc()
            self._end("failed")

    def cancel(self) -> None:
        """Stop without waiting; the document stays unchanged."""
        if self.state == "running":
            self.on_cancel()
            self._end("cancelled")

    def wait(self, timeout_s: float) -> None:
        """Wait until `poll` has something to process."""
        stages: list[Future[Any] | None] = [self._preparing, self._snapshot, self._reading]
        pending: list[Future[Any]] = [each for each in stages if each is not None]
        if pending:
            wait_for(pending, timeout_s)
        elif self._worker is not None:
            self._worker.wait(timeout_s)

    def _follow(self, worker: WorkerProcess | WorkerThread) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
            return
        if worker.state == "finished":

            def read(folder: Path) -> _Result:
                worker.close()
                return self.read(folder)

            self.progress = worker.progress._replace(fraction=1.0, message="Loading the result")
            self._worker, self._snapshot, self._reading = None, None, self._folder.do(read)
            return
        if self._snapshot is not None and self._snapshot.done():
            found, self._snapshot = self._snapshot.result(), None
            if found is not None:
                self.on_result(found, False)
        if self.snapshot is not None and self._snapshot is None and self.progress.message != self._snapshot_message:
            self._snapshot_message = self.progress.message
            self._snapshot = self._folder.do(self.snapshot)

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._preparing is not None:
            self._preparing.cancel()
        self._folder.remove(self._worker)
        self._preparing = self._worker = self._snapshot = self._reading = self.snapshot = None
        self.work = self.inputs = self.read = self.on_result = _ended  # frees what they refer to, such as scenes


def _ended(*_: object) -> Any:
    """Stand in for the functions of a job that has ended."""


def scene_job(
    session: ViewportState,
    kind: JobKind,
    title: str,
    work: Work,
    inputs: Callable[[Path], tuple[Any, ...]],
    read: Callable[[Path], Scene],
    *,
    is_whole: bool = False,
    snapshot: Callable[[Path], Scene | None] | None = None,
    report: Path | None = None,
    progress: Progress = _SAVING,
) -> Job[Scene]:
    """Create a job whose result is a scene; its snapshots and its result are one undo step.

    With `is_whole`, the result replaces the present scene; otherwise only its wet colors are used.
    """
    gesture, has_shown = f"job {secrets.token_hex(8)}", False

    def stage(scene: Scene, is_final: bool) -> None:
        nonlocal has_shown
        if not is_final and session.staged is not None:
            return
        if not session.is_opening:  # otherwise it would replace the scene that is being opened
            goes_on, has_shown = has_shown and not is_final, True
            session.staged = PendingScene(
                title, scene, is_whole=is_whole, only_wet_colors=not is_whole, gesture=gesture, goes_on=goes_on
            )
        if is_final:
            logger.info("%s: done%s", title, "" if report is None else f"; report: {_short(report)}")

    return Job(kind, title, work, read, stage, inputs, snapshot, report=report, progress=progress)


def _short(file: Path) -> str:
    """Path of a file, with ~ for the user's home."""
    home = Path.home()
    return str(Path("~") / file.relative_to(home)) if file.is_relative_to(home) else str(file)


# Temporary folders

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

        def done() -> _Result:
            if self._path is None:
                self._path = self._open.enter_context(temporary_folder())
            return work(self._path)

        return self._files.submit(done)

    def remove(self, worker: WorkerProcess | WorkerThread | None = None) -> None:
        """End the worker, then remove the folder, after all earlier tasks and without waiting.

        Both take time, during which the window continues.
        """
        if worker is not None:
            self._files.submit(worker.close)
        self._files.submit(self._open.close)


@contextmanager
def temporary_folder() -> Generator[Path]:
    """Create a folder for the duration of the block; see `remove_abandoned_job_folders`."""
    with ExitStack() as lock:
        while True:
            path = Path(tempfile.mkdtemp(prefix=_PREFIX))
            with suppress(FileNotFoundError):
                lock.enter_context(lock_path(path))
            if path.is_dir():
                break
            lock.close()  # another process removed it as abandoned before it was locked
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)


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


# Calls in a thread


@dataclass(eq=False)
class ThreadTask(Generic[_Result]):
    """A call in a thread; it ends when its result, or its error, is processed on the main thread."""

    title: str
    progress: Progress
    future: Future[_Result]
    on_result: Callable[[_Result], object]
    on_error: Callable[[Exception], object]
    state: JobState = field(default="running", init=False)

    def cancel(self) -> None:
        """Discard the result; a file in writing is completed nevertheless."""
        self.state = "cancelled"
        self.future.cancel()


class ThreadTasks:
    """Calls in a thread, whose results are processed on the main thread in the order of their start."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        self.running: list[ThreadTask[Any]] = []
        self._thread = thread

    @property
    def futures(self) -> list[Future[Any]]:
        """Results of all running calls, to wait for where there are no frames."""
        return [each.future for each in self.running]

    def start(
        self,
        work: Callable[[], _Result],
        on_result: Callable[[_Result], object],
        on_error: Callable[[Exception], object],
        title: str = "",
        message: str = "",
    ) -> ThreadTask[_Result]:
        """Call `work` in the thread; `message` is its progress."""
        future = self._thread.submit(work)
        task = ThreadTask(title, Progress(0.0, message), future, on_result, on_error)
        self.running.append(task)
        return task

    def poll(self) -> None:
        """Process the calls that have ended. Once a frame."""
        for task in [each for each in self.running if each.future.done()]:
            self.running.remove(task)
            if task.state == "cancelled":
                continue
            try:
                result = task.future.result()
            except Exception as error:  # any error of a disk or a file: the window must survive
                task.state = "failed"
                task.on_error(error)
            else:
                task.state = "finished"
                task.on_result(result)


# Copy of the document


def write_copy(scene: Scene, folder: Path, known: FileCache) -> Path:
    """Write a scene into a temporary folder and return the scene folder. Links known files instead of writing them."""
    copy = folder / "scene"
    write_scene_folder(scene, copy, known, linking=True, in_drawing_order=True)
    known.forget(copy)  # it will be removed soon
    return copy


# Reports

_MAX_SUBJECT_BYTES = 120  # of the report's subject in its file name


def new_report(name: str) -> Path:
    """Choose a report file for `name`, by the present date and time; its folder may not exist yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    about = re.sub(r"[/\x00-\x1f\x7f]", "_", name).encode(errors="replace")[:_MAX_SUBJECT_BYTES].decode(errors="ignore")
    when = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    places = (folder / f"{about}_{when}{suffix}.html" for suffix in ("", *(f"_{number}" for number in range(2, 100))))
    return next((place for place in places if not place.exists()), folder / f"{about}_{when}.html")

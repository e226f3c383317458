"""A job whose result is a scene, from click to swap: prepare, work in another process, load, hand over.

Preparing and loading happen in the session's thread, the work in a process of its own, and only `poll`, on the main
thread, touches the session.
"""

import logging
import secrets
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from gsrain_engine.scene.errors import sentence_of
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..document.staged_scene import StagedScene
from ..document.viewed_document import ViewedDocument
from .job_folder import JobFolder
from .worker import Job, JobState, Work

logger = logging.getLogger("gsrain")


@dataclass(frozen=True, slots=True)
class Assignment:
    """What a worker is to do."""

    work: Work
    arguments: tuple[Any, ...]


@runtime_checkable
class SceneTask(Protocol):
    """What one kind of job does at each stage; `folder` is an empty one of its own, removed in the end."""

    title: str
    preparing: str
    """Said while `prepare` runs."""

    @property
    def report(self) -> Path | None:
        """HTML page that the worker writes, if any."""
        ...

    def prepare(self, folder: Path) -> Assignment:
        """Write what the worker needs."""
        ...

    def snapshot(self, folder: Path) -> Scene | None:
        """Read how far the work has come, where that is worth a look; None for nothing new."""
        ...

    def load(self, folder: Path) -> Scene:
        """Read the result."""
        ...

    def staged(self, scene: Scene) -> StagedScene:
        """Say how the result comes into the document."""
        ...


class SceneJob:
    """One run of a task, a `BackgroundJob`."""

    ends_with_scene = True

    def __init__(self, task: SceneTask, files: ThreadPoolExecutor) -> None:
        """Start; `files` is where reading and writing happens."""
        self.title = task.title
        self.state: JobState = "running"
        self.progress = Progress(0.0, task.preparing)
        self.error: str | None = None
        self.details: str | None = None
        self.report: Path | None = None
        """The report, once it is there."""
        self.task = task
        self._folder = JobFolder(files)
        self._preparing: Future[Assignment] | None = self._folder.do(task.prepare)
        self._worker: Job | None = None
        self._snapshot: Future[Scene | None] | None = None
        self._looked_at = ""
        """What the worker had said when its last snapshot was asked for."""
        self._loading: Future[Scene] | None = None
        self._gesture = f"job {secrets.token_hex(8)}"
        self._has_shown = False
        """Whether a snapshot has been on its way into the document."""

    def poll(self, session: ViewedDocument) -> None:
        """Go on to the next stage when the present one is through; never waits. The result is staged at the end."""
        if self.state != "running":
            return
        try:
            if self._preparing is not None and self._preparing.done():
                assignment, self._preparing = self._preparing.result(), None
                self._worker = Job(self.title, assignment.work, *assignment.arguments)
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

    def _follow(self, worker: Job, session: ViewedDocument) -> None:
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

    def _follow_snapshots(self, session: ViewedDocument) -> None:
        if self._snapshot is not None and self._snapshot.done():
            scene, self._snapshot = self._snapshot.result(), None
            if scene is not None and session.staged is None:
                self._stage(scene, session, is_finished=False)
        if self._snapshot is None and self.progress.message != self._looked_at:
            self._looked_at = self.progress.message
            self._snapshot = self._folder.do(self.task.snapshot)

    def _stage(self, scene: Scene, session: ViewedDocument, *, is_finished: bool) -> None:
        if not session.is_opening:  # else it would take the place of the scene that comes
            goes_on = self._has_shown and not is_finished
            self._has_shown = True
            session.stage(replace(self.task.staged(scene), gesture=self._gesture, goes_on=goes_on))

    def _load(self, worker: Job, folder: Path) -> Scene:
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

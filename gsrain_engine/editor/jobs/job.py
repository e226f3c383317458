"""Background jobs: start them, follow them, hand their results over on the main thread."""

import logging
import traceback
from array import array
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import monotonic, time
from typing import Any, Generic, Literal, TypeVar, cast

import numpy as np
from jaxtyping import Float64

from ...safe_io.errors import sentence_of
from ...scene.progress import PENDING, Progress, duration_text
from ..background import Background
from .folder import temporary_folder
from .process import JobState, Work, WorkerProcess, WorkerThread

logger = logging.getLogger("gsrain")
_Result = TypeVar("_Result")
_SAVING = Progress(0.0, "Saving the scene for the worker")
_DONE = "Done"
_NOTICED_S = 60.0  # a notice of an end goes by itself after this time
_ESTIMATED_FROM, _ESTIMATED_AFTER_S = 0.02, 2.0  # fraction and time from which the time left is estimated
JobKind = Literal[
    "reconstruct", "recolor", "make rainy", "preview", "fine-tune", "floaters", "lamps", "scene edit", "calibration",
    "drive", "drive video", "export", "timing", "frame",
]  # fmt: skip


class MetricCurves:
    """Metrics of a job so far, by name. Their abscissa is the metric `step`, or the fraction for jobs without."""

    def __init__(self) -> None:
        self._points: dict[str, tuple[array[float], array[float]]] = {}

    def add(self, progress: Progress) -> None:
        place = progress.metrics.get("step", progress.fraction)
        for name, value in progress.metrics.items():
            places, values = self._points.setdefault(name, (array("d"), array("d")))
            places.append(place)
            values.append(value)

    def curve(self, name: str) -> Float64[np.ndarray, "2 n"]:
        """Abscissas and values of a metric; each point is the mean of several messages if there are many."""
        points = np.array(self._points.get(name, ((), ())), np.float64)
        each = max(1, points.shape[1] // _MAX_POINTS)
        whole = points.shape[1] // each * each
        return points[:, :whole].reshape(2, -1, each).mean(axis=2)


_MAX_POINTS = 400  # of a curve


@dataclass(eq=False)
class Job(Generic[_Result]):
    """One piece of work for another process: its input, its function, its result. Start it with a `JobRunner`."""

    kind: JobKind
    title: str
    work: Work
    """Function for the worker, which gets the arguments that `inputs` returns."""
    read: Callable[[Path], _Result] | None = None
    """Reads the result from the job's folder, in the thread for files; by default the result is what `work` returns in
    a thread, and None of a process."""
    inputs: Callable[[Path], tuple[Any, ...]] = lambda _: ()
    """Writes the worker's input into the job's folder, and returns the arguments; in the thread for files."""
    snapshot: Callable[[Path], _Result | None] | None = None
    """Reads an intermediate result after a message, None if there is nothing new; in the thread for files."""
    on_cancel: Callable[[], object] = lambda: None
    ends_with_scene: bool = True
    """True if the job ends when the editor switches to another scene, because its result belongs to this one."""
    in_thread: bool = False
    """True for work of seconds, in a thread instead of another process; it does not wait for other jobs."""
    report: Path | None = None
    """HTML page that the worker writes, if any."""
    output: Path | None = None
    """File or folder that the worker writes at a place that the user chose, if any."""
    progress: Progress = _SAVING
    plots: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """Metrics to draw as curves, by the title of their plot."""
    curves: MetricCurves = field(default_factory=MetricCurves, init=False)
    state: JobState = field(default="queued", init=False)
    result: _Result | None = field(default=None, init=False)
    error: str | None = field(default=None, init=False)
    """Error in one line; `details` has the traceback."""
    details: str | None = field(default=None, init=False)
    runner: "JobRunner | None" = field(default=None, init=False, repr=False)
    """Runner that has started it."""
    started_s: float | None = field(default=None, init=False)
    ended_s: float | None = field(default=None, init=False)
    """Start and end on the monotonic clock."""
    first_step: tuple[float, float] | None = field(default=None, init=False)
    """Time and fraction of the first progress, before which the worker prepared."""
    is_noticed: bool = field(default=False, init=False)
    """True once the user has dismissed the notice of its end."""

    @property
    def is_pending(self) -> bool:
        """True from its start to its end, waiting or running."""
        return self.runner is not None and self.state in PENDING

    @property
    def has_output(self) -> bool:
        """True if it has ended and its output can be opened: all of it, or what was written until it was canceled."""
        if self.output is None or self.state not in ("finished", "cancelled"):
            return False
        try:
            written_s = time() - self.output.stat().st_mtime
        except OSError:
            return False
        return self.state == "finished" or (self.started_s is not None and written_s < monotonic() - self.started_s)

    @property
    def seconds(self) -> float:
        """Duration so far, or until its end; 0 while it waits."""
        return (
            0.0 if self.started_s is None else (monotonic() if self.ended_s is None else self.ended_s) - self.started_s
        )

    @property
    def remaining_s(self) -> float | None:
        """Estimate of the time left, from what was done since the first progress; None while that is too little."""
        if self.state != "running" or self.first_step is None:
            return None
        seconds, done = monotonic() - self.first_step[0], self.progress.fraction - self.first_step[1]
        if done < _ESTIMATED_FROM or seconds < _ESTIMATED_AFTER_S:
            return None
        return seconds * (1 - self.progress.fraction) / done

    def cancel(self) -> None:
        """Stop without waiting; the document stays unchanged. Does nothing before the start and after the end."""
        if self.runner is not None:
            self.runner.cancel(self)

    def run_next(self) -> None:
        """Move a waiting job before the others that wait."""
        if self.runner is not None:
            self.runner.run_next(self)

    def run_now(self) -> None:
        """Begin a waiting job next to the one that runs, with which it shares the machine."""
        if self.runner is not None:
            self.runner.run_now(self)

    def wait(self, timeout_s: float) -> _Result:
        """Run a started job to its end and return its result, in programs without frames. Main thread only.

        Raises `JobError` if it fails or is cancelled, and TimeoutError.
        """
        assert self.runner is not None, "not started"
        until = monotonic() + timeout_s
        while self.is_pending:
            if (left_s := until - monotonic()) <= 0:
                raise TimeoutError(f"{self.title}: has not ended after {timeout_s:g} s: {self.progress.message}")
            self.runner.wait(left_s, *((self,) if self.state == "running" else ()))
            self.runner.poll()
        if self.state != "finished":
            raise JobError(f"{self.title}: {self.error or self.state}")
        return cast(_Result, self.result)

    def forget_work(self) -> None:
        """Free what its functions refer to, such as scenes."""
        self.work = self.inputs = _ended
        self.read = self.snapshot = None


def _ended(*_: object) -> Any:
    """Stand in for the functions of a job that has ended."""


class JobError(RuntimeError):
    """A job that was waited for has failed or was cancelled."""


# Running jobs

_Waiting = Callable[[float], object]
"""Waits some seconds at most for what a stage needs to go on."""
_Receiver = Callable[[Any, bool], str | None]
_Stages = Generator[_Waiting, None, str | None]
"""The stages of a running job: yields where it has to wait, and returns the last message."""


class JobRunner:
    """Runs jobs, on the main thread. Their threads and processes touch nothing else: `poll` hands results over.

    Processes run one after another, because each uses the whole machine, but for one that the user tells to run now;
    jobs in threads do not wait.
    """

    def __init__(
        self,
        files: Background,
        report_problem: Callable[[str], object],
        is_ready: Callable[[], bool] = lambda: True,
    ) -> None:
        """Read and write in `files`; `report_problem` gets one sentence about each job that fails.

        While `is_ready` returns False, no waiting job begins: the result of the last one is still being taken in.
        """
        self.all: list[Job[Any]] = []
        """Waiting, running and ended jobs in the order of their start, until the user clears them."""
        self._files, self._report_problem, self._is_ready = files, report_problem, is_ready
        self._stages: dict[Job[Any], tuple[_Stages, _Waiting]] = {}
        self._queue: list[tuple[Job[Any], _Receiver]] = []

    def start(self, job: Job[_Result], on_result: Callable[[_Result, bool], str | None]) -> Job[_Result]:
        """Start a job, or let it wait until those before it have ended.

        `on_result` takes its result (True) and snapshots (False); it may return the last message.
        """
        job.state, job.runner = "queued", self
        self.all.append(job)
        if job.in_thread:
            self._begin(job, on_result)
            return job
        self._queue.append((job, on_result))
        if not self._begin_next():
            logger.info("%s: waits for %s", job.title, self._predecessor(job))
        return job

    @property
    def running(self) -> list[Job[Any]]:
        return list(self._stages)

    @property
    def waiting(self) -> list[Job[Any]]:
        """Jobs that wait, in the order in which they will run."""
        return [job for job, _ in self._queue]

    @property
    def pending(self) -> list[Job[Any]]:
        """Running jobs, then those that wait."""
        return [*self.running, *self.waiting]

    @property
    def notices(self) -> list[Job[Any]]:
        """Jobs that have lately finished, or were canceled with output, newest first, until they are dismissed."""
        now = monotonic()
        return [
            each for each in reversed(self.all)
            if each.ended_s is not None and now - each.ended_s < _NOTICED_S
            and not each.is_noticed and each.kind != "preview"
            and (each.state == "finished" or each.has_output)
        ]  # fmt: skip

    def newest(self, *kinds: JobKind) -> Job[Any] | None:
        """Return the job of some kinds that was started last."""
        return next((each for each in reversed(self.all) if each.kind in kinds), None)

    def is_running(self, kind: JobKind) -> bool:
        """Return whether a job of a kind runs."""
        return any(each.kind == kind for each in self._stages)

    def writes(self, path: Path) -> Job[Any] | None:
        """Return the pending job that writes a file or folder, if any."""
        return next((each for each in self.pending if each.output == path), None)

    def run_next(self, job: Job[Any]) -> None:
        """Move a waiting job before the others that wait."""
        self._queue.sort(key=lambda each: each[0] is not job)

    def run_now(self, job: Job[Any]) -> None:
        """Begin a waiting job at once, next to those that run."""
        self.run_next(job)
        if self._queue and self._queue[0][0] is job and self._is_ready():
            self._begin(*self._queue.pop(0))

    def poll(self) -> None:
        """Start the next stage of each job whose present one has ended, and hand over results; never blocks."""
        for job in self.running:
            if job in self._stages:  # not cancelled by the result of another one
                self._advance(job, self._stages[job][0])
        self._begin_next()

    def wait(self, timeout_s: float, *jobs: Job[Any]) -> None:
        """Wait until `poll` has something to process of running jobs (all, one after the other), or time is up."""
        for job in jobs or self.running:
            self._stages[job][1](timeout_s)

    def cancel(self, job: Job[Any]) -> None:
        """Stop a running job without waiting for its end, or take it out of the queue; the document is unchanged."""
        if job.state == "running":
            job.on_cancel()
            stages, _ = self._stages[job]
            self._end(job, "cancelled")
            stages.close()
        elif job in self.waiting:
            self._queue = [each for each in self._queue if each[0] is not job]
            self._end(job, "cancelled")

    def leave_scene(self) -> None:
        """Cancel the jobs that end with the present scene, and free the results of those that have ended."""
        for job in reversed(self.all):
            if job.ends_with_scene:
                self.cancel(job)
                job.result = None

    def close(self) -> None:
        """Cancel all jobs."""
        for job in reversed(self.all):
            self.cancel(job)

    def forget(self, job: Job[Any]) -> None:
        """Remove a job that has ended from the list, or is ending."""
        self.all = [each for each in self.all if each is not job]

    def clear(self) -> None:
        """Forget the jobs that have ended."""
        self.all = [each for each in self.all if each.is_pending]

    def _begin_next(self) -> bool:
        """Begin the first waiting job if no other process runs; returns whether none waits any more."""
        if self._queue and self._is_ready() and all(each.in_thread for each in self._stages):
            self._begin(*self._queue.pop(0))
        return not self._queue

    def _begin(self, job: Job[Any], on_result: _Receiver) -> None:
        job.state, job.started_s = "running", monotonic()
        if job.kind != "preview":
            logger.info("%s: started", job.title)
        self._advance(job, self._stages_of(job, on_result))

    def _predecessor(self, job: Job[Any]) -> str:
        """Title of the job after which a waiting one runs."""
        before = [each for each in self.pending if not each.in_thread and each is not job]
        return before[-1].title if before else "the scene that is being brought into the picture"

    def _advance(self, job: Job[Any], stages: _Stages) -> None:
        try:
            self._stages[job] = stages, next(stages)
        except StopIteration as end:
            job.progress = job.progress._replace(message=end.value or _DONE)
            self._end(job, "finished")
        except Exception as error:  # any error of a disk, a worker or odd values: the window must survive
            if job.error is None:
                job.error, job.details = sentence_of(error), traceback.format_exc()
            self._end(job, "failed")
            self._report_problem(f"{job.title} failed: {job.error}")

    def _end(self, job: Job[Any], state: JobState) -> None:
        job.state, job.ended_s = state, monotonic()
        job.forget_work()
        self._stages.pop(job, None)
        if job.kind != "preview" and state != "failed":  # a failure is reported as a problem
            words = "canceled" if state == "cancelled" else "done"
            report = f"; report: {_short(job.report)}" if state == "finished" and job.report is not None else ""
            result = f": {job.progress.message}" if state == "finished" and job.progress.message != _DONE else ""
            after = "before it began" if job.started_s is None else f"after {duration_text(job.seconds)}"
            logger.info("%s: %s %s%s%s", job.title, words, after, result, report)

    def _stages_of(self, job: Job[_Result], on_result: Callable[[_Result, bool], str | None]) -> _Stages:
        """Prepare the input, follow the worker, read the result; cleans up behind itself wherever it is closed."""
        folders, worker = ExitStack(), None

        def prepare() -> tuple[Path, tuple[Any, ...]]:
            folder = folders.enter_context(temporary_folder())
            return folder, job.inputs(folder)

        preparing = self._files.submit(prepare)
        try:
            folder, arguments = yield from _result_of(preparing)
            worker = (WorkerThread if job.in_thread else WorkerProcess)(job.work, *arguments)
            snapshot: Future[_Result | None] | None = None
            is_due = False  # a snapshot, because the worker has sent a message since the last one
            while worker.state == "running":
                yield worker.wait if snapshot is None else partial(wait_for, [snapshot])
                steps = worker.poll()
                job.progress, is_due = worker.progress, is_due or bool(steps)
                if job.first_step is None and job.progress.fraction > 0:
                    job.first_step = monotonic(), job.progress.fraction
                for step in steps:
                    job.curves.add(step)
                if snapshot is not None and snapshot.done():
                    found, snapshot = snapshot.result(), None
                    if found is not None:
                        on_result(found, False)
                if job.snapshot is not None and is_due and snapshot is None and worker.state == "running":
                    snapshot, is_due = self._files.submit(job.snapshot, folder), False
            if worker.state == "failed":
                job.error, job.details = worker.error, worker.details
                raise JobError(worker.error)
            job.progress = job.progress._replace(fraction=1.0, message="Loading the result")
            if job.read is not None:
                job.result = yield from _result_of(self._files.submit(job.read, folder))
            elif isinstance(worker, WorkerThread):
                job.result = worker.result
            return on_result(cast(_Result, job.result), True)
        finally:
            preparing.cancel()
            if worker is not None:
                worker.cancel()
                self._files.submit(worker.close)
            self._files.submit(folders.close)  # behind all that reads or writes in the folder, without waiting


def _result_of(future: Future[_Result]) -> Generator[_Waiting, None, _Result]:
    """Wait for a call in a thread; raises what it has raised."""
    while not future.done():
        yield partial(wait_for, [future])
    return future.result()


def _short(file: Path) -> str:
    """Path of a file, with ~ for the user's home."""
    home = Path.home()
    return str(Path("~") / file.relative_to(home)) if file.is_relative_to(home) else str(file)

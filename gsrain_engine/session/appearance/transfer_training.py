"""The job "Train the transfer": a worker fine-tunes; its losses, samples and warnings can be watched meanwhile."""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Float64

from gsrain_engine.appearance.finetuning.loss_log import read_losses
from gsrain_engine.appearance.finetuning.task import TrainingTask, warning_in, with_warning
from gsrain_engine.scene.progress import Progress

from ..jobs.worker import Job, JobState
from .transfer_training_work import train_transfer

TITLE = "Train the transfer"

Losses = Mapping[str, Float64[np.ndarray, " n"]]
"""By name, with their steps as `step`; smoothed where there are many."""

_DRAWN = 400
"""Points of a curve: each is the mean of as many iterations as it takes."""


class TransferTraining:
    """One training, a `BackgroundJob`. Stopped anywhere, it leaves its folder's last checkpoint to go on from."""

    ends_with_scene = False

    def __init__(self, task: TrainingTask, files: ThreadPoolExecutor) -> None:
        """Start; `files` is where losses are read."""
        self.title = TITLE
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.error: str | None = None
        self.details: str | None = None
        self.task = task
        self.losses: Losses = {}
        self.warning: str | None = None
        """What is wrong with how it goes, as the worker says; stays when it ends."""
        self._files = files
        self._worker: Job | None = Job(TITLE, train_transfer, task)
        self._reading: Future[Losses] | None = None
        self._read_at = ""

    def poll(self, session: object) -> None:
        """Take in what the worker has said, and its losses; never waits."""
        if self.state != "running":
            return
        self._follow_losses()
        if self._worker is None:  # it is done, and its last losses have been read
            if self._reading is None:
                self._end("finished")
            return
        worker = self._worker
        worker.poll()
        said = worker.progress
        if (warning := warning_in(said.message)) is not None:  # it is shown by itself, not with each iteration
            self.warning, said = warning, said._replace(message=said.message.removesuffix(with_warning("", warning)))
        elif said.message[:1].isdigit():  # an iteration after which all is well
            self.warning = None
        self.progress = said
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            self.progress = Progress(1.0, f"Trained: {self.task.weights}", self.progress.preview)
            self._files.submit(worker.close)
            self._worker = None

    def cancel(self) -> None:
        """Stop, without waiting; what was saved last can be gone on from."""
        if self.state == "running":
            self._end("cancelled")

    def _follow_losses(self) -> None:
        if self._reading is not None and self._reading.done():
            self.losses, self._reading = self._reading.result(), None
        if self._reading is None and self.progress.message != self._read_at:
            self._read_at = self.progress.message
            self._reading = self._files.submit(_losses_of, self.task)

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._reading is not None:
            self._reading.cancel()
        if self._worker is not None:
            self._worker.cancel()
            self._files.submit(self._worker.close)
            self._worker = None


def _losses_of(task: TrainingTask) -> Losses:
    """Read the losses so far; where the file can't be read there are none."""
    try:
        rows = read_losses(task.losses)
    except OSError:
        return {}
    if not rows:
        return {}
    each = max(1, len(rows) // _DRAWN)
    whole = len(rows) // each * each
    return {name: np.array([row[name] for row in rows[:whole]]).reshape(-1, each).mean(axis=1) for name in rows[0]}

"""From a capture to a scene: start, learn, measure, write; a generator of `Progress` that may be stopped anywhere."""

import logging
import time
from collections.abc import Generator, Sequence

import numpy as np

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.progress import Progress

from .checkpoints import Checkpoint, CheckpointError, read_checkpoint, write_checkpoint
from .curves import TrainingCurves
from .held_out import Score, mean_of
from .reconstruction import MeasuredPicture, Reconstruction
from .report import write_training_report
from .run import Done, beside
from .start import StartedTraining, start_training
from .task import ReconstructionTask
from .trained_scene import scene_of
from .views import TrainingView

logger = logging.getLogger("gsrain")

_STARTED, _TRAINED = 0.04, 0.95
"""Shares of the whole work after which training begins, and is over."""
_SHOWN_EVERY_S = 2.0
_QUICK_VIEWS = 4
"""So many held-out views are looked at while training; all of them in the end."""
_LEARNED_VIEWS = 4
"""So many of the views that were learned from are measured in the end, for comparison."""
_BEFORE = "before"


def reconstruct(task: ReconstructionTask, opened: Capture | None = None) -> Generator[Progress, None, Reconstruction]:
    """Fit Gaussians to a capture (the task's, unless one is at hand) and write the scene, and the report if asked for.

    Yields:
        Progress, at least once a step. Stopped there, the last checkpoint remains.

    Raises:
        CaptureError: For a capture that can't be read, or has nothing to learn from.
        CheckpointError: When `resume` finds no checkpoint, or one of another training.
    """
    yield Progress(0.0, "Reading the capture")
    capture = task.read() if opened is None else opened
    began = time.perf_counter()
    started = yield from start_training(capture, task.settings, task.held_out(capture), task.lpips)
    learning = _Learning(task, capture, started, began)
    yield from learning.resume() if task.resume else learning.look_before()
    yield from learning.learn()
    result = yield from learning.measure()
    yield Progress(0.99, "Writing the scene")
    task.output.parent.mkdir(parents=True, exist_ok=True)
    write_scene(scene_of(started.training.model, capture), task.output)
    if task.report is not None:
        task.report.parent.mkdir(parents=True, exist_ok=True)
        write_training_report(task.report, result)
    task.checkpoint.unlink(missing_ok=True)
    yield Progress(1.0, f"{result.gaussians:,} Gaussians")
    return result


class _Learning:
    """One training from its first step to its last, with what is noted on the way."""

    def __init__(self, task: ReconstructionTask, capture: Capture, started: StartedTraining, began: float) -> None:
        self._task, self._capture, self._began = task, capture, began
        self._settings, self._training = task.settings, started.training
        self._held, self._perceived, self._own_body = started.held_out, started.perceived, started.own_body
        self._first, self._curves = 0, TrainingCurves()
        self._before: tuple[Score, ...] = ()
        self._shown_at = -np.inf

    def look_before(self) -> Generator[Progress]:
        yield Progress(_STARTED, "Measuring what it starts from")
        self._before = tuple(self._training.measure(view) for view in self._held)
        self._note(0, self._before[:_QUICK_VIEWS])

    def resume(self) -> Generator[Progress]:
        file = self._task.checkpoint
        yield Progress(_STARTED, f"Reading {file.name}")
        checkpoint = read_checkpoint(file, self._settings, self._task.fingerprint(self._capture))
        try:
            self._training.restore(checkpoint.arrays)
            self._curves = TrainingCurves.restored(checkpoint.arrays)
            self._before = _scores(self._held, checkpoint.arrays[_BEFORE])
        except KeyError as error:
            raise CheckpointError(f"{file}: holds no {error}; begin anew without --resume") from None
        self._first = checkpoint.step
        self._began -= checkpoint.seconds

    def learn(self) -> Generator[Progress]:
        settings = self._settings
        for number in range(self._first, settings.steps):
            done = self._training.step(number)
            self._curves.add(done.loss, self._training.model.count, self._seconds)
            yield self._told(done)
            if _is_due(settings.measured_every, number, settings.steps):
                yield self._look(number)
            if _is_due(settings.saved_every, number, settings.steps):
                self._save(number + 1)
                yield self._said(number, f"Saved {self._task.checkpoint.name}")

    def _look(self, number: int) -> Progress:
        """Write the scene as it is now where that is asked for, and look at some held-out views."""
        if self._task.snapshot is not None:
            write_scene(scene_of(self._training.model, self._capture), self._task.snapshot)
        if not self._held:
            return self._said(number, f"After {number + 1:,} steps: loss {self._curves.recent_loss():.4f}")
        self._note(number + 1, [self._training.measure(view) for view in self._held[:_QUICK_VIEWS]])
        told = f"Held-out views after {number + 1:,} steps: {self._curves.measured_db[-1]:.2f} dB"
        logger.info("%s, %.0f s", told, self._seconds)
        return self._said(number, told)

    def measure(self) -> Generator[Progress, None, Reconstruction]:
        """Measure all held-out views, and some that were learned from."""
        seconds = self._seconds
        learned = _spread(self._training.views, _LEARNED_VIEWS)
        chosen = [(view, True) for view in self._held] + [(view, False) for view in learned]
        pictures: list[MeasuredPicture] = []
        for view, is_held_out in chosen:
            rendered = self._training.render(view)
            score = self._training.measure(view, self._perceived, rendered)
            pictures.append(MeasuredPicture(score, rendered, view.levels[0].image, view.seen, is_held_out))
            fraction = _TRAINED + (0.98 - _TRAINED) * len(pictures) / len(chosen)
            yield Progress(fraction, f"{view.name}: {score.psnr_db:.2f} dB{'' if is_held_out else ', learned from'}")
        held = [each.score for each in pictures if each.is_held_out]
        if held:
            self._curves.measured(self._settings.steps, mean_of(held, "psnr_db") or 0.0)
        return Reconstruction(
            self._capture, self._settings, self._training.model.count, seconds, self._curves, self._before,
            tuple(pictures), dict(self._training.seconds_by_stage), self._own_body,
        )  # fmt: skip

    @property
    def _seconds(self) -> float:
        return time.perf_counter() - self._began

    def _told(self, done: Done) -> Progress:
        now, preview = time.perf_counter(), None
        if now - self._shown_at > _SHOWN_EVERY_S:
            self._shown_at, preview = now, beside(done.shown, done.truth)
        message = f"Step {done.step + 1:,} of {self._settings.steps:,}: loss {self._curves.recent_loss():.4f}, "
        message += f"{self._training.model.count:,} Gaussians"
        return self._said(done.step, f"{message} ({done.change})" if done.change else message, preview)

    def _said(self, number: int, message: str, preview: np.ndarray | None = None) -> Progress:
        done = (number + 1) / self._settings.steps
        return Progress(_STARTED + (_TRAINED - _STARTED) * done, message, preview)

    def _note(self, steps: int, scores: Sequence[Score]) -> None:
        mean = mean_of(scores, "psnr_db")
        if mean is not None:
            self._curves.measured(steps, mean)

    def _save(self, steps: int) -> None:
        file = self._task.checkpoint
        file.parent.mkdir(parents=True, exist_ok=True)
        before = np.array([[each.psnr_db, each.ssim, each.psnr_exposed_db] for each in self._before]).reshape(-1, 3)
        arrays = self._training.state() | self._curves.state() | {_BEFORE: before}
        checkpoint = Checkpoint(steps, self._seconds, arrays)
        write_checkpoint(file, checkpoint, self._settings, self._task.fingerprint(self._capture))


def _scores(views: Sequence[TrainingView], figures: np.ndarray) -> tuple[Score, ...]:
    return tuple(Score(view.name, *row) for view, row in zip(views, figures.tolist(), strict=True))


def _is_due(every: int, number: int, steps: int) -> bool:
    """Whether something is due after a step, counted from 0; the last one is followed by the end anyway."""
    return every > 0 and (number + 1) % every == 0 and number + 1 < steps


def _spread(views: Sequence[TrainingView], count: int) -> list[TrainingView]:
    chosen = np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int))
    return [views[index] for index in chosen]

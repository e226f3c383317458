"""Jobs of the `jobs` extra: fine-tune the transfer, recolor, reconstruct; and the check for torch."""

from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from ...appearance.finetune.loss_log import read_losses
from ...appearance.finetune.settings import FinetuneTask, warning_in, with_warning
from ...datasets.image_override import with_images
from ...datasets.open_capture import open_capture
from ...evaluation.report import write_report
from ...recolor.recolor import RecolorOptions, recolor_to_capture
from ...recolor.result import read_recolored, with_colors, write_recolored
from ...scene.files import SceneFormatError
from ...scene.formats.scene_files import read_scene
from ...scene.formats.scene_folder import FileCache
from ...scene.progress import Progress
from ...scene.scene import Scene
from ...training.settings import TrainingSettings
from ...training.task import ReconstructionTask
from ...trusted_code import expect_trusted
from ..viewport_state import PendingScene
from .job import WorkerCall, new_report, write_copy
from .process import JobState, WorkerProcess

if TYPE_CHECKING:
    from ...appearance.finetune.settings import FinetuneResult

TRANSFER_TRAINING_TITLE = "Train the transfer"
Losses = Mapping[str, Float64[np.ndarray, " n"]]
"""Arrays by name, with iterations as `step`; smoothed if there are many."""

_DRAWN = 400  # maximum number of points of a curve; each is the mean of several iterations


class FinetuneJob:
    """One training, a `BackgroundJob`. After cancelling, it can resume from the last checkpoint in its folder."""

    ends_with_scene = False

    def __init__(self, task: FinetuneTask, files: ThreadPoolExecutor) -> None:
        """Start; `files` is the thread that reads losses."""
        self.title = TRANSFER_TRAINING_TITLE
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.error: str | None = None
        self.details: str | None = None
        self.task = task
        self.losses: Losses = {}
        self.warning: str | None = None
        """The worker's warning about the training; stays after the end."""
        self._files = files
        self._worker: WorkerProcess | None = WorkerProcess(TRANSFER_TRAINING_TITLE, train_transfer, task)
        self._reading: Future[Losses] | None = None
        self._read_at = ""

    def poll(self, session: object) -> None:
        """Process the worker's messages and losses; never blocks."""
        if self.state != "running":
            return
        self._follow_losses()
        if self._worker is None:  # the worker is done; wait for its last losses
            if self._reading is None:
                self._end("finished")
            return
        worker = self._worker
        worker.poll()
        said = worker.progress
        if (warning := warning_in(said.message)) is not None:  # shown separately, not with each iteration
            self.warning, said = warning, said._replace(message=said.message.removesuffix(with_warning("", warning)))
        elif said.message[:1].isdigit():  # an iteration without a warning
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
        """Stop without waiting; the last checkpoint stays usable."""
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


def _losses_of(task: FinetuneTask) -> Losses:
    """Read the losses so far; empty if the file can't be read."""
    try:
        rows = read_losses(task.losses)
    except OSError:
        return {}
    if not rows:
        return {}
    each = max(1, len(rows) // _DRAWN)
    whole = len(rows) // each * each
    return {name: np.array([row[name] for row in rows[:whole]]).reshape(-1, each).mean(axis=1) for name in rows[0]}


# Fine-tuning worker and command, with LPIPS if weights are available


def train_transfer(task: "FinetuneTask") -> "Generator[Progress, None, FinetuneResult]":
    """Fine-tune. Yields and raises as `finetune` does, and ValueError if torch is missing."""
    require_torch("training the transfer", HOW_TO_GET_DIFFUSION)
    expect_trusted(task.code)
    from ...appearance.finetune.run import chosen_device, finetune
    from ...evaluation.lpips import lpips_loss

    settings = task.settings
    wanted = settings.losses.cycle_lpips or settings.losses.identity_lpips
    file = None if settings.lpips is None else Path(settings.lpips)
    perceptual = lpips_loss(file, chosen_device(settings.device)) if wanted else None
    return (yield from finetune(task, perceptual))


# Job "Recolor": solve for wet colors so that the scene matches given images

_COLORS = "colors.npz"


class RecolorJobKind:
    """One recoloring of a scene to images, a `JobKind`."""

    preparing = "Saving the scene for the worker"

    def __init__(
        self,
        scene: Scene,
        known: FileCache,
        capture: Path,
        images: Path | None = None,
        options: RecolorOptions | None = None,
        *,
        allow_outside: bool = False,
    ) -> None:
        """`capture` provides the cameras, and the images unless the folder `images` has others under the same names."""
        pictures = images or capture
        self.title = f"Recolour to {pictures.name}"
        self.report: Path | None = new_report(f"{scene.name} to {pictures.name}")
        self._scene, self._known = scene, known
        self._capture, self._images, self._options = capture, images, options or RecolorOptions()
        self._allow_outside = allow_outside

    def prepare(self, folder: Path) -> WorkerCall:
        copy = write_copy(self._scene, folder, self._known)
        arguments = copy, self._capture, self._images, self._options, folder / _COLORS, self.report, self._allow_outside
        return WorkerCall(recolor_scene_copy, arguments)

    def snapshot(self, folder: Path) -> Scene | None:
        return None

    def load(self, folder: Path) -> Scene:
        return with_colors(self._scene, read_recolored(folder / _COLORS))

    def staged(self, scene: Scene) -> PendingScene:
        """Stage only the wet colors."""
        return PendingScene(self.title, scene, only_wet_colors=True)


def recolor_scene_copy(
    copy: Path,
    capture: Path,
    images: Path | None,
    options: RecolorOptions,
    output: Path,
    report: Path | None,
    allow_outside: bool = False,
) -> Iterator[Progress]:
    """Worker: solve for a saved scene's wet colors and write them."""
    yield Progress(0.0, "Reading the scene")
    scene, pictures = read_scene(copy), open_capture(capture, allow_outside=allow_outside)
    if images is not None:
        pictures = with_images(pictures, images)
    run = yield from recolor_to_capture(scene, pictures, options)
    if report is not None:
        write_report(report, run.report)
    write_recolored(output, {each.key: each.wet_sh for each in run.scene.members if each.wet_sh is not None})


# Job "Reconstruct": Gaussians from a capture, with snapshots in the viewport

_SCENE, _SNAPSHOT = "scene", "snapshot"


class ReconstructionJobKind:
    """One reconstruction of a capture, a `JobKind`."""

    preparing = "Starting"

    def __init__(self, capture: Path, settings: TrainingSettings, *, allow_outside: bool = False) -> None:
        self.title = f"Reconstruct {capture.name}"
        self.report: Path | None = new_report(capture.name)
        self._capture, self._settings, self._allow_outside = capture, settings, allow_outside
        self._seen_ns = 0

    def prepare(self, folder: Path) -> WorkerCall:
        task = ReconstructionTask(
            capture=self._capture, output=folder / _SCENE, settings=self._settings, report=self.report,
            snapshot=folder / _SNAPSHOT, allow_outside=self._allow_outside,
        )  # fmt: skip
        return WorkerCall(reconstruct_capture, (task,))

    def snapshot(self, folder: Path) -> Scene | None:
        try:
            written_ns = (folder / _SNAPSHOT / "scene.json").stat().st_mtime_ns
            if written_ns == self._seen_ns:
                return None
            scene = read_scene(folder / _SNAPSHOT)
        except (OSError, SceneFormatError):
            return None  # not there yet, or being replaced: a later one follows
        self._seen_ns = written_ns
        return scene

    def load(self, folder: Path) -> Scene:
        return read_scene(folder / _SCENE)

    def staged(self, scene: Scene) -> PendingScene:
        """Replace the present scene, as an undo step."""
        return PendingScene(self.title, scene, is_whole=True)


def reconstruct_capture(task: ReconstructionTask) -> Iterator[Progress]:
    """Worker: reconstruct a capture, with torch."""
    require_torch("reconstructing")
    from ...training.train import reconstruct

    yield from reconstruct(task)


# Check for torch without importing it

HOW_TO_GET_TORCH = "pip install 'gsrain[jobs]'"
HOW_TO_GET_DIFFUSION = "pip install 'gsrain[diffusion]'"
"""Command that installs torch and the dependencies of diffusion models."""


@cache
def has_torch() -> bool:
    return find_spec("torch") is not None


def require_torch(what: str, how: str = HOW_TO_GET_TORCH) -> None:
    """Raise ValueError with the install command if torch is missing; `what` is the feature that needs it."""
    if not has_torch():
        raise ValueError(f"{what} needs torch, which is not installed: {how}")

"""Fine-tuning of CycleGAN-Turbo: start or resume, train, sample and save, as a generator that may be stopped anywhere.

The caller provides LPIPS.
"""

import logging
import os
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from ...render.images import write_png
from ...scene.files import hold_for_writing
from ...scene.progress import Progress
from ..cyclegan_turbo.lora import LoraRanks
from ..cyclegan_turbo.model import build_random_model, tiny
from ..cyclegan_turbo.pretrained import open_model
from ..cyclegan_turbo.weights import save_weights
from .checkpoint import (
    FinetuneCheckpoint,
    FinetuningCheckpointError,
    read_finetune_checkpoint,
    write_finetune_checkpoint,
)
from .dataset import DatasetImage, ImageSplit, UnpairedImages, open_images
from .discriminator import ClipFeatures, Discriminator
from .loss_log import CollapseMonitor, LossLog, color_distance, distance_sample, read_losses
from .settings import FinetuningSettings, write_finetuning
from .step import FinetuneStepResult, FinetuneTrainer, PairSampler, Perceptual, fingerprint
from .task import FinetuneResult, FinetuneTask, with_warning

torch: Any = import_module("torch")
logger = logging.getLogger("gsrain")
_STARTED, _TRAINED = 0.02, 0.99  # progress at which training begins and ends
_PREVIEW_INTERVAL_S = 2.0
_FLUSHED_EVERY_S = 1.0
_RECENT = 100  # number of last iterations that the result's losses are averaged over


def finetune(task: FinetuneTask, perceptual: Perceptual | None = None) -> Generator[Progress, None, FinetuneResult]:
    """Fine-tune, and write weights, checkpoint, losses, samples and settings into the task's folder.

    Args:
        task: Settings and folder.
        perceptual: LPIPS on the task's device; None trains without its losses and logs a warning.

    Yields:
        Progress, at least once per iteration, sometimes with a preview. If stopped, the last checkpoint remains.

    Raises:
        CaptureError: For unreadable images.
        FinetuningCheckpointError: If `resume` finds no checkpoint, or one of another training.
        FileNotFoundError: If SD-Turbo or CLIP is missing, with download instructions.
        ValueError: If files don't fit each other, or the folder holds another training.
        DivergedError: If the training diverged.
        MemoryError: If the device has too little memory.
        PathInUseError: If another process writes into the folder.
    """
    with hold_for_writing(task.output):
        return (yield from _finetuned(task, perceptual))


def _finetuned(task: FinetuneTask, perceptual: Perceptual | None) -> Generator[Progress, None, FinetuneResult]:
    yield Progress(0.0, "Looking through the pictures")
    split = open_images(task.settings.pictures, task.images_cache)
    for line in (*split.counted(), *split.problems):
        logger.info("%s", line)
    if task.checkpoint.is_file() and not task.resume:
        raise ValueError(f"{task.output}: holds a training already; resume it, or choose another folder")
    task.samples.mkdir(parents=True, exist_ok=True)
    yield Progress(0.0, "Building the model")
    with _repeatable():
        training = start_finetuning(task.settings, split.train, perceptual)
        learning = _FinetuneLoop(task, split, training, perceptual is not None)
        yield from learning.learn()
    yield Progress(1.0, "Trained")
    return learning.result()


class _FinetuneLoop:
    """One training with its log and monitor."""

    def __init__(self, task: FinetuneTask, split: ImageSplit, training: FinetuneTrainer, perceptual: bool) -> None:
        self._task, self._split, self._training, self._perceptual = task, split, training, perceptual
        self._settings = task.settings
        self._began = time.perf_counter()
        self._first = 0
        if task.resume:
            self._go_on()
        self._shown = choose_samples(split.test.source or split.train.source, task.settings.samples)
        self._warning: CollapseMonitor = start_warning(task.settings, split.train)
        self._warned: str | None = None
        self._previewed_at = self._flushed_at = -np.inf
        self._grid: Path = task.samples
        write_finetuning(task.config, task.settings)

    def learn(self) -> Generator[Progress]:
        settings = self._settings
        with LossLog(self._task.output, self._first) as log:
            for row in log.kept[-_RECENT:]:
                self._warning.add(row)
            for number in range(self._first, settings.steps):
                done = self._iterate(number)
                self._warning.add(done.losses)
                log.add(number + 1, done.losses)
                yield self._progress_at(number, self._line(number, done), self._preview(done))
                if _is_due(settings.sampled_every, number, settings.steps):
                    grid = self._sample(number)
                    log.show(number + 1, grid)
                    yield self._progress_at(number, f"Samples after {number + 1:,} iterations", grid)
                if _is_due(settings.saved_every, number, settings.steps):
                    log.flush()  # first, so that a resumed training finds the losses before its checkpoint
                    self._save(number + 1)
                    yield self._progress_at(number, f"Saved {self._task.checkpoint.name}")
                if (now := time.perf_counter()) - self._flushed_at > _FLUSHED_EVERY_S:
                    log.flush()
                    self._flushed_at = now

    def _iterate(self, number: int) -> FinetuneStepResult:
        try:
            return self._training.iterate(number)
        except RuntimeError as error:
            if "out of memory" not in str(error):
                raise
            less = "" if self._settings.gradient_checkpointing else "gradient_checkpointing: true and "
            raise MemoryError(
                f"too little memory for this training; {less}smaller images need less ({error})"
            ) from None

    def result(self) -> FinetuneResult:
        recent = read_losses(self._task.losses)[-_RECENT:]
        names = [name for name in recent[-1] if name != "step"]
        verdict = self._warning.verdict(self._settings.steps)
        return FinetuneResult(
            weights=self._task.weights,
            grid=self._grid,
            steps=self._settings.steps,
            seconds=self._seconds,
            losses={name: sum(row[name] for row in recent) / len(recent) for name in names},
            share=verdict.share,
            warning=verdict.warning,
            perceptual=self._perceptual,
            table=self._split.table,
            problems=self._split.problems,
        )

    def _go_on(self) -> None:
        file = self._task.checkpoint
        checkpoint = read_finetune_checkpoint(file, self._settings, self._pictures, self._perceptual)
        if checkpoint.step >= self._settings.steps:
            raise FinetuningCheckpointError(f"{file}: {checkpoint.step:,} iterations are done; ask for more with steps")
        try:
            self._training.restore(checkpoint.tensors)
        except (KeyError, RuntimeError) as error:
            raise FinetuningCheckpointError(f"{file}: doesn't fit the model: {error}") from None
        self._first = checkpoint.step
        self._began -= checkpoint.seconds

    def _save(self, step: int) -> None:
        checkpoint = FinetuneCheckpoint(step, self._seconds, self._training.state(), self._perceptual)
        write_finetune_checkpoint(self._task.checkpoint, checkpoint, self._settings, self._pictures)
        save_weights(self._training.model, self._task.weights)

    def _sample(self, number: int) -> UInt8[np.ndarray, "h w 3"]:
        grid = sample_grid(self._training, self._shown)
        self._grid = self._task.samples / f"step_{number + 1:06d}.png"
        write_png(self._grid, grid)
        return grid

    def _line(self, number: int, done: FinetuneStepResult) -> str:
        """Return the progress message of an iteration; a new warning is also logged once."""
        verdict = self._warning.verdict(number + 1)
        if verdict.warning is not None and self._warned is None:
            logger.warning("%s", verdict.warning)
        self._warned = verdict.warning
        losses = done.losses
        cycle, deceit = (losses[f"{kind}_clear"] + losses[f"{kind}_rainy"] for kind in ("cycle", "gan"))
        line = (
            f"{number + 1:,} of {self._settings.steps:,}: cycle {cycle:.3f}, GAN {deceit:.2f}, "
            f"change {verdict.share:.0%} of the distance between the looks"
        )
        return with_warning(line, verdict.warning)

    def _preview(self, done: FinetuneStepResult) -> UInt8[np.ndarray, "h w 3"] | None:
        now = time.perf_counter()
        if now - self._previewed_at < _PREVIEW_INTERVAL_S:
            return None
        self._previewed_at = now
        return join_horizontally(done.clear, done.translated)

    def _progress_at(self, number: int, message: str, preview: UInt8[np.ndarray, "h w 3"] | None = None) -> Progress:
        share = (number + 1) / self._settings.steps
        return Progress(_STARTED + (_TRAINED - _STARTED) * share, message, preview)

    @property
    def _seconds(self) -> float:
        return time.perf_counter() - self._began

    @property
    def _pictures(self) -> str:
        return fingerprint(self._split.train)


def _is_due(every: int, number: int, steps: int) -> bool:
    return number + 1 == steps or (every > 0 and (number + 1) % every == 0)


@contextmanager
def _repeatable() -> Generator[None]:
    """Use deterministic algorithms on CUDA; on the CPU torch's are deterministic anyway."""
    if not torch.cuda.is_available():
        yield
        return
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS reads it at its first product
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before)


# Setup: images, model, discriminators and monitor

_TINY_CHANNELS = 32
_DISTANCE_PX = 64


def chosen_device(name: str) -> str:
    """Resolve a device setting. Raises ValueError if CUDA is requested but not available."""
    has_cuda = bool(torch.cuda.is_available())
    if name == "cuda" and not has_cuda:
        raise ValueError("device cuda: no CUDA device is there; take cpu or auto")
    return "cuda" if name != "cpu" and has_cuda else "cpu"


def start_finetuning(
    settings: FinetuningSettings, pictures: UnpairedImages, perceptual: Perceptual | None = None
) -> FinetuneTrainer:
    """Build the trainer; new parts are initialized from the seed.

    Raises:
        FileNotFoundError: If SD-Turbo, CLIP or the initial weights are missing, with download instructions.
        ValueError: If one of them has another architecture, or CUDA is not available.
    """
    device = chosen_device(settings.device)
    guided = settings.pictures.guide != "none"
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        model = _model(settings, guided).to(device)
        features, channels = _features(settings), _TINY_CHANNELS if settings.architecture == "tiny" else 256
        judges = [Discriminator(features.to(device), settings.augmentations, channels).to(device) for _ in range(2)]
    if perceptual is None and (settings.losses.cycle_lpips or settings.losses.identity_lpips):
        logger.warning(
            "LPIPS has no weights here: its losses, most of the recipe, are OFF, and what comes out will be blurred; "
            "`gsrain doctor` says how to get them"
        )
    order = PairSampler(pictures, settings.seed, guided, device)
    return FinetuneTrainer(model, (judges[0], judges[1]), order, settings, perceptual)


def start_warning(settings: FinetuningSettings, pictures: UnpairedImages) -> CollapseMonitor:
    """Measure the distance between the two looks and make the collapse monitor."""
    distance = color_distance(_small(pictures.source), _small(pictures.target))
    return CollapseMonitor(distance, settings.losses.gan, settings.warned_after)


def _model(settings: FinetuningSettings, guided: bool) -> Any:
    ranks = LoraRanks(settings.lora.unet, settings.lora.vae)
    if settings.architecture == "tiny" and settings.start is None:
        return build_random_model(tiny(), normals=guided, lora=ranks, seed=settings.seed)
    start, base = (None if each is None else Path(each) for each in (settings.start, settings.base))
    model = open_model(start, base, normals=guided, lora=ranks)
    if (found := model.architecture.name) != settings.architecture:
        raise ValueError(f"{start}: is of architecture {found}, the settings say {settings.architecture}")
    return model


def _features(settings: FinetuningSettings) -> ClipFeatures:
    if settings.architecture == "tiny" and settings.clip is None:
        return ClipFeatures.tiny()
    return ClipFeatures.read(None if settings.clip is None else Path(settings.clip))


def _small(pictures: tuple[DatasetImage, ...]) -> Iterator[Float32[np.ndarray, "_ _ 3"]]:
    """Some of the images, subsampled, since only their colors count."""
    for i in distance_sample(pictures):
        image = pictures[i].read()[0]
        step = max(1, max(image.shape) // _DISTANCE_PX)
        yield image[::step, ::step]


# Sample grid: fixed clear images, translated and back

Tensor = Any
_GAP_PX = 4


def choose_samples(pictures: Sequence[DatasetImage], count: int) -> tuple[DatasetImage, ...]:
    places = np.unique(np.linspace(0, len(pictures) - 1, min(count, len(pictures))).round().astype(int))
    return tuple(pictures[int(i)] for i in places)


def sample_grid(training: FinetuneTrainer, pictures: tuple[DatasetImage, ...]) -> UInt8[np.ndarray, "h w 3"]:
    """One row per image: clear, rainy, and clear again."""
    rows = [_row(training, each) for each in pictures]
    gap = np.full((_GAP_PX, rows[0].shape[1], 3), 255, np.uint8)
    return np.concatenate([part for row in rows for part in (row, gap)][:-1])


def join_horizontally(*pictures: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    """Join (1, 3, h, w) images in -1..1 side by side."""
    shown = [_pixels(each) for each in pictures]
    gap = np.full((shown[0].shape[0], _GAP_PX, 3), 255, np.uint8)
    return np.concatenate([part for each in shown for part in (each, gap)][:-1], axis=1)


def _row(training: FinetuneTrainer, picture: DatasetImage) -> UInt8[np.ndarray, "h w 3"]:
    clear, guide = training.order.read(picture)
    rainy = training.translated(clear, guide, "a2b")
    return join_horizontally(clear, rainy, training.translated(rainy, guide, "b2a"))


def _pixels(picture: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    scaled = (picture[0].detach().float().permute(1, 2, 0) * 127.5 + 128).clamp(0, 255)
    return scaled.to(torch.uint8).cpu().numpy()

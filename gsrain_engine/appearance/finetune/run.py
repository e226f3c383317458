"""Fine-tuning of CycleGAN-Turbo: start or resume, train, sample and save, as a generator that may be stopped anywhere.

The caller provides LPIPS.
"""

import logging
import os
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float32, UInt8

from ...render.images import write_png
from ...safe_io.errors import convert_checked
from ...safe_io.files import hold_for_writing
from ...safe_io.limits import check_file
from ...scene.progress import Progress
from ...training_run import CheckpointError, CheckpointFormat, CheckpointHeader, PeriodicAction, TrainingRun
from ..base import TrainingRecord
from ..cyclegan_turbo.lora import LoraRanks
from ..cyclegan_turbo.model import build_random_model, tiny
from ..cyclegan_turbo.pretrained import open_model
from ..cyclegan_turbo.translator import chosen_device
from ..cyclegan_turbo.weights import save_weights
from .dataset import DatasetImage, ImageSplit, UnpairedImages, identity_of, open_images
from .discriminator import ClipFeatures, Discriminator
from .loss_log import CollapseMonitor, LossLog, color_distance, distance_sample, read_losses
from .settings import FinetuneResult, FinetuneTask, FinetuningSettings
from .step import FinetuneStepResult, FinetuneTrainer, PairSampler, Perceptual, fingerprint

safetensors: Any = import_module("safetensors")
safetensors_torch: Any = import_module("safetensors.torch")
torch: Any = import_module("torch")
logger = logging.getLogger("gsrain")
_STARTED, _TRAINED = 0.02, 0.99  # progress at which training begins and ends
_EARLIER_POINTS = 400  # maximum number of iterations before a resumption whose losses are reported once more
_RECENT = 100  # number of last iterations that the result's losses are averaged over


def finetune(task: FinetuneTask, perceptual: Perceptual | None = None) -> Generator[Progress, None, FinetuneResult]:
    """Fine-tune, and write weights, checkpoint, losses, samples and settings into the task's folder.

    `perceptual` is LPIPS on the task's device; None trains without its losses and logs a warning. Yields progress at
    least once per iteration, sometimes with a preview. If stopped, the last checkpoint remains.

    Raises:
        CaptureError: For unreadable images.
        CheckpointError: If `resume` finds no checkpoint, or one of another training.
        FileNotFoundError: If SD-Turbo or CLIP is missing, with download instructions.
        ValueError: If files don't fit each other, or the folder holds another training.
        DivergedError, MemoryError: If the training diverged, or the device has too little memory.
        PathInUseError: If another process writes into the folder.
    """
    with hold_for_writing(task.output):
        yield Progress(0.0, "Looking through the pictures")
        split = open_images(task.settings.pictures, task.images_cache)
        for path, look, count, tested in split.table:
            logger.info("%s: %d %s pictures, %d of them for testing", path, count, look, tested)
        for problem in split.problems:
            logger.info("%s", problem)
        if task.checkpoint.is_file() and not task.resume:
            raise ValueError(f"{task.output}: holds a training already; resume it, or choose another folder")
        task.samples.mkdir(parents=True, exist_ok=True)
        yield Progress(0.0, "Building the model")
        with _repeatable():
            training = start_finetuning(task.settings, split.train, perceptual)
            loop = _FinetuneLoop(task, split, training, perceptual is not None)
            yield from loop.train()
        yield Progress(1.0, "Trained", warning=loop.run.warning)
        return loop.result()


class FinetuneHeader(CheckpointHeader, frozen=True, kw_only=True):
    """Header of a fine-tuning's checkpoint."""

    perceptual: bool
    """True if LPIPS is one of the losses."""
    pictures: str
    """Text that identifies the sets of images; their order and all random numbers follow from the step."""
    settings: FinetuningSettings


_HEAD = "gsrain"  # key of the header in the file's metadata


def _save(file: Path, header: bytes, arrays: Mapping[str, Any]) -> None:
    safetensors_torch.save_file(dict(arrays), str(file), metadata={_HEAD: header.decode()})


def _load(file: Path) -> tuple[bytes, dict[str, Any]]:
    check_file(file)
    try:
        with safetensors.safe_open(str(file), "pt") as opened:
            header: str = (opened.metadata() or {})[_HEAD]
            return header.encode(), {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    except safetensors.SafetensorError as error:
        raise ValueError(error) from None


_FREE = frozenset(
    {"steps", "samples", "sampled_every", "saved_every", "warned_after", "gradient_checkpointing", "device", "base",
     "clip", "lpips", "start"}
)  # fmt: skip
CHECKPOINTS: CheckpointFormat[FinetuneHeader] = CheckpointFormat(_save, _load, _FREE)
"""Files of safetensors."""


class _FinetuneLoop:
    """One training with its log and monitor."""

    def __init__(self, task: FinetuneTask, split: ImageSplit, training: FinetuneTrainer, perceptual: bool) -> None:
        self._task, self._split, self._training, self._perceptual = task, split, training, perceptual
        self._settings = task.settings
        self.run = TrainingRun(task.settings.steps, (_STARTED, _TRAINED))
        if task.resume:
            checkpoint = CHECKPOINTS.resume(task.checkpoint, self._header(0), training.restore)
            if checkpoint.step >= task.settings.steps:
                raise CheckpointError(
                    f"{task.checkpoint}: {checkpoint.step:,} iterations are done; ask for more with steps"
                )
            self.run.continue_from(checkpoint)
        test_images = split.test.source or split.train.source
        self._sample_images = [test_images[i] for i in distance_sample(test_images, task.settings.samples)]
        distance = color_distance(_small(split.train.source), _small(split.train.target))
        self._monitor = CollapseMonitor(distance, task.settings.losses.gan, task.settings.warned_after)
        self._grid: Path = task.samples
        task.config.write_bytes(msgspec.yaml.encode(task.settings))

    def train(self) -> Generator[Progress]:
        settings = self._settings
        with LossLog(self._task.output, self.run.first) as log:
            for row in log.earlier_rows[-_RECENT:]:
                self._monitor.add(row)
            for row in log.earlier_rows[:: len(log.earlier_rows) // _EARLIER_POINTS + 1]:
                yield Progress(_STARTED, "Reading the losses so far", metrics=row)
            actions = (
                PeriodicAction(settings.sampled_every, partial(self._sample, log), at_end=True),
                PeriodicAction(settings.saved_every, partial(self._save, log), at_end=True),
            )
            yield from self.run.train(partial(self._step, log), actions)

    def _step(self, log: LossLog, number: int) -> Progress:
        done = self._iterate(number)
        losses = done.losses
        self._monitor.add(losses)
        log.add(number + 1, losses)
        self.run.warn(self._monitor.warning(number + 1))
        cycle, gan = (losses[f"{kind}_clear"] + losses[f"{kind}_rainy"] for kind in ("cycle", "gan"))
        message = (
            f"{number + 1:,} of {self._settings.steps:,}: cycle {cycle:.3f}, GAN {gan:.2f}, "
            f"change {self._monitor.share:.0%} of the distance between the looks"
        )
        preview = join_horizontally(done.clear, done.translated) if self.run.preview_is_due() else None
        return self.run.progress(number + 1, message, preview, losses)

    def _sample(self, log: LossLog, steps: int) -> Progress:
        grid = sample_grid(self._training, self._sample_images)
        self._grid = self._task.samples / f"step_{steps:06d}.png"
        write_png(self._grid, grid)
        log.show(steps, grid)
        return self.run.progress(steps, f"Samples after {steps:,} iterations", grid)

    def _save(self, log: LossLog, steps: int) -> Progress:
        log.flush()  # first, so that a resumed training finds the losses before its checkpoint
        CHECKPOINTS.write(self._task.checkpoint, self._header(steps), self._training.state())
        save_weights(self._training.model, self._task.weights, self._record(steps))
        return self.run.progress(steps, f"Saved {self._task.checkpoint.name}")

    def _record(self, steps: int) -> TrainingRecord:
        pictures = self._settings.pictures
        normals = "depth" if pictures.normals == "none" else pictures.normals
        return convert_checked(
            {
                "conditioning": pictures.guide, "normals": "none" if pictures.guide == "none" else normals,
                "framing": pictures.framing, "width_px": pictures.width_px, "height_px": pictures.height_px,
                "seed": self._settings.seed, "steps": steps, "held_out": identity_of(self._split.test),
                "base": self._training.model.base,
            },
            TrainingRecord,
        )  # fmt: skip

    def _header(self, steps: int) -> FinetuneHeader:
        return FinetuneHeader(
            step=steps, seconds=self.run.seconds, perceptual=self._perceptual,
            pictures=fingerprint(self._split.train), settings=self._settings,
        )  # fmt: skip

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
        return FinetuneResult(
            weights=self._task.weights, grid=self._grid, steps=self._settings.steps, seconds=self.run.seconds,
            losses={name: sum(row[name] for row in recent) / len(recent) for name in names},
            share=self._monitor.share, warning=self._monitor.warning(self._settings.steps), perceptual=self._perceptual,
            table=self._split.table, problems=self._split.problems,
        )  # fmt: skip


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


# Setup: images, model and discriminators

_DISTANCE_PX = 64


def start_finetuning(
    settings: FinetuningSettings, pictures: UnpairedImages, perceptual: Perceptual | None = None
) -> FinetuneTrainer:
    """Build the trainer; new parts are initialized from the seed.

    Raises FileNotFoundError if SD-Turbo, CLIP or the initial weights are missing, with download instructions, and
    ValueError if one of them has another architecture, or CUDA is not available.
    """
    device = chosen_device(settings.device)
    guided = settings.pictures.guide != "none"
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        model = model_to_train(settings, guided).to(device)
        is_tiny, clip = settings.architecture == "tiny", None if settings.clip is None else Path(settings.clip)
        features = ClipFeatures.tiny() if is_tiny and clip is None else ClipFeatures.read(clip)
        channels = 32 if is_tiny else 256
        judges = [Discriminator(features.to(device), settings.augmentations, channels).to(device) for _ in range(2)]
    if perceptual is None and (settings.losses.cycle_lpips or settings.losses.identity_lpips):
        logger.warning(
            "LPIPS has no weights here: its losses, most of the recipe, are OFF, and what comes out will be blurred; "
            "name a file of VGG16's by --lpips or GSRAIN_LPIPS_WEIGHTS (`gsrain doctor` says how to get it)"
        )
    order = PairSampler(pictures, settings.seed, guided, device)
    return FinetuneTrainer(model, (judges[0], judges[1]), order, settings, perceptual)


def model_to_train(settings: FinetuningSettings, guided: bool) -> Any:
    """Open or build the model that settings name; `guided` ones take normals."""
    ranks = LoraRanks(settings.lora.unet, settings.lora.vae)
    if settings.architecture == "tiny" and settings.start is None:
        return build_random_model(tiny(), normals=guided, lora=ranks, seed=settings.seed)
    start, base = (None if each is None else Path(each) for each in (settings.start, settings.base))
    model = open_model(start, base, normals=guided, lora=ranks)
    if (found := model.architecture.name) != settings.architecture:
        raise ValueError(f"{start}: is of architecture {found}, the settings say {settings.architecture}")
    return model


def _small(pictures: tuple[DatasetImage, ...]) -> Iterator[Float32[np.ndarray, "_ _ 3"]]:
    """Some of the images, subsampled, since only their colors count."""
    for i in distance_sample(pictures):
        image = pictures[i].read()[0]
        step = max(1, max(image.shape) // _DISTANCE_PX)
        yield image[::step, ::step]


# Sample grid: fixed clear images, translated and back

Tensor = Any
_GAP_PX = 4


def sample_grid(training: FinetuneTrainer, pictures: Sequence[DatasetImage]) -> UInt8[np.ndarray, "h w 3"]:
    """One row per image: clear, rainy, and clear once more."""
    rows: list[UInt8[np.ndarray, "_ _ 3"]] = []
    for picture in pictures:
        clear, guide = training.order.read(picture)
        rainy = training.translated(clear, guide, "a2b")
        rows.append(join_horizontally(clear, rainy, training.translated(rainy, guide, "b2a")))
    return _joined(rows, axis=0)


def join_horizontally(*pictures: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    """Join (1, 3, h, w) images in -1..1."""
    scaled = [(each[0].detach().float().permute(1, 2, 0) * 127.5 + 128).clamp(0, 255) for each in pictures]
    return _joined([each.to(torch.uint8).cpu().numpy() for each in scaled], axis=1)


def _joined(images: Sequence[UInt8[np.ndarray, "_ _ 3"]], axis: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """Join images with a white gap between them."""
    shape = list(images[0].shape)
    shape[axis] = _GAP_PX
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for each in images for part in (each, gap)][:-1], axis=axis)

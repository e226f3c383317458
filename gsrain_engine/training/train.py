"""Reconstruction of a scene from a capture: a generator of `Progress` that may be stopped at any step."""

import logging
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt8

from ..datasets.capture import Capture, CaptureError, CaptureFrame
from ..datasets.depth_maps import DepthPriors, depth_priors
from ..datasets.masks import moving_boxes, static_mask
from ..evaluation.image_metrics import ImageDistance, compare_images
from ..evaluation.lpips import Lpips
from ..evaluation.lpips_weights import find_lpips_weights, read_lpips_weights
from ..render.gsplat_build import GsplatBuildError, build_gsplat
from ..report.charts import ImageComparison, comparison_sheet
from ..report.page import ReportCurve, RunReport, write_report
from ..report.result import RunResult
from ..report.table import Table, columns
from ..safe_io.numpy_files import read_archive
from ..scene.formats.scene_files import write_scene
from ..scene.gaussians import Gaussians
from ..scene.progress import Progress, subprogress
from ..training_run import CheckpointFormat, CheckpointHeader, PeriodicAction, TrainingRun
from .data import ReconstructionTask, TrainingView, training_views
from .ego_mask import mask_ego_vehicle
from .evaluation import RenderScore, TrainingCurves, mean_of
from .free_space import FreeSpaceCarving
from .init import actor_layers, initial_gaussians, initial_sky
from .mcmc import MCMCSettings, MCMCStrategy
from .model import SplatModel, scene_of
from .parameters import SplatParameters
from .schedule import TrainingSchedule, camera_extent
from .settings import TrainingSettings
from .step import Trainer, comparison_image
from .strategy import DefaultStrategy, DefaultStrategySettings, Strategy
from .surfels import camera_trajectory

torch: Any = import_module("torch")
logger = logging.getLogger("gsrain")
_STARTED, _TRAINED = 0.04, 0.95  # shares of the total progress at which training starts and ends
_QUICK_VIEWS = 4  # number of held-out views evaluated during training; all of them at the end
_LEARNED_VIEWS = 4  # number of training views evaluated at the end, for comparison

# Ego mask report


@dataclass(frozen=True, slots=True)
class EgoMaskReport:
    """The search for the vehicle's own body in the images."""

    searched: bool
    reason: str
    shares: Mapping[str, float] = field(default_factory=dict[str, float])
    """Share (0..1) of the images that the body covers, by camera; cameras without it are omitted."""

    @classmethod
    def planned(cls, capture: Capture, own_body: bool | None) -> "EgoMaskReport":
        """Decide by the setting, else by the capture: only a drive has a vehicle body in its images."""
        if own_body is not None:
            return cls(own_body, "asked for" if own_body else "not asked for")
        is_drive = capture.ego is not None
        return cls(is_drive, "the capture is a drive" if is_drive else "the capture is no drive")

    @property
    def line(self) -> str:
        if not self.searched:
            return f"not looked for ({self.reason})"
        found = [f"{name or 'the camera'} {100 * share:.0f} %" for name, share in self.shares.items()]
        return f"looked for ({self.reason}): {', '.join(found) or 'none found'}"


# Training report


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredRender:
    """A render with its ground truth."""

    score: RenderScore
    rendered: Float32[np.ndarray, "h w 3"]
    truth: UInt8[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"] | None
    """Valid pixels; None means all."""
    is_held_out: bool


@dataclass(frozen=True, slots=True, eq=False)
class TrainingReport:
    """Scores, curves and settings of a finished reconstruction."""

    capture: Capture
    settings: TrainingSettings
    gaussians: int
    seconds: float
    """From the first image read to the last step; over all runs if resumed."""
    curves: TrainingCurves
    before: tuple[RenderScore, ...]
    """Held-out views before the first step."""
    pictures: tuple[MeasuredRender, ...]
    """All held-out views, and some training views."""
    seconds_by_stage: dict[str, float]
    own_body: EgoMaskReport

    @property
    def held_out(self) -> list[RenderScore]:
        return [each.score for each in self.pictures if each.is_held_out]

    @property
    def learned(self) -> list[RenderScore]:
        return [each.score for each in self.pictures if not each.is_held_out]

    @property
    def numbers(self) -> dict[str, Any]:
        """The figures that a command reports; None if no view was held out."""
        return {
            "seconds": self.seconds,
            "gaussians": self.gaussians,
            "psnr_before_db": mean_of(self.before, "psnr_db"),
            "psnr_held_out_db": mean_of(self.held_out, "psnr_db"),
            "psnr_held_out_exposed_db": mean_of(self.held_out, "psnr_exposed_db"),
            "ssim_held_out": mean_of(self.held_out, "ssim"),
            "lpips_held_out": mean_of(self.held_out, "lpips"),
            "psnr_learned_db": mean_of(self.learned, "psnr_db"),
            "views": len(self.capture),
            "held_out": [asdict(each) for each in self.held_out],
            "steps": len(self.curves.losses),
            "seconds_by_stage": self.seconds_by_stage,
            "own_body": asdict(self.own_body),
            "problems": list(self.capture.problems),
        }


def reconstruct(task: ReconstructionTask, opened: Capture | None = None) -> Generator[Progress, None, TrainingReport]:
    """Fit Gaussians to a capture (read from the task if None) and write the scene and the requested report.

    Yields progress at least once a step; if it is stopped there, the last checkpoint remains. Raises `CaptureError` if
    the capture can't be read or has nothing to train on, and `CheckpointError` if `resume` finds no checkpoint,
    or one of another training.
    """
    yield Progress(0.0, "Reading the capture")
    capture = task.read() if opened is None else opened
    run = TrainingRun(task.settings.steps, (_STARTED, _TRAINED))
    started = yield from start_training(capture, task.settings, task.held_out(capture), task.lpips)
    learning = _Reconstruction(task, capture, started, run)
    yield from learning.resume() if task.resume else learning.look_before()
    yield from learning.learn()
    result = yield from learning.measure()
    yield Progress(0.99, "Writing the scene")
    task.output.parent.mkdir(parents=True, exist_ok=True)
    scene = scene_of(started.training.model, capture, keep_lenses=task.settings.keep_lenses)
    write_scene(scene, task.output)
    if task.report is not None:
        write_report(task.report, training_page(result))
    task.checkpoint.unlink(missing_ok=True)
    yield Progress(1.0, f"{result.gaussians:,} Gaussians")
    return result


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTraining:
    """A training before its first step."""

    training: Trainer
    held_out: list[TrainingView]
    perceived: ImageDistance | None
    own_body: "EgoMaskReport"


class TrainingHeader(CheckpointHeader, frozen=True, kw_only=True):
    """Header of a reconstruction's checkpoint."""

    capture: str
    """Text that identifies the capture and its views."""
    settings: TrainingSettings


def _save(file: Path, header: bytes, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
    with file.open("wb") as stream:
        np.savez(stream, allow_pickle=False, head=np.frombuffer(header, np.uint8), **arrays)


def _load(file: Path) -> tuple[bytes, dict[str, Shaped[np.ndarray, "..."]]]:
    arrays = read_archive(file)
    return arrays.pop("head").tobytes(), arrays


CHECKPOINTS: CheckpointFormat[TrainingHeader] = CheckpointFormat(
    _save, _load, frozenset({"measured_every", "saved_every"})
)
"""NumPy archives without pickles."""


class _Reconstruction:
    """One training from its first step to its last, with its records."""

    def __init__(self, task: ReconstructionTask, capture: Capture, started: PreparedTraining, run: TrainingRun) -> None:
        self._task, self._capture, self._run = task, capture, run
        self._settings, self._training = task.settings, started.training
        self._held, self._perceived, self._own_body = started.held_out, started.perceived, started.own_body
        self._curves = TrainingCurves()
        self._before: tuple[RenderScore, ...] = ()
        self._unread: list[tuple[Any, int, float]] = []
        """Loss (on the device), number of Gaussians and time of each step that the curves lack."""

    def look_before(self) -> Generator[Progress]:
        yield Progress(_STARTED, "Measuring what it starts from")
        self._before = tuple(self._training.measure(view) for view in self._held)
        self._note(0, self._before[:_QUICK_VIEWS])

    def resume(self) -> Generator[Progress]:
        file = self._task.checkpoint
        yield Progress(_STARTED, f"Reading {file.name}")
        self._run.continue_from(CHECKPOINTS.resume(file, self._header(0), self._restore))

    def learn(self) -> Generator[Progress]:
        settings = self._settings
        actions = PeriodicAction(settings.measured_every, self._look), PeriodicAction(settings.saved_every, self._save)
        yield from self._run.train(self._step, actions)

    def _step(self, number: int) -> Progress:
        done = self._training.step(number)
        count = self._training.model.count
        self._unread.append((done.loss, count, self._run.seconds))
        metrics: dict[str, float] = {"gaussians": count}
        if not self._training.is_asynchronous or self._run.figures_are_due():
            self._read_losses()
            metrics = {"loss": self._curves.recent_loss(), **metrics}
        loss = self._curves.recent_loss()
        preview = comparison_image(done.exposed, done.truth) if self._run.preview_is_due() else None
        message = f"Step {number + 1:,} of {self._settings.steps:,}: loss {loss:.4f}, {count:,} Gaussians"
        message = f"{message} ({done.change})" if done.change else message
        return self._run.progress(number + 1, message, preview, metrics)

    def _read_losses(self) -> None:
        """Move the losses of all steps so far to the curves, which waits for the device."""
        losses = self._training.losses([loss for loss, _, _ in self._unread])
        for loss, (_, count, seconds) in zip(losses, self._unread, strict=True):
            self._curves.add(loss, count, seconds)
        self._unread.clear()

    def _look(self, steps: int) -> Progress:
        """Write the snapshot scene if requested, and evaluate some held-out views."""
        self._read_losses()
        if self._task.snapshot is not None:
            keep_lenses = self._settings.keep_lenses
            write_scene(scene_of(self._training.model, self._capture, keep_lenses=keep_lenses), self._task.snapshot)
        if not self._held:
            return self._run.progress(steps, f"After {steps:,} steps: loss {self._curves.recent_loss():.4f}")
        self._note(steps, [self._training.measure(view) for view in self._held[:_QUICK_VIEWS]])
        psnr_db = self._curves.measured_db[-1]
        message = f"Held-out views after {steps:,} steps: {psnr_db:.2f} dB"
        logger.info("%s, %.0f s", message, self._run.seconds)
        return self._run.progress(steps, message, metrics={"psnr_held_out_db": psnr_db})

    def _save(self, steps: int) -> Progress:
        self._read_losses()
        before = np.array([[each.psnr_db, each.ssim, each.psnr_exposed_db] for each in self._before]).reshape(-1, 3)
        arrays = self._training.state() | self._curves.state() | {"before": before}
        CHECKPOINTS.write(self._task.checkpoint, self._header(steps), arrays)
        return self._run.progress(steps, f"Saved {self._task.checkpoint.name}")

    def _restore(self, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        self._training.restore(arrays)
        self._curves = TrainingCurves.restored(arrays)
        scores = arrays["before"].tolist()
        self._before = tuple(RenderScore(view.name, *row) for view, row in zip(self._held, scores, strict=True))

    def _header(self, steps: int) -> TrainingHeader:
        capture = self._task.fingerprint(self._capture)
        return TrainingHeader(step=steps, seconds=self._run.seconds, capture=capture, settings=self._settings)

    def measure(self) -> Generator[Progress, None, TrainingReport]:
        """Evaluate all held-out views and some training views."""
        self._read_losses()
        seconds = self._run.seconds
        views = self._training.views
        spread = np.linspace(0, len(views) - 1, min(_LEARNED_VIEWS, len(views))).round().astype(int)
        learned = [views[index] for index in np.unique(spread)]
        chosen = [(view, True) for view in self._held] + [(view, False) for view in learned]
        pictures: list[MeasuredRender] = []
        for view, is_held_out in chosen:
            rendered = self._training.render(view)
            score = self._training.measure(view, self._perceived, rendered)
            pictures.append(MeasuredRender(score, rendered, view.levels[0].image, view.valid, is_held_out))
            fraction = _TRAINED + (0.98 - _TRAINED) * len(pictures) / len(chosen)
            yield Progress(fraction, f"{view.name}: {score.psnr_db:.2f} dB{'' if is_held_out else ', learned from'}")
        held = [each.score for each in pictures if each.is_held_out]
        if held:
            self._curves.measured(self._settings.steps, mean_of(held, "psnr_db") or 0.0)
        return TrainingReport(
            self._capture, self._settings, self._training.model.count, seconds, self._curves, self._before,
            tuple(pictures), dict(self._training.seconds_by_stage), self._own_body,
        )  # fmt: skip

    def _note(self, steps: int, scores: Sequence[RenderScore]) -> None:
        mean = mean_of(scores, "psnr_db")
        if mean is not None:
            self._curves.measured(steps, mean)


# Preparation

_KERNELS = 0.004  # share of the total progress at which gsplat's kernels are ready
_INITIAL_SHARE = 0.7  # initial share of the allowed Gaussians; the rest is left to density control


def start_training(
    capture: Capture, settings: TrainingSettings, held_out: Sequence[int], lpips: Path | None = None
) -> Generator[Progress, None, PreparedTraining]:
    """Prepare everything. Held-out views are used only to find the sky color and the vehicle's own body."""
    can_use_cuda = torch.cuda.is_available() and find_spec("gsplat") is not None
    if settings.device == "cuda" and not can_use_cuda:
        raise ValueError("--device cuda: needs an NVIDIA GPU, torch with CUDA, and gsplat (pip install gsrain[cuda])")
    device = "cuda" if can_use_cuda and settings.device != "cpu" else "cpu"
    if device == "cuda":
        try:
            yield from subprogress(build_gsplat(), 0.0, _KERNELS)
        except GsplatBuildError as error:
            if settings.device == "cuda":
                raise ValueError(f"--device cuda: {error}") from None
            logger.warning("%s; training on the processor", error)
            device = "cpu"
    yield Progress(_KERNELS, f"Reading {len(capture)} pictures")
    views = training_views(capture, settings.width_px)
    yield Progress(0.005, "Looking for surfaces and sky")
    known = depth_priors(capture, views)
    own_body = EgoMaskReport.planned(capture, settings.own_body)
    if own_body.searched:
        yield Progress(0.012, "Looking for the vehicle's own body")
        views, shares = mask_ego_vehicle(views, known.completed)
        own_body = replace(own_body, shares=shares)
    learned = [index for index in range(len(views)) if index not in set(held_out)]
    yield Progress(0.015, "Placing the first Gaussians")
    own, own_views = known.of(learned), [views[i] for i in learned]
    model = _model(capture, settings, own_views, own, device)
    moving = [box for box in moving_boxes(capture) if box.id not in model.actors]
    ready = [
        TrainingView.of(
            view,
            known.measured[index] if known.measured[index].any() else None,
            static_mask(view, moving) if moving else view.mask,
            known.skies[index] if settings.sky else None,
        )
        for index, view in enumerate(views)
    ]
    if capture.boxes:  # boxes already mark moving objects
        settings = msgspec.structs.replace(settings, transients=0.0)
    schedule = TrainingSchedule(settings, camera_extent(own_views))
    control: Strategy = MCMCStrategy(
        MCMCSettings.for_run(settings.steps, settings.gaussians, lambda step: schedule.rates(step)["means"])
    )
    if settings.density == "adaptive":
        control = DefaultStrategy(DefaultStrategySettings.for_run(settings.steps, schedule.extent, settings.gaussians))
    trajectory = camera_trajectory(own_views, own.median_depth)
    free = FreeSpaceCarving.of([view.camera for view in own_views], own.measured, trajectory, settings.free_space)
    training = Trainer(
        model, [ready[i] for i in learned], schedule, control, device, free if settings.free_space else None
    )
    if not capture.is_metric:
        logger.info(
            "%s: nothing tells how long a metre is; set the scene's scale before it rains (in the window, or by "
            "gsrain convert --meters-per-unit)", capture.name,
        )  # fmt: skip
    return PreparedTraining(training, [ready[i] for i in held_out], _perceived(lpips, device), own_body)


def _model(
    capture: Capture, settings: TrainingSettings, views: Sequence[CaptureFrame], known: DepthPriors, device: str
) -> SplatModel:
    """First Gaussians of all parts, from the training views."""
    budget = max(round(_INITIAL_SHARE * settings.gaussians), 1)
    background = initial_gaussians(capture, views, budget, settings.seed, known)
    if not len(background):
        raise CaptureError(f"{capture.name}: no view shows anything that could be learned from; check poses and masks")
    sky = initial_sky(capture, views, background, known.skies) if settings.sky else Gaussians.empty()
    actors = actor_layers(capture, views) if settings.actors else ()
    return SplatModel(
        SplatParameters.from_gaussians(background, settings.sh_degree, device),
        SplatParameters.from_gaussians(sky, 0, device) if len(sky) else None,
        {actor.id: SplatParameters.from_gaussians(actor.gaussians, 0, device) for actor in actors},
        {actor.id: actor for actor in actors},
    )


def _perceived(lpips: Path | None, device: str) -> ImageDistance | None:
    """LPIPS with VGG16 from a file or from this machine; None if neither is available."""
    try:
        weights = find_lpips_weights("vgg") if lpips is None else read_lpips_weights(lpips)
    except FileNotFoundError:
        if lpips is not None:
            raise
        return None
    return Lpips(weights).to(device).distance


# Training report page

_SMOOTHED_STEPS = 25  # smoothing window: each step uses another view, so single losses vary


def reconstruction_result(result: TrainingReport, output: Path) -> RunResult[Path]:
    """Return the written scene with its numbers; the figure compares views, rendered on the left."""
    titled = columns({"view": "", "PSNR dB": ".2f", "exposed": ".2f", "SSIM": ".3f", "LPIPS": ".3f"})
    rows = [
        (f"{each.name}, {kind}", each.psnr_db, each.psnr_exposed_db, each.ssim, each.lpips)
        for kind, scores in (("held out", result.held_out), ("learned from", result.learned))
        for each in scores
    ]
    numbers, page = result.numbers, training_page(result)
    line = "No view was held out: how well it shows new views is not known."
    if numbers["psnr_held_out_db"] is not None:
        line = (
            "Held-out views: {psnr_held_out_db:.2f} dB ({psnr_before_db:.2f} dB before training); "
            "{psnr_held_out_exposed_db:.2f} dB on their right halves, exposure fitted on the left"
        ).format(**numbers)
    made = f"{output}: {result.gaussians:,} Gaussians in {result.seconds:.0f} s"
    lines = (*result.capture.problems, f"Own body: {result.own_body.line}", line, made)
    return RunResult(
        made=output, table=Table("Views", titled, rows), numbers=numbers, lines=lines, page=page,
        draw=lambda: comparison_sheet(page.comparisons),
    )  # fmt: skip


def training_page(result: TrainingReport) -> RunReport:
    """Return the report of a reconstruction."""
    comparisons: list[ImageComparison] = []
    for each in [each for each in result.pictures if each.is_held_out] or result.pictures:
        truth = each.truth.astype(np.float32) / 255
        name = each.score.name if each.is_held_out else f"{each.score.name} (learned from)"
        compared = compare_images(name, np.clip(each.rendered, 0, 1), truth, each.valid)
        comparisons.append(replace(compared, lpips=each.score.lpips))
    settings = {key: str(value) for key, value in msgspec.to_builtins(result.settings).items()}
    return RunReport(
        f"Reconstruction of {result.capture.name}", settings, _curves(result), tuple(comparisons),
        result.seconds_by_stage, _headlines(result), result.capture.problems,
    )  # fmt: skip


def _curves(result: TrainingReport) -> tuple[ReportCurve, ...]:
    curves = result.curves
    steps, times = np.arange(1, len(curves.losses) + 1), np.array(curves.seconds)
    window = min(_SMOOTHED_STEPS, max(len(steps), 1))
    smooth = np.convolve(curves.losses, np.full(window, 1 / window), "valid")
    found = [
        ReportCurve("loss", steps[window - 1 :], smooth, times[window - 1 :], is_logarithmic=True),
        ReportCurve("Gaussians", steps, np.array(curves.counts, np.float64), times),
    ]
    if curves.measured_steps:
        at = np.array(curves.measured_steps)
        when = np.concatenate([[0.0], times])[at]
        found.insert(1, ReportCurve("held-out PSNR", at, np.array(curves.measured_db), when, "dB"))
    return tuple(found)


def _headlines(result: TrainingReport) -> dict[str, str]:
    lines = {
        "Gaussians": f"{result.gaussians:,}",
        "Time": f"{result.seconds / 60:.1f} min",
        "Views": f"{len(result.capture)}, {len(result.held_out)} held out",
        "Own body": result.own_body.line,
    }
    exposed, before = mean_of(result.held_out, "psnr_exposed_db"), mean_of(result.before, "psnr_db")
    if exposed is not None:
        lines["Right halves, exposure fitted on the left"] = f"{exposed:.2f} dB"
    if before is not None:
        lines["Before training"] = f"{before:.2f} dB"
    return lines

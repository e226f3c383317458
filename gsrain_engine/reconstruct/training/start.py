"""Where a training begins: views made ready, first Gaussians, a sky, things that move, and their control."""

import logging
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec

from gsrain_engine.datasets.capture import Capture, CaptureError, View
from gsrain_engine.datasets.pixels.known_depth import KnownDepth, known_depth
from gsrain_engine.datasets.pixels.moving_masks import moving_boxes, static_mask
from gsrain_engine.evaluate.lpips import Lpips
from gsrain_engine.evaluate.lpips_weights import find_lpips_weights, read_lpips_weights
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import Progress

from ..beginning.actor_layers import actor_layers
from ..beginning.camera_way import camera_way
from ..beginning.ego_mask import without_ego
from ..beginning.initial_gaussians import initial_gaussians
from ..beginning.sky_layer import initial_sky
from ..density.adaptive import AdaptiveDensity, AdaptiveSettings
from ..density.control import DensityControl
from ..density.free_space import ClearedDensity, FreeSpace
from ..density.monte_carlo import MonteCarloDensity, MonteCarloSettings
from ..parameters.splat_parameters import SplatParameters
from .held_out import Perceived
from .model import SplatModel
from .run import Training
from .schedule import Schedule, camera_extent
from .settings import TrainingSettings
from .views import TrainingView, prepared_views

torch: Any = import_module("torch")

logger = logging.getLogger("gsrain")

_INITIAL_SHARE = 0.7
"""Of the Gaussians allowed, how many there may be at first: density control needs room."""


@dataclass(frozen=True, slots=True, eq=False)
class StartedTraining:
    """A training that has done no step yet."""

    training: Training
    held_out: list[TrainingView]
    """Views that it does not learn from."""
    perceived: Perceived | None
    own_body: "OwnBody"


@dataclass(frozen=True, slots=True)
class OwnBody:
    """The search for the vehicle's own body in the pictures, for the record."""

    searched: bool
    reason: str
    """Why it ran, or did not."""
    shares: Mapping[str, float] = field(default_factory=dict[str, float])
    """By camera, which part (0..1) of its pictures the body covers; cameras without any are not listed."""

    @classmethod
    def planned(cls, capture: Capture, own_body: bool | None) -> "OwnBody":
        """Decide by the setting, else by the capture: only a vehicle that drives has a body in its pictures."""
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


def start_training(
    capture: Capture, settings: TrainingSettings, held_out: Sequence[int], lpips: Path | None = None
) -> Generator[Progress, None, StartedTraining]:
    """Make everything ready. Held-out views help to tell what colour the sky has and where the own body is; no more."""
    device = _device(settings.device)
    yield Progress(0.0, f"Reading {len(capture)} pictures")
    views = prepared_views(capture, settings.width_px)
    yield Progress(0.005, "Looking for surfaces and sky")
    known = known_depth(capture, views)
    own_body = OwnBody.planned(capture, settings.own_body)
    if own_body.searched:
        yield Progress(0.012, "Looking for the vehicle's own body")
        views, shares = without_ego(views, known.completed)
        own_body = replace(own_body, shares=shares)
    learned = [index for index in range(len(views)) if index not in set(held_out)]
    yield Progress(0.015, "Placing the first Gaussians")
    model = _model(capture, settings, [views[i] for i in learned], known.of(learned), device)
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
    if capture.boxes:  # they tell what moves
        settings = msgspec.structs.replace(settings, transients=0.0)
    schedule = Schedule(settings, camera_extent([views[i] for i in learned]))
    control = _control(settings, schedule)
    own, own_views = known.of(learned), [views[i] for i in learned]
    way = camera_way(own_views, own.usual)
    free = FreeSpace.of([view.camera for view in own_views], own.measured, way, settings.free_space)
    if free is not None and settings.free_space:
        control = ClearedDensity(control, free, settings.steps)
    training = Training(model, [ready[i] for i in learned], schedule, control, device)
    if not capture.is_metric:
        logger.info(
            "%s: nothing tells how long a metre is; set the scene's scale before it rains (in the window, or by "
            "gsrain convert --metres-per-unit)", capture.name,
        )  # fmt: skip
    return StartedTraining(training, [ready[i] for i in held_out], _perceived(lpips, device), own_body)


def _model(
    capture: Capture, settings: TrainingSettings, views: Sequence[View], known: KnownDepth, device: str
) -> SplatModel:
    """First Gaussians of everything, from the views that are learned from."""
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


def _device(asked: str) -> str:
    """Return "cuda" where that is asked for or usable; raises ValueError where it is asked for and isn't there."""
    usable = torch.cuda.is_available() and find_spec("gsplat") is not None
    if asked == "cuda" and not usable:
        raise ValueError("--device cuda: needs an NVIDIA GPU, torch with CUDA, and gsplat (pip install gsrain[cuda])")
    return "cuda" if usable and asked != "cpu" else "cpu"


def _control(settings: TrainingSettings, schedule: Schedule) -> DensityControl:
    if settings.density == "adaptive":
        return AdaptiveDensity(AdaptiveSettings.for_run(settings.steps, schedule.extent, settings.gaussians))

    def means_rate(step: int) -> float:
        return schedule.rates(step)["means"]

    return MonteCarloDensity(MonteCarloSettings.for_run(settings.steps, settings.gaussians, means_rate))


def _perceived(lpips: Path | None, device: str) -> Perceived | None:
    """LPIPS with VGG16 from a file, or from this machine; None where nothing is asked for and there is none."""
    try:
        weights = find_lpips_weights("vgg") if lpips is None else read_lpips_weights(lpips)
    except FileNotFoundError:
        if lpips is not None:
            raise
        return None
    return Lpips(weights).to(device)

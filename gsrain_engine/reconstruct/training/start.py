"""Where a training begins: views made ready, first Gaussians, a sky, things that move, and their control."""

import logging
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from gsrain_engine.datasets.capture import Capture, CaptureError, View
from gsrain_engine.evaluate.lpips import Lpips
from gsrain_engine.evaluate.lpips_weights import find_lpips_weights, read_lpips_weights
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import Progress

from ..beginning.actor_layers import actor_layers
from ..beginning.ego_mask import without_ego
from ..beginning.initial_gaussians import initial_gaussians
from ..beginning.measured_depth import completed_depths, measured_depths
from ..beginning.moving_masks import moving_boxes, static_mask
from ..beginning.sky_layer import initial_sky
from ..beginning.sky_pixels import sky_masks
from ..density.adaptive import AdaptiveDensity, AdaptiveSettings
from ..density.control import DensityControl
from ..density.monte_carlo import MonteCarloDensity, MonteCarloSettings
from .held_out import Perceived
from .model import SplatModel
from .run import Training
from .schedule import Schedule, camera_extent
from .settings import TrainingSettings
from .splat_parameters import SplatParameters
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


def start_training(
    capture: Capture, settings: TrainingSettings, held_out: Sequence[int], lpips: Path | None = None
) -> Generator[Progress, None, StartedTraining]:
    """Make everything ready. Nothing but the learned views decides what the model starts from."""
    device = _device(settings.device)
    yield Progress(0.0, f"Reading {len(capture)} pictures")
    views = prepared_views(capture, settings.width_px)
    depths = measured_depths(capture, views)
    yield Progress(0.01, "Looking for the sky")
    skies = sky_masks(views, depths, capture.up)
    if settings.own_body:
        yield Progress(0.012, "Looking for the vehicle's own body")
        views = without_ego(views, completed_depths(capture, views, depths, skies))
    learned = [index for index in range(len(views)) if index not in set(held_out)]
    yield Progress(0.015, "Placing the first Gaussians")
    model = _model(capture, settings, views, skies if settings.sky else None, learned, device)
    moving = [box for box in moving_boxes(capture) if box.id not in model.actors]
    ready = [
        TrainingView.of(
            view,
            depths[index] if depths[index].any() else None,
            static_mask(view, moving) if moving else view.mask,
            skies[index] if settings.sky else None,
        )
        for index, view in enumerate(views)
    ]
    schedule = Schedule(settings, camera_extent([views[i] for i in learned]))
    training = Training(model, [ready[i] for i in learned], schedule, _control(settings, schedule), device)
    if not capture.is_metric:
        logger.info("%s: nothing tells how long a metre is; set the scene's scale before it rains", capture.name)
    return StartedTraining(training, [ready[i] for i in held_out], _perceived(lpips, device))


def _model(
    capture: Capture,
    settings: TrainingSettings,
    views: Sequence[View],
    skies: Sequence[Bool[np.ndarray, "h w"]] | None,
    learned: Sequence[int],
    device: str,
) -> SplatModel:
    """First Gaussians of everything, from the views that are learned from."""
    own = [views[i] for i in learned]
    budget = max(round(_INITIAL_SHARE * settings.gaussians), 1)
    background = initial_gaussians(capture, own, budget, settings.seed)
    if not len(background):
        raise CaptureError(f"{capture.name}: no view shows anything that could be learned from; check poses and masks")
    sky = Gaussians.empty()
    if skies is not None:
        sky = initial_sky(capture, own, background, [skies[i] for i in learned])
    actors = actor_layers(capture, own) if settings.actors else ()
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

"""One training: its model, its views and its place in the schedule, step by step."""

import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from ..density.control import DensityControl
from .exposure_affine import ExposureAffine
from .held_out import Perceived, Score, score
from .loss import Truth, view_loss
from .model import Picture, SplatModel
from .schedule import Schedule, view_order
from .transients import agreeing
from .views import TrainingView

torch: Any = import_module("torch")

Tensor = Any

_EXPOSURES = "exposures"
_CONTROL = "control"
_STAGES = ("reading", "forward", "backward", "optimizer", "density")


class Done(NamedTuple):
    """What one step was like."""

    step: int
    """Counted from 0."""
    loss: float
    change: str | None
    """What density control did."""
    shown: Tensor
    """(h, w, 3) render in the picture's own exposure."""
    truth: Tensor


class Training:
    """What a training changes, and how it does. Everything random follows from the seed and the step alone."""

    def __init__(
        self, model: SplatModel, views: Sequence[TrainingView], schedule: Schedule, control: DensityControl, device: str
    ) -> None:
        self.model, self.views, self.schedule = model, views, schedule
        self.seconds_by_stage: dict[str, float] = dict.fromkeys(_STAGES, 0.0)
        self._control, self._device = control, device
        settings = schedule.settings
        self._exposures = ExposureAffine(len(views), device) if settings.exposure else None
        self._order = view_order(len(views), settings.steps, settings.seed)

    def step(self, number: int) -> Done:
        clock = _Clock(self.seconds_by_stage)
        settings, index = self.schedule.settings, self._order[number]
        view = self.views[index]
        level = view.levels[self.schedule.level(number)]
        truth = Truth.of(level, self._device)
        clock.stop("reading")
        self.model.zero_grad()
        picture = self.model.render(level.camera, view.time_s, self.schedule.sh_degree(number))
        shown = picture.color if self._exposures is None else self._exposures.apply(index, picture.color)
        if self.schedule.leaves_out(number):
            truth = truth._replace(mask=agreeing(shown, truth.image, truth.mask, settings.transients))
        loss = view_loss(picture, shown, truth, settings)
        total = loss.total
        if self._exposures is not None:
            total = total + settings.exposure * self._exposures.pull(index)
        pull = self._control.regularization(self.model.background)
        if pull is not None:
            total = total + pull
        clock.stop("forward")
        total.backward()
        clock.stop("backward")
        self._control.observe(number, picture.front, picture.background_rows)
        self._move(number, picture, everything=pull is not None)
        clock.stop("optimizer")
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + number)
        change = self._control.adapt(number, self.model.background, generator)
        clock.stop("density")
        return Done(number, float(loss.total.detach()), change, shown.detach(), truth.image)

    def render(self, view: TrainingView) -> Float32[np.ndarray, "h w 3"]:
        """Draw the whole model as a view's camera sees it, at full size, with nothing learned."""
        with torch.no_grad():
            color = self.model.render(view.levels[0].camera, view.time_s).color
        return color.cpu().numpy()

    def measure(
        self,
        view: TrainingView,
        perceived: Perceived | None = None,
        rendered: Float32[np.ndarray, "h w 3"] | None = None,
    ) -> Score:
        """Compare a render (which is made here unless it is at hand) with a view's photograph."""
        if rendered is None:
            rendered = self.render(view)
        return score(view.name, rendered, view.levels[0].image, view.seen, perceived)

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Return everything that the training goes on from, as arrays by name."""
        arrays = self.model.state()
        arrays |= {f"{_CONTROL}:{name}": array for name, array in self._control.state().items()}
        if self._exposures is not None:
            arrays |= {f"{_EXPOSURES}:{name}": array for name, array in self._exposures.state().items()}
        return arrays

    def restore(self, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Go back to what `state` returned; raises KeyError where something is missing."""
        self.model.restore(arrays)
        self._control.restore(_named(arrays, _CONTROL))
        if self._exposures is not None:
            self._exposures.restore(_named(arrays, _EXPOSURES))

    def _move(self, number: int, picture: Picture, *, everything: bool) -> None:
        """Do a step of the optimizers: only Gaussians that were drawn move, unless a pull goes to all of them."""
        rates = self.schedule.rates(number)
        drawn = picture.front.footprint.drawn
        self.model.background.step(rates, None if everything else drawn[picture.background_rows])
        for key, rows in picture.actor_rows.items():
            own = rates | {"means": rates["means"] / self.schedule.extent}
            self.model.actors[key].step(own, drawn[rows])
        if self.model.sky is not None and picture.sky is not None:
            self.model.sky.step({name: rates[name] for name in ("sh_dc", "sh_rest")}, picture.sky.footprint.drawn)
        if self._exposures is not None:
            self._exposures.step(self.schedule.settings.rates.exposure * self.schedule.settings.haste)


def beside(shown: Tensor, truth: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    """Put a render and its photograph side by side, as a picture to look at."""
    both = torch.cat([shown, truth], dim=1).clamp(0, 1)
    return (both * 255 + 0.5).to(torch.uint8).cpu().numpy()


class _Clock:
    """Adds the time since the last stop to a stage."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds, self._last = seconds, time.perf_counter()

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self._seconds[stage] += now - self._last
        self._last = now


def _named(arrays: Mapping[str, Shaped[np.ndarray, "..."]], kind: str) -> dict[str, Shaped[np.ndarray, "..."]]:
    prefix = f"{kind}:"
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}

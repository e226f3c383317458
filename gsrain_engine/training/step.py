"""One training step: render, loss, backward pass, optimizers and density control.

On CUDA a step only queues work: nothing in it waits for the GPU but gsplat itself, and a change of the number of
Gaussians, which the processor has to know.
"""

import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from ..evaluation.image_metrics import ImageDistance
from ..training_run import arrays_of
from .data import TrainingView
from .evaluation import RenderScore, score
from .free_space import DeviceFreeSpace, FreeSpaceCarving, clear_free_space
from .losses import robust_mask, view_loss
from .model import SplatModel, TrainingRender
from .parameters import AdamStep, foreach_adam_step, fused_adam_step
from .schedule import TrainingSchedule, view_order
from .strategy import Strategy
from .targets import TargetCache

torch: Any = import_module("torch")
Tensor = Any
Render = Float32[np.ndarray, "h w 3"]


class TrainingStepResult(NamedTuple):
    """Result of one training step."""

    loss: Tensor
    """() on the device; `Trainer.losses` reads it."""
    change: str | None
    exposed: Tensor
    """(h, w, 3) render with the image's own exposure applied."""
    truth: Tensor


class Trainer:
    """Trainable state and its training steps; all randomness follows from the seed and the step."""

    def __init__(
        self,
        model: SplatModel,
        views: Sequence[TrainingView],
        schedule: TrainingSchedule,
        control: Strategy,
        device: str,
        free: FreeSpaceCarving | None = None,
    ) -> None:
        self.model, self.views, self.schedule = model, views, schedule
        self.seconds_by_stage: dict[str, float] = dict.fromkeys(
            ("reading", "forward", "backward", "optimizer", "density"), 0.0
        )
        self.is_asynchronous = device != "cpu"
        """True if steps are queued on a GPU, where reading a loss waits for all of them."""
        self._clock = (_EventClock if self.is_asynchronous else _StageClock)(self.seconds_by_stage)
        self._control = control
        self._free = DeviceFreeSpace(free, device) if free is not None and self.is_asynchronous else free
        self._targets = TargetCache(views, device)
        settings = schedule.settings
        self._exposures = ExposureAffine(len(views), settings.exposure, device) if settings.exposure else None
        self._generator = torch.Generator(device=device)
        self._order = view_order(len(views), settings.steps, settings.seed)

    def step(self, number: int) -> TrainingStepResult:
        clock = self._clock
        clock.begin()
        settings, index = self.schedule.settings, self._order[number]
        view = self.views[index]
        level = self.schedule.level(number)
        truth = self._targets.target(index, level)
        clock.stop("reading")
        self.model.zero_grad()
        picture = self.model.render(view.levels[level].camera, view.time_s, self.schedule.sh_degree(number))
        exposed = picture.color if self._exposures is None else self._exposures.apply(index, picture.color)
        if self.schedule.leaves_out(number):
            truth = truth._replace(mask=robust_mask(exposed.detach(), truth, settings.transients))
        loss = view_loss(picture, exposed, truth, settings)
        regularization = self._control.regularization(self.model.background)
        clock.stop("forward")
        loss.backward(regularization)
        clock.stop("backward")
        self._control.observe(number, picture.front, picture.background_rows)
        self._move(number, picture, everything=regularization is not None)
        clock.stop("optimizer")
        generator = self._generator.manual_seed(settings.seed * 1_000_003 + number)
        change = self._control.adapt(number, self.model.background, generator)
        if self._free is not None:
            cleared = clear_free_space(number, settings.steps, self.model.background, self._free)
            change = ", ".join(filter(None, (change, cleared))) or None
        clock.stop("density")
        return TrainingStepResult(loss.value, change, exposed.detach(), truth.image)

    def losses(self, results: Sequence[Tensor]) -> list[float]:
        """Read the losses of the steps since the last call at once; waits until those steps are done."""
        values: list[float] = torch.stack(list(results)).tolist() if results else []
        self._clock.settle()
        return values

    def render(self, view: TrainingView) -> Render:
        """Render the whole model for a view at full size, without gradients."""
        with torch.no_grad():
            color = self.model.render(view.levels[0].camera, view.time_s).color
        return color.cpu().numpy()

    def measure(
        self,
        view: TrainingView,
        lpips: ImageDistance | None = None,
        rendered: Render | None = None,
    ) -> RenderScore:
        """Compare a render, computed here if None, with a view's ground truth."""
        rendered = self.render(view) if rendered is None else rendered
        return score(view.name, rendered, view.levels[0].image, view.valid, lpips)

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        arrays = self.model.state()
        arrays |= {f"control:{name}": array for name, array in self._control.state().items()}
        if self._exposures is not None:
            arrays |= {f"exposures:{name}": array for name, array in self._exposures.state().items()}
        return arrays

    def restore(self, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Restore the output of `state`; raises KeyError if something is missing."""
        self.model.restore(arrays)
        self._control.restore(arrays_of(arrays, "control"))
        if self._exposures is not None:
            self._exposures.restore(arrays_of(arrays, "exposures"))

    def _move(self, number: int, picture: TrainingRender, *, everything: bool) -> None:
        """Step the optimizers: only drawn Gaussians move, unless a regularization applies to all of them."""
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


def comparison_image(exposed: Tensor, truth: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit image of a render and its ground truth side by side."""
    both = torch.cat([exposed, truth], dim=1).clamp(0, 1)
    return (both * 255 + 0.5).to(torch.uint8).cpu().numpy()


class _StageClock:
    """Adds the time since the last stop to a stage."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds, self._last = seconds, 0.0

    def begin(self) -> None:
        self._last = time.perf_counter()

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self._seconds[stage] += now - self._last
        self._last = now

    def settle(self) -> None:
        """Add what is still open; here nothing is."""


class _EventClock:
    """The same for work queued on a GPU, by events between its kernels."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds = seconds
        self._events: list[tuple[str | None, Any]] = []

    def begin(self) -> None:
        self.stop(None)

    def stop(self, stage: str | None) -> None:
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        self._events.append((stage, event))

    def settle(self) -> None:
        """Add the time between events; the steps that recorded them are done."""
        if self._events:
            self._events[-1][1].synchronize()
        for (_, before), (stage, event) in pairwise(self._events):
            if stage is not None:
                self._seconds[stage] += before.elapsed_time(event) / 1000
        self._events.clear()


# Affine exposure maps


class ExposureAffine:
    """Trainable maps color -> A color + b, one per image; their mean is the identity, which fixes the gauge.

    Otherwise a darker scene with brighter exposures would give the same loss. The gradient of an image's map includes
    that of `pull` times its squared deviation from the identity.
    """

    def __init__(self, count: int, pull: float, device: str = "cpu") -> None:
        self.changes = torch.zeros((count, 3, 4), device=device, requires_grad=True)
        """(count, 3, 4): added to the identity."""
        self._identity = torch.eye(3, 4, device=device)
        self._everyone = torch.ones(count, dtype=torch.bool, device=device)
        self._first, self._second = torch.zeros((2, count, 3, 4), device=device).unbind()
        self._pull, self._steps = pull, 0

    def apply(self, index: int, color: Tensor) -> Tensor:
        """Apply an image's map to its colors (h, w, 3)."""
        return _Exposed.apply(color, self.changes, self._identity, index, self._pull)

    def step(self, rate: float) -> None:
        """Do one step of Adam, then reset the mean map to the identity."""
        slope = self.changes.grad
        if slope is None:
            return
        self._steps += 1
        with torch.no_grad():
            move = fused_adam_step if self.changes.is_cuda else foreach_adam_step
            four = (self.changes, slope, self._first, self._second)
            move([four], self._everyone, [AdamStep.of(rate, self._steps)])
            self.changes -= self.changes.mean(dim=0, keepdim=True)
        self.changes.grad = None

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        tensors = {"changes": self.changes, "first": self._first, "second": self._second}
        arrays = {name: each.detach().cpu().numpy().copy() for name, each in tensors.items()}
        return arrays | {"steps": np.array(self._steps)}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Restore the output of `state`; raises KeyError if something is missing."""
        device = self.changes.device
        self.changes = torch.tensor(state["changes"], device=device, requires_grad=True)
        self._first = torch.tensor(state["first"], device=device)
        self._second = torch.tensor(state["second"], device=device)
        self._steps = int(state["steps"])


class _Exposed(torch.autograd.Function):
    """Colors (h, w, 3) mapped by one of many changes to the identity."""

    @staticmethod
    def forward(context: Any, color: Tensor, changes: Tensor, identity: Tensor, index: int, pull: float) -> Tensor:
        change = changes[index]
        matrix = identity + change
        context.save_for_backward(color, change, matrix)
        context.place = len(changes), index, pull
        return torch.addmm(matrix[:, 3], color.reshape(-1, 3), matrix[:, :3].T).view(color.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        color, change, matrix = context.saved_tensors
        count, index, pull = context.place
        slopes = gradient.reshape(-1, 3)
        by_changes = change.new_zeros((count, 3, 4))
        by_change = torch.mul(change, 2 * pull, out=by_changes[index])
        by_change[:, :3].addmm_(slopes.T, color.reshape(-1, 3))
        by_change[:, 3].add_(slopes.sum(dim=0))
        return (slopes @ matrix[:, :3]).view(color.shape), by_changes, None, None, None

"""One training step: render, loss, backward pass, optimizers and density control.

On CUDA a step only queues work: nothing in it waits for the GPU but gsplat itself, and a change of the number of
Gaussians, which the processor has to know.
"""

import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from ..evaluation.image_metrics import C1, C2, HALF_WINDOW_PX, MIN_WEIGHT, WINDOW_PX, ImageDistance, check_pair, window
from ..render.cuda import uploaded
from ..training_run import arrays_of
from .data import TrainingView
from .evaluation import RenderScore, score
from .free_space import DeviceFreeSpace, FreeSpaceCarving, clear_free_space
from .model import SplatModel, TrainingRender
from .settings import TrainingSchedule, TrainingSettings, view_order
from .strategy import Strategy
from .targets import TargetCache, TrainingTarget

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
        self._control, self._device = control, device
        self._free = DeviceFreeSpace(free, device) if free is not None and self.is_asynchronous else free
        self._targets = TargetCache(views, device)
        settings = schedule.settings
        self._exposures = ExposureAffine(len(views), device) if settings.exposure else None
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
            truth = truth._replace(mask=robust_mask(exposed, truth.image, truth.mask, settings.transients))
        loss = total = view_loss(picture, exposed, truth, settings)
        if self._exposures is not None:
            total = total + settings.exposure * self._exposures.penalty(index)
        regularization = self._control.regularization(self.model.background)
        if regularization is not None:
            total = total + regularization
        clock.stop("forward")
        total.backward()
        clock.stop("backward")
        self._control.observe(number, picture.front, picture.background_rows)
        self._move(number, picture, everything=regularization is not None)
        clock.stop("optimizer")
        generator = torch.Generator(device=self._device).manual_seed(settings.seed * 1_000_003 + number)
        change = self._control.adapt(number, self.model.background, generator)
        if self._free is not None:
            cleared = clear_free_space(number, settings.steps, self.model.background, self._free)
            change = ", ".join(filter(None, (change, cleared))) or None
        clock.stop("density")
        return TrainingStepResult(loss.detach(), change, exposed.detach(), truth.image)

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


# Loss of one view

_MIN_ALPHA = 0.05  # alpha below which depth is undefined


def view_loss(picture: TrainingRender, exposed: Tensor, truth: TrainingTarget, settings: TrainingSettings) -> Tensor:
    """Loss of one render against its target: the sum of color, depth and cover.

    Color is (1 - s) L1 + s D-SSIM (Kerbl et al. 2023, eq. 7) of `exposed`, the render with its camera's exposure. Depth
    is |d - m| / (d + m) of expected depth d and measured depth m: independent of scale, and bounded, since a beam that
    grazes an edge may be meters off. Cover is the missing alpha at measured surfaces, and the alpha in front of known
    sky.
    """
    color = (1 - settings.d_ssim) * l1(exposed, truth.image, truth.mask)
    if settings.d_ssim:
        color = color + settings.d_ssim * d_ssim(exposed, truth.image, truth.mask)
    nothing = color.new_zeros(())
    depth, cover = nothing, nothing
    if len(truth.hits) and (settings.depth or settings.cover):
        alpha = picture.front.alpha.reshape(-1).index_select(0, truth.hits)
        weighted = picture.front.depth.reshape(-1).index_select(0, truth.hits)
        mean = weighted / alpha.clamp_min(_MIN_ALPHA)
        error = (mean - truth.depths).abs() / (mean + truth.depths)
        depth = settings.depth * (error * (alpha.detach() > _MIN_ALPHA)).mean()
        cover = settings.cover * (1 - alpha).mean()
    if truth.sky is not None and picture.sky is not None and settings.cover:
        sky = truth.sky if truth.mask is None else truth.sky & truth.mask
        cover = cover + settings.cover * (picture.front.alpha * sky).sum() / sky.sum().clamp_min(1)
    return color + depth + cover


# L1 and D-SSIM


def l1(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Mean absolute difference of two (h, w, 3) tensors over the pixels of a bool mask (h, w); 0 if none is set."""
    check_pair(tuple(rendered.shape), tuple(truth.shape), None if mask is None else tuple(mask.shape))
    difference = (rendered - truth).abs()
    if mask is None:
        return difference.mean()
    return (difference * mask[..., None]).sum() / (3 * mask.sum()).clamp_min(1)


def d_ssim(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Return 1 - SSIM of two (h, w, 3) tensors of values 0..1 over the pixels of a bool mask (h, w).

    Same SSIM as `gsrain_engine.evaluation.image_metrics.ssim`: windows inside the image, masked pixels without weight.
    A term of 3DGS's loss (Kerbl et al. 2023, eq. 7). 0 if the mask is empty. Differentiable in `rendered` and `truth`.
    Raises ValueError for other shapes and for images smaller than the window (11 px).
    """
    check_pair(tuple(rendered.shape), tuple(truth.shape), None if mask is None else tuple(mask.shape))
    if min(rendered.shape[:2]) < WINDOW_PX:
        raise ValueError(f"SSIM takes pictures of at least {WINDOW_PX} px a side, not {tuple(rendered.shape[:2])}")
    if mask is None:
        return 1 - _similarity(_means(rendered, truth, None)).mean()
    weights = mask[..., None].to(rendered.dtype)
    inside = mask[HALF_WINDOW_PX:-HALF_WINDOW_PX, HALF_WINDOW_PX:-HALF_WINDOW_PX, None]
    similarity = _similarity(_means(rendered, truth, weights))
    return ((1 - similarity) * inside).sum() / (3 * inside.sum()).clamp_min(1)


def _means(x: Tensor, y: Tensor, weights: Tensor | None) -> tuple[Tensor, ...]:
    values = torch.cat([x, y, x * x + y * y, x * y], dim=2)
    if weights is None:
        return _blurred(values).split(3, dim=2)
    return (_blurred(values * weights) / _blurred(weights).clamp_min(MIN_WEIGHT)).split(3, dim=2)


def _similarity(means: tuple[Tensor, ...]) -> Tensor:
    # Only the sum of both variances is needed, which saves one filter pass.
    x, y, squares, product = means
    both, crossed = x * x + y * y, x * y
    return (2 * crossed + C1) * (2 * (product - crossed) + C2) / ((both + C1) * (squares - both + C2))


def _blurred(values: Tensor) -> Tensor:
    return OpenCVBlur.apply(values) if values.device.type == "cpu" else convolved(values)


def convolved(values: Tensor) -> Tensor:
    """(h - 10, w - 10, c) Gaussian window means by torch, on any device: along y, then along x."""
    # Torch's own float32 kernel takes contiguous planes in at least two groups; cuDNN, which takes the rest, would
    # round to TF32, too coarse for variances.
    channels, groups = values.shape[2], max(values.shape[2], 2)
    taps = uploaded(window(), values.device).to(values.dtype).repeat(groups, 1)
    planes = values.permute(2, 0, 1).contiguous()[None].expand(-1, groups if channels == 1 else -1, -1, -1)
    rows = torch.nn.functional.conv2d(planes.contiguous(), taps.view(groups, 1, -1, 1), groups=groups)
    both = torch.nn.functional.conv2d(rows, taps.view(groups, 1, 1, -1), groups=groups)
    return both[0, :channels].permute(1, 2, 0)


class OpenCVBlur(torch.autograd.Function):
    """The same by OpenCV, several times faster on the CPU than torch's single-channel convolution."""

    @staticmethod
    def forward(context: Any, values: Tensor) -> Tensor:
        blurred = _filtered(values.detach().numpy())
        inner = blurred[HALF_WINDOW_PX:-HALF_WINDOW_PX, HALF_WINDOW_PX:-HALF_WINDOW_PX]
        return torch.from_numpy(np.ascontiguousarray(inner))

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> Tensor:
        edge = HALF_WINDOW_PX
        # The symmetric window is its own transpose; cropping transposes to zero padding.
        return torch.from_numpy(_filtered(np.pad(gradient.numpy(), ((edge, edge), (edge, edge), (0, 0)))))


def _filtered(values: np.ndarray) -> np.ndarray:
    taps = window().astype(values.dtype)
    return cv2.sepFilter2D(values, -1, taps, taps, borderType=cv2.BORDER_CONSTANT).reshape(values.shape)


# Robust mask

_WINDOW = 0.03  # side of the averaging window in image widths; single pixels are no evidence
_THRESHOLDS, _TIMES = 0.08, 4.0
"""Color difference (0..1) below which no pixel is masked, and required multiple of the median."""


def robust_mask(exposed: Tensor, truth: Tensor, mask: Tensor | None, max_share: float) -> Tensor:
    """(h, w) bool: a mask without the patches where render and image (h, w, 3) differ far more than elsewhere.

    Follows robust losses for scenes with distractors (Sabour et al. 2023, section 3.2). Their quantile is only an upper
    bound here, so that no pixel of a well-fitted image is masked: at most `max_share` of the valid pixels of `mask`
    (all for None).
    """
    with torch.no_grad():
        counts = torch.ones(truth.shape[:2], dtype=torch.bool, device=truth.device) if mask is None else mask
        difference = torch.where(counts, (exposed - truth).abs().mean(dim=2), 0)
        reach = max(round(_WINDOW * truth.shape[1] / 2), 1)
        both = torch.stack([difference, counts.to(difference.dtype)])[None]
        mean, part = torch.nn.functional.avg_pool2d(both, 2 * reach + 1, 1, reach)[0]
        mean = mean / part.clamp_min(1e-6)
        # Pixels that don't count come last: the number of those that do stays on the device.
        ordered = torch.where(counts, mean, torch.inf).reshape(-1).sort().values
        number = counts.sum()
        ranks = torch.stack([((1 - max_share) * number.double()).long().minimum(number - 1), number // 2])
        bound, median = ordered.index_select(0, ranks.clamp_min(0)).unbind()
        limit = torch.maximum(bound, (_TIMES * median).clamp_min(_THRESHOLDS))
        return counts & (mean <= limit)


# Affine exposure maps

_DECAYS = 0.9, 0.999


class ExposureAffine:
    """Trainable maps color -> A color + b, one per image; their mean is the identity, which fixes the gauge.

    Otherwise a darker scene with brighter exposures would give the same loss.
    """

    def __init__(self, count: int, device: str = "cpu") -> None:
        self.changes = torch.zeros((count, 3, 4), device=device, requires_grad=True)
        """(count, 3, 4): added to the identity."""
        self._first, self._second = torch.zeros((2, count, 3, 4), device=device).unbind()
        self._steps = 0

    def apply(self, index: int, color: Tensor) -> Tensor:
        """Apply an image's map to its colors (h, w, 3)."""
        change = self.changes[index]
        return color + color @ change[:, :3].T + change[:, 3]

    def penalty(self, index: int) -> Tensor:
        """Squared deviation of one image's map from the identity."""
        return (self.changes[index] ** 2).sum()

    def step(self, rate: float) -> None:
        """Do one step of Adam, then reset the mean map to the identity."""
        slope = self.changes.grad
        if slope is None:
            return
        self._steps += 1
        with torch.no_grad():
            self._first.mul_(_DECAYS[0]).add_(slope, alpha=1 - _DECAYS[0])
            self._second.mul_(_DECAYS[1]).addcmul_(slope, slope, value=1 - _DECAYS[1])
            shares = [1 - decay**self._steps for decay in _DECAYS]
            self.changes.addcdiv_(self._first / shares[0], (self._second / shares[1]).sqrt() + 1e-15, value=-rate)
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

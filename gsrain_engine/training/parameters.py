"""Trainable Gaussians: unconstrained torch tensors with their Adam moments, and the fused Adam step of each device."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Shaped

from ..kernels import kernel, range_of
from ..render.gsplat_input import uploaded
from ..scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians

torch: Any = import_module("torch")
Tensor = Any  # a torch tensor; torch is an optional extra, so its types can't be named here
NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
_MIN_SCALE, _MIN_OPACITY = 1e-12, 1e-8  # lower bounds of values before their logarithm is taken


class SplatParameters:
    """Trainable Gaussians: `tensors` by name, each a leaf with gradients, and Adam over them.

    "means" (n, 3), "log_scales" (n, 3), "quaternions" (n, 4) wxyz of any length, "opacity_logits" (n,), "sh_dc" (n, 1,
    3) and "sh_rest" (n, k - 1, 3). `keep` and `extend` change the rows; moments follow their rows.
    """

    def __init__(self, tensors: Mapping[str, Tensor]) -> None:
        if set(tensors) != set(NAMES):
            raise ValueError(f"trainable Gaussians have {sorted(NAMES)}, not {sorted(tensors)}")
        self.tensors: dict[str, Tensor] = {name: _leaf(tensors[name]) for name in NAMES}
        self._first = {name: torch.zeros_like(each.detach()) for name, each in self.tensors.items()}
        self._second = {name: torch.zeros_like(each.detach()) for name, each in self.tensors.items()}
        self._steps: dict[str, int] = dict.fromkeys(NAMES, 0)

    @classmethod
    def from_gaussians(cls, gaussians: Gaussians, sh_degree: int, device: str = "cpu") -> "SplatParameters":
        """Start at given Gaussians; missing harmonics start at 0, those above `sh_degree` are dropped."""
        k = COEFFICIENTS_OF_DEGREE[sh_degree]
        sh = np.zeros((len(gaussians), k, 3), np.float64)
        shared = min(k, gaussians.sh.shape[1])
        sh[:, :shared] = gaussians.sh[:, :shared]
        opacities = np.clip(gaussians.opacities.astype(np.float64), _MIN_OPACITY, 1 - 2.0**-24)
        values = {
            "means": gaussians.means,
            "log_scales": np.log(np.maximum(gaussians.scales.astype(np.float64), _MIN_SCALE)),
            "quaternions": gaussians.quaternions,
            "opacity_logits": np.log(opacities) - np.log1p(-opacities),
            "sh_dc": sh[:, :1],
            "sh_rest": sh[:, 1:],
        }
        return cls({name: torch.tensor(each, dtype=torch.float32, device=device) for name, each in values.items()})

    def to_gaussians(self) -> Gaussians:
        """Return the current Gaussians, activated, in float32."""
        with torch.no_grad():
            quaternions = torch.nn.functional.normalize(self.tensors["quaternions"], dim=1)
            values = (self.tensors["means"], self.scales, quaternions, self.opacities, self.sh)
            return Gaussians(*map(_array, values))

    def to_means(self) -> Float32[np.ndarray, "n 3"]:
        """Return the current means in float32."""
        return _array(self.tensors["means"])

    def __len__(self) -> int:
        return len(self.tensors["means"])

    @property
    def device(self) -> Tensor:
        return self.tensors["means"].device

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return COEFFICIENTS_OF_DEGREE.index(1 + self.tensors["sh_rest"].shape[1])

    @property
    def scales(self) -> Tensor:
        """(n, 3) standard deviations, above 0."""
        return torch.exp(self.tensors["log_scales"])

    @property
    def opacities(self) -> Tensor:
        """(n,) in (0, 1)."""
        return torch.sigmoid(self.tensors["opacity_logits"])

    @property
    def sh(self) -> Tensor:
        """(n, k, 3) harmonics of all degrees."""
        return self.sh_up_to(self.sh_degree)

    def sh_up_to(self, degree: int) -> Tensor:
        """(n, k, 3) harmonics up to a degree; trainings enable higher degrees later."""
        rest = COEFFICIENTS_OF_DEGREE[min(degree, self.sh_degree)] - 1
        if not rest:
            return self.tensors["sh_dc"]
        return torch.cat([self.tensors["sh_dc"], self.tensors["sh_rest"][:, :rest]], dim=1)

    def zero_grad(self) -> None:
        for each in self.tensors.values():
            each.grad = None

    def step(self, learning_rates: Mapping[str, float], rows: Tensor | None = None) -> None:
        """Do one step of Adam (Kingma and Ba 2015) on every tensor that has a gradient and a learning rate.

        Tensors without a rate by name, or with 0, keep their values and moments. Only `rows` ((n,) bool) move, and only
        their moments change; None moves all: invisible rows then continue along their moments, as in 3DGS.
        """
        moving = [
            name
            for name, rate in learning_rates.items()
            if rate and self.tensors[name].grad is not None and self.tensors[name].numel()
        ]
        for name in moving:
            self._steps[name] += 1
        steps = [AdamStep.of(learning_rates[name], self._steps[name]) for name in moving]
        fours = [
            (self.tensors[name].detach(), self.tensors[name].grad, self._first[name], self._second[name])
            for name in moving
        ]
        if self.device.type != "cpu":
            fused_adam_step(fours, rows, steps)
            return
        mask = np.zeros(0, np.bool_) if rows is None else rows.numpy()
        for four, step in zip(fours, steps, strict=True):
            value, slope, mean, square = (each.contiguous().numpy().reshape(len(self), -1) for each in four)
            adam_step(value, slope, mean, square, mask, *step)

    def keep(self, rows: Tensor) -> None:
        """Keep these rows ((n,) bool, or indices in a new order) with their moments; gradients are cleared."""
        with torch.no_grad():
            for name in NAMES:
                self.tensors[name] = _leaf(self.tensors[name][rows])
                self._first[name] = self._first[name][rows]
                self._second[name] = self._second[name][rows]

    def extend(self, more: Mapping[str, Tensor]) -> None:
        """Append rows, given by the same names, with moments of 0; gradients are cleared."""
        with torch.no_grad():
            for name in NAMES:
                added = more[name].to(self.tensors[name])
                nothing = torch.zeros_like(added, requires_grad=False)
                self.tensors[name] = _leaf(torch.cat([self.tensors[name], added]))
                self._first[name] = torch.cat([self._first[name], nothing])
                self._second[name] = torch.cat([self._second[name], nothing])

    def rows(self, which: Tensor) -> dict[str, Tensor]:
        """Copies of some rows ((n,) bool, or indices) by name, without gradients."""
        return {name: each.detach()[which].clone() for name, each in self.tensors.items()}

    def put(self, name: str, which: Tensor, values: Tensor) -> None:
        """Overwrite rows ((n,) bool, or indices) of one tensor and reset their moments to 0."""
        with torch.no_grad():
            self.tensors[name][which] = values.to(self.tensors[name])
        self.forget_moments(which, (name,))

    def forget_moments(self, which: Tensor, names: tuple[str, ...] = NAMES) -> None:
        """Set the moments of rows ((n,) bool, or indices) to 0."""
        for name in names:
            self._first[name][which] = 0
            self._second[name][which] = 0

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Return the full training state as arrays, for a checkpoint."""
        arrays = {name: _copy(each) for name, each in self.tensors.items()}
        arrays |= {f"{name}.first": _copy(each) for name, each in self._first.items()}
        arrays |= {f"{name}.second": _copy(each) for name, each in self._second.items()}
        return arrays | {"steps": np.array([self._steps[name] for name in NAMES], np.int64)}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Restore the output of `state` exactly; raises KeyError if something is missing."""
        device = self.device
        self.tensors = {name: _leaf(torch.tensor(state[name], device=device)) for name in NAMES}
        self._first = {name: torch.tensor(state[f"{name}.first"], device=device) for name in NAMES}
        self._second = {name: torch.tensor(state[f"{name}.second"], device=device) for name in NAMES}
        self._steps = dict(zip(NAMES, state["steps"].tolist(), strict=True))


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().contiguous().requires_grad_(True)


def _array(tensor: Tensor) -> Float32[np.ndarray, "..."]:
    return np.ascontiguousarray(tensor.detach().cpu().to(torch.float32).numpy())


def _copy(tensor: Tensor) -> Shaped[np.ndarray, "..."]:
    return tensor.detach().cpu().numpy().copy()


def rotate_quaternions(turn: Float64[np.ndarray, "4"], quaternions: Tensor) -> Tensor:
    """(n, 4) products of a quaternion and others, wxyz."""
    w, x, y, z = turn.tolist()
    rows = [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
    return quaternions @ uploaded(np.array(rows), quaternions.device).to(quaternions.dtype).T


# Adam step on the CPU
# One pass over memory without allocations.

FIRST_DECAY, SECOND_DECAY, EPSILON = 0.9, 0.999, 1e-15
"""Decay of both moments, and epsilon (Kingma and Ba 2015; epsilon as in 3DGS)."""

_CHUNK = 4096


@kernel(parallel=True, error_model="numpy")
@no_type_check
def adam_step(portion, values, gradients, first, second, rows, rate, first_share, second_share):
    """Update `values` (n, c) and their moments in place; rows are independent.

    `gradients` are those of the loss with respect to `values`, `first` and `second` the running means of them and of
    their squares. Only `rows` ((n,) bool) are updated, all for an empty array. `first_share` is 1 - FIRST_DECAY **
    steps, the bias correction of the first moment; `second_share` likewise.
    """
    count, channels = values.shape
    kind = values.dtype.type
    first_decay, second_decay, epsilon = kind(FIRST_DECAY), kind(SECOND_DECAY), kind(EPSILON)
    one = kind(1)
    pace, spread = kind(rate / first_share), kind(1 / np.sqrt(second_share))
    everybody = len(rows) == 0
    for chunk in range_of(portion, (count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, count)):
            if everybody or rows[i]:
                for c in range(channels):
                    slope = gradients[i, c]
                    mean = first_decay * first[i, c] + (one - first_decay) * slope
                    square = second_decay * second[i, c] + (one - second_decay) * slope * slope
                    first[i, c] = mean
                    second[i, c] = square
                    values[i, c] -= pace * mean / (np.sqrt(square) * spread + epsilon)


# Adam step on a GPU
# Few kernels, since starting one takes longer than its work.


class AdamStep(NamedTuple):
    """Learning rate of one step, and the bias corrections of both moments."""

    rate: float
    first_share: float
    second_share: float

    @classmethod
    def of(cls, rate: float, steps: int) -> "AdamStep":
        """Values of the step with this number, counted from 1."""
        return cls(rate, 1 - FIRST_DECAY**steps, 1 - SECOND_DECAY**steps)


def fused_adam_step(
    fours: Sequence[tuple[Tensor, Tensor, Tensor, Tensor]], rows: Tensor | None, steps: Sequence[AdamStep]
) -> None:
    """Do a step with one kernel for each tensor, gsplat's Adam for some rows (Mallick et al. 2024), if there is one.

    That kernel has no bias corrections: they are in its learning rate and epsilon. Arguments are those of
    `foreach_adam_step`, which does the step without it.
    """
    fused = _gsplat_adam()
    if fused is None or not fours:
        foreach_adam_step(fours, rows, steps)
        return
    with torch.no_grad():
        count, device = len(fours[0][0]), fours[0][0].device
        moving = torch.ones(count, dtype=torch.bool, device=device) if rows is None else rows
        for (values, gradients, first, second), step in zip(fours, steps, strict=True):
            spread = step.second_share**0.5
            pace = step.rate * spread / step.first_share
            fused(
                values, gradients.contiguous(), first, second, moving, pace, FIRST_DECAY, SECOND_DECAY, EPSILON * spread
            )


def _gsplat_adam() -> Callable[..., None] | None:
    """Function of gsplat 1.5's SelectiveAdam; None without gsplat, or in a version without it."""
    try:
        return import_module("gsplat.cuda._wrapper").adam
    except (ImportError, AttributeError):
        return None


def foreach_adam_step(
    fours: Sequence[tuple[Tensor, Tensor, Tensor, Tensor]], rows: Tensor | None, steps: Sequence[AdamStep]
) -> None:
    """Do the same on any device for several tensors at once, without waiting for it.

    Each of `fours` has values, gradients, first and second moments with n rows; only `rows` ((n,) bool) change, all for
    None.
    """
    if not fours:
        return
    with torch.no_grad():
        values, gradients, first, second = (list(each) for each in zip(*fours, strict=True))
        moved = first
        if rows is None:
            torch._foreach_lerp_(first, gradients, 1 - FIRST_DECAY)
            torch._foreach_mul_(second, SECOND_DECAY)
            torch._foreach_addcmul_(second, gradients, gradients, 1 - SECOND_DECAY)
        else:
            flags = rows.to(values[0].dtype)
            first_weights, second_weights = (1 - FIRST_DECAY) * flags, (1 - SECOND_DECAY) * flags
            squares = torch._foreach_mul(gradients, gradients)
            for mean, slope, square, new in zip(first, gradients, second, squares, strict=True):
                shape = (-1, *[1] * (mean.ndim - 1))
                mean.lerp_(slope, first_weights.view(shape))
                square.lerp_(new, second_weights.view(shape))
            moved = [mean * flags.view(-1, *[1] * (mean.ndim - 1)) for mean in first]
        spreads = [step.second_share**0.5 for step in steps]
        scale = torch._foreach_sqrt(second)
        torch._foreach_add_(scale, [EPSILON * spread for spread in spreads])
        paces = [-step.rate * spread / step.first_share for step, spread in zip(steps, spreads, strict=True)]
        torch._foreach_addcdiv_(values, moved, scale, paces)


# Selection of rows


def indices_of(*masks: Tensor) -> list[Tensor]:
    """(m,) rising indices of the set elements of each (n,) bool mask; waits for their device once, to count them."""
    if masks[0].device.type == "cpu":
        return [torch.nonzero(mask)[:, 0] for mask in masks]
    counts = torch.stack([mask.sum() for mask in masks]).tolist()
    orders = (torch.argsort(mask.to(torch.uint8), descending=True, stable=True) for mask in masks)
    return [order[:count] for order, count in zip(orders, counts, strict=True)]

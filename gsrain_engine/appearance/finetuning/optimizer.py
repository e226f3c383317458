"""AdamW over named parameters, with clipping and a warm-up that counts iterations, and all of its state by name."""

from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any

from .settings import OptimizerSettings

torch: Any = import_module("torch")

Parameter = Any

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class DivergedError(ValueError):
    """A training has come apart: a gradient is no number any more."""


class NamedOptimizer:
    """One AdamW. Parameters in `decaying` are pulled towards nothing, those in `held` are not."""

    def __init__(
        self,
        settings: OptimizerSettings,
        rate: float,
        decaying: Mapping[str, Parameter],
        held: Mapping[str, Parameter] | None = None,
    ) -> None:
        self.parameters = {**decaying, **(held or {})}
        self._rate, self._warmup, self._clip = rate, settings.warmup_steps, settings.clip_norm
        groups = [{"params": list(decaying.values())}, {"params": list((held or {}).values()), "weight_decay": 0.0}]
        self._adam = torch.optim.AdamW(
            [group for group in groups if group["params"]],
            lr=rate,
            betas=(settings.beta_1, settings.beta_2),
            eps=settings.epsilon,
            weight_decay=settings.weight_decay,
            fused=True,  # one pass over hundreds of small tensors
        )

    def begin(self) -> None:
        self._adam.zero_grad(set_to_none=True)

    def step(self, iteration: int) -> float:
        """Clip, move, and forget the gradients; returns the gradient's length before clipping.

        The rate follows from the iteration alone, however many of its steps an iteration takes: the published code
        moved its schedule on with each of them. Raises `DivergedError` where the gradient is no number: nothing has
        moved then.
        """
        for group in self._adam.param_groups:
            group["lr"] = self._rate * min(1.0, (iteration + 1) / max(self._warmup, 1))
        length = float(torch.nn.utils.clip_grad_norm_(self.parameters.values(), self._clip))
        if not length < float("inf"):
            raise DivergedError(
                f"iteration {iteration + 1}: the gradient's length is {length}; lower the rate, and start from the "
                "weights that were saved last"
            )
        self._adam.step()
        self.begin()
        return length

    def state(self) -> dict[str, Any]:
        """Return all moments, on the processor, as "moment:parameter"; nothing before the first step."""
        return {
            f"{moment}:{name}": self._adam.state[parameter][moment].detach().cpu().clone()
            for name, parameter in self.parameters.items()
            if parameter in self._adam.state
            for moment in _MOMENTS
        }

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Put back what `state` returned; raises KeyError where a part of a parameter's moments is missing."""
        self._adam.state.clear()
        for name, parameter in self.parameters.items():
            if f"step:{name}" not in arrays:
                continue
            moments = {moment: arrays[f"{moment}:{name}"] for moment in _MOMENTS}
            self._adam.state[parameter] = {
                "step": moments["step"].to(parameter.device).clone(),
                "exp_avg": moments["exp_avg"].to(parameter).clone(),
                "exp_avg_sq": moments["exp_avg_sq"].to(parameter).clone(),
            }


def held_still(modules: Iterable[Any], still: bool) -> None:
    """Let gradients pass through modules without leaving any in them, or end that."""
    for module in modules:
        module.requires_grad_(not still)

"""Density control: the base class of strategies and the default strategy of 3DGS."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Shaped

from .parameters import SplatParameters, Tensor, indices_of

torch: Any = import_module("torch")


class Strategy:
    """Changes the number of Gaussians during training; this base class changes none.

    The training calls `observe` after each backward pass and `adapt` after each step of the optimizer, with the same
    step number (from 0). All randomness comes from the generator, which is on the Gaussians' device.
    """

    def observe(self, step: int, rendered: Any, rows: slice | Tensor = slice(None)) -> None:
        """Record statistics of the `Rendered` of `render_gaussians`; `rows` of it are under control, in their order."""

    def adapt(self, step: int, parameters: SplatParameters, generator: Tensor) -> str | None:
        """Change Gaussians if due at this step; returns a short summary of the change, or None."""

    def regularization(self, parameters: SplatParameters) -> Tensor | None:
        """Return a term to add to each step's loss, or None."""

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Return the statistics since the last change as arrays, for a checkpoint."""
        return {}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Restore the output of `state`."""


# Density control of 3DGS
# Clone small, split large, prune invisible Gaussians (Kerbl et al. 2023).

_CHILDREN = 2
_SHRINK = 0.8 * _CHILDREN  # A child's scale is its parent's over 1.6 (Kerbl et al. 2023, section 5.2).


@dataclass(frozen=True, slots=True, kw_only=True)
class DefaultStrategySettings:
    """Schedule and thresholds of density control; defaults are those of 3DGS for 30,000 steps."""

    extent: float
    """Radius of the relevant scene around the cameras' center, in scene units."""
    max_count: int
    """Maximum number of Gaussians; under this limit the highest gradients are served first."""
    first_step: int = 500
    last_step: int = 15_000
    every: int = 100
    """Steps between two changes."""
    gradient: float = 2e-4
    """Mean loss gradient of a center, in normalized device units (2 across the image), that triggers growth."""
    split_from: float = 0.01
    """Gaussians larger than this share of the extent are split, smaller ones cloned."""
    min_opacity: float = 0.005
    split_on_screen: float = 0.08
    """Share of the image's longer side from which a radius triggers a split, regardless of the gradient."""
    largest: float = 0.1
    """Largest scale as a share of the extent, enforced after opacities were reset."""
    largest_on_screen: float = 0.15
    """Largest radius as a share of the image's longer side, enforced after opacities were reset."""
    reset_every: int = 3000
    """Steps between two resets of opacity, 0 for none."""
    reset_to: float = 0.01

    @classmethod
    def for_run(cls, steps: int, extent: float, max_count: int) -> "DefaultStrategySettings":
        """Scale the schedule of 30,000 steps to a run of `steps`.

        Opacities need a few hundred steps to recover from a reset: runs of less than 2,000 steps have none.
        """
        share = min(steps / 30_000, 1.0)
        return cls(
            extent=extent,
            max_count=max_count,
            first_step=max(round(500 * share), 30),
            last_step=round(15_000 * share),
            every=max(round(100 * share), 25),
            reset_every=max(round(3000 * share), 1000),
        )


class DefaultStrategy(Strategy):
    """Clones, splits and prunes by the screen-space gradients of the centers."""

    def __init__(self, settings: DefaultStrategySettings) -> None:
        self._settings = settings
        self._notes: dict[str, Tensor] = {}

    def observe(self, step: int, rendered: Any, rows: slice | Tensor = slice(None)) -> None:
        """Accumulate the loss gradient of each center, in normalized device units."""
        height, width = rendered.alpha.shape
        drawn = rendered.footprint.drawn[rows]
        if len(self._notes.get("count", ())) != len(drawn):
            zeros = torch.zeros((3, len(drawn)), device=drawn.device)
            self._notes = dict(zip(("pull", "count", "radius"), zeros.unbind(), strict=True))
        if self._notes["count"].device != drawn.device:  # restored
            self._notes = {name: each.to(drawn.device) for name, each in self._notes.items()}
        half = 0.5 * float(np.sqrt(width * height))
        self._notes["pull"].add_(rendered.footprint.screen_gradients[rows], alpha=half)  # 0 where not drawn
        self._notes["count"] += drawn
        radius = (rendered.footprint.radii_px[rows] / max(width, height)).float()
        torch.maximum(self._notes["radius"], radius, out=self._notes["radius"])

    def adapt(self, step: int, parameters: SplatParameters, generator: Tensor) -> str | None:
        """Grow and prune periodically, and reset opacities at intervals."""
        s = self._settings
        done = ""
        due = s.first_step <= step < s.last_step and step % s.every == 0
        if due and len(self._notes.get("count", ())) == len(parameters):
            with torch.no_grad():
                done = self._change(step, parameters, generator)
            self._notes = {}
        if s.reset_every and 0 < step < s.last_step and step % s.reset_every == 0:
            # All become nearly transparent, so that floaters near the cameras have to regain their opacity.
            highest = float(np.log(s.reset_to / (1 - s.reset_to)))
            lowered = parameters.tensors["opacity_logits"].detach().clamp(max=highest)
            parameters.put("opacity_logits", slice(None), lowered)
            done = f"{done}, opacities reset" if done else "opacities reset"
        return done or None

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return {name: each.cpu().numpy().copy() for name, each in self._notes.items()}

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        self._notes = {name: torch.tensor(each) for name, each in state.items()}

    def _change(self, step: int, parameters: SplatParameters, generator: Tensor) -> str:
        s = self._settings
        gradients = self._notes["pull"] / self._notes["count"].clamp(min=1)
        size = parameters.scales.amax(dim=1)
        gone = parameters.opacities < s.min_opacity
        if s.reset_every and step > s.reset_every:
            gone |= (size > s.largest * s.extent) | (self._notes["radius"] > s.largest_on_screen)
        room = s.max_count - len(parameters) + gone.sum()
        wide = self._notes["radius"] > s.split_on_screen
        growing = _highest(((gradients >= s.gradient) | wide) & ~gone, gradients + wide * gradients.max(), room)
        large = (size > s.split_from * s.extent) | wide
        split = growing & large
        cloned, parents, kept, pruned = indices_of(growing & ~large, split, ~(gone | split), gone)
        more = [parameters.rows(cloned), _children(parameters.rows(parents), generator)]
        parameters.keep(kept)
        parameters.extend({name: torch.cat([each[name] for each in more]) for name in more[0]})
        return f"{len(cloned)} cloned, {len(parents)} split, {len(pruned)} pruned"


def _highest(candidates: Tensor, gradients: Tensor, room: Tensor) -> Tensor:
    """The `room` candidates with the highest gradients (each adds one); ties by index."""
    order = torch.argsort(torch.where(candidates, gradients, -1), descending=True, stable=True)
    fits = torch.arange(len(candidates), device=candidates.device) < room
    return candidates & torch.zeros_like(candidates).scatter_(0, order, fits)


def _children(parents: dict[str, Tensor], generator: Tensor) -> dict[str, Tensor]:
    """Two children per parent, drawn from its own distribution, smaller by 1.6."""
    rows = {name: each.repeat((_CHILDREN,) + (1,) * (each.dim() - 1)) for name, each in parents.items()}
    means = rows["means"]
    noise = torch.randn(means.shape, generator=generator, device=means.device, dtype=means.dtype)
    rows["means"] = means + rotate_vectors(rows["quaternions"], noise * torch.exp(rows["log_scales"]))
    rows["log_scales"] = rows["log_scales"] - float(np.log(_SHRINK))
    return rows


def rotate_vectors(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """(n, 3) vectors rotated by quaternions (n, 4) wxyz of any length."""
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    turn = 2 * torch.linalg.cross(axis, vectors)
    return vectors + w * turn + torch.linalg.cross(axis, turn)

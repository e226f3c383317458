"""3DGS-MCMC density control (Kheradmand et al. 2024): relocates dead Gaussians, adds new ones, adds position noise."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from scipy.special import comb

from ..render.gsplat_input import uploaded
from .parameters import SplatParameters, Tensor, indices_of
from .strategy import Strategy, rotate_vectors

torch: Any = import_module("torch")
_STILL = 0.25  # opacity above which no noise is applied; its factor is below 1e-10 there
_STEEPNESS, _MIDDLE = 100.0, 0.995
"""Of the logistic of transparency that scales the noise (Kheradmand et al. 2024, section 3.2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MCMCSettings:
    """Schedule and strength of relocation and noise; defaults are the paper's for 30,000 steps."""

    max_count: int
    means_rate: Callable[[int], float]
    """Learning rate of the means at a step; scales the noise."""
    first_step: int = 500
    last_step: int = 25_000
    every: int = 100
    """Steps between two changes."""
    growth: float = 0.05
    """Share of the current number that is added at each change."""
    dead_below: float = 0.005
    """Opacity at or below which a Gaussian is dead."""
    noise: float = 5e5
    """Strength of the noise over the learning rate of the means."""
    opacity_weight: float = 0.01
    scale_weight: float = 0.01

    @classmethod
    def for_run(cls, steps: int, max_count: int, means_rate: Callable[[int], float]) -> "MCMCSettings":
        """Scale the paper's schedule of 30,000 steps to a run of `steps`."""
        share = min(steps / 30_000, 1.0)
        return cls(
            max_count=max_count,
            means_rate=means_rate,
            first_step=max(round(500 * share), 30),
            last_step=round(25_000 * share),
            every=max(round(100 * share), 25),
        )


class MCMCStrategy(Strategy):
    """Treats Gaussians as samples of the scene: their number grows to a cap and none are pruned."""

    def __init__(self, settings: MCMCSettings) -> None:
        self._settings = settings

    def adapt(self, step: int, parameters: SplatParameters, generator: Tensor) -> str | None:
        s = self._settings
        done = None
        with torch.no_grad():
            if s.first_step <= step < s.last_step and step % s.every == 0:
                moved = self._relocate(parameters, generator)
                added = self._add(parameters, generator)
                done = f"{moved} relocated, {added} added"
            self._shake(parameters, s.means_rate(step) * s.noise, generator)
        return done

    def regularization(self, parameters: SplatParameters) -> Tensor | None:
        """L1 of opacities and scales, so that unneeded Gaussians fade (section 3.3)."""
        s = self._settings
        return s.opacity_weight * parameters.opacities.mean() + s.scale_weight * parameters.scales.mean()

    def _relocate(self, parameters: SplatParameters, generator: Tensor) -> int:
        """Move dead Gaussians onto live ones drawn by opacity, preserving the rendered image (eq. 9)."""
        opacities = parameters.opacities
        dead, alive = indices_of(opacities <= self._settings.dead_below, opacities > self._settings.dead_below)
        if not len(dead) or not len(alive):
            return 0
        sources = alive[_drawn_by_opacity(opacities[alive], len(dead), generator)]
        for name, values in self._shared_out(parameters, sources).items():
            parameters.put(name, dead, values)
        return len(dead)

    def _add(self, parameters: SplatParameters, generator: Tensor) -> int:
        count = min(self._settings.max_count - len(parameters), int(self._settings.growth * len(parameters)))
        if count <= 0:
            return 0
        sources = _drawn_by_opacity(parameters.opacities, count, generator)
        parameters.extend(self._shared_out(parameters, sources))
        return count

    def _shared_out(self, parameters: SplatParameters, sources: Tensor) -> dict[str, Tensor]:
        """Shrink each source for its new copies, clear its moments, and return the copies' rows."""
        copies = torch.ones(len(parameters), dtype=torch.int64, device=sources.device)
        copies.index_add_(0, sources, torch.ones_like(sources))
        (touched,) = indices_of(copies > 1)
        opacities, shrink = relocation_factors(parameters.opacities[touched], copies[touched])
        opacities = opacities.clamp(min=self._settings.dead_below)
        scales = parameters.scales[touched] * shrink[:, None]
        parameters.put("opacity_logits", touched, torch.logit(opacities))
        parameters.put("log_scales", touched, torch.log(scales))
        parameters.forget_moments(touched)
        return parameters.rows(sources)

    def _shake(self, parameters: SplatParameters, strength: float, generator: Tensor) -> None:
        """Add Langevin noise to the means, shaped by each covariance, where opacity is small (eq. 8)."""
        if not strength:
            return
        opacities = parameters.opacities
        faint = opacities < _STILL
        # The processor skips opaque rows; on a GPU all are drawn, since counting them would wait for it.
        rows = torch.nonzero(faint)[:, 0] if opacities.device.type == "cpu" else slice(None)
        chosen = opacities[rows]
        if not len(chosen):
            return
        noise = torch.randn((len(chosen), 3), generator=generator, device=chosen.device, dtype=chosen.dtype)
        factor = torch.sigmoid(_STEEPNESS * (1 - chosen - _MIDDLE))[:, None] * strength
        turn = parameters.tensors["quaternions"][rows]
        back = torch.cat([turn[:, :1], -turn[:, 1:]], dim=1)
        inside = rotate_vectors(back, noise) * parameters.scales[rows] ** 2
        moves = factor * rotate_vectors(turn, inside)
        parameters.tensors["means"][rows] += torch.where(faint[rows][:, None], moves, 0)


def _drawn_by_opacity(opacities: Tensor, count: int, generator: Tensor) -> Tensor:
    """(count,) indices drawn with replacement, with probability proportional to opacity."""
    ends = torch.cumsum(opacities.double(), 0)
    at = torch.rand(count, generator=generator, device=ends.device, dtype=torch.float64) * ends[-1]
    return torch.searchsorted(ends, at, right=True).clamp(max=len(opacities) - 1)


# Relocation factors

MAX_COPIES = 51  # larger counts are clamped to this, as in the authors' code: the sums lose precision beyond
_N, _K = np.ogrid[: MAX_COPIES + 1, :MAX_COPIES]
_TERMS = comb(_N, _K + 1) * (-1.0) ** _K / np.sqrt(_K + 1)
"""Coefficients (-1)^k C(N, k + 1) / sqrt(k + 1): the double sum of eq. 9, summed over its first index."""


def relocation_factors(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity and scale factor of each of N equal Gaussians that replace one (Kheradmand et al. 2024, eq. 9).

    The stack keeps the original's opacity at the center and its integral along a line through it. `opacities` (n,) are
    those of the originals, `copies` (n,) the numbers after the change, originals included.
    """
    count = copies.clamp(max=MAX_COPIES)
    old = opacities.double()
    new = 1 - (1 - old) ** (1 / count.double())
    terms = uploaded(_TERMS, old.device)[count]
    powers = new[:, None] ** torch.arange(1, MAX_COPIES + 1, device=old.device)
    factor = old / (terms * powers).sum(dim=1)
    return new.to(opacities.dtype), factor.to(opacities.dtype)

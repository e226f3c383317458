"""What changes while a training runs: learning rates, the size of the pictures, the degree of the harmonics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsrain_engine.datasets.capture import View

from .settings import TrainingSettings

LEVELS = 3
"""Sizes that pictures are learned at: whole, a half, a quarter."""

_EXTENT_MARGIN = 1.1
_TRANSIENTS_FROM = 0.25
"""Share of the steps after which it shows what contradicts the other pictures; later it is learned by heart."""
_DEGREE_SHARE = 0.2
"""Share of the steps after which each further degree of the harmonics joins in."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Rates, size and degree by step."""

    settings: TrainingSettings
    extent: float
    """How far the cameras are spread, in the capture's unit: what the paper scales steps of the means by."""

    def rates(self, step: int) -> dict[str, float]:
        """Learning rate of each tensor at a step, counted from 0."""
        rates, haste = self.settings.rates, self.settings.haste
        done = step / max(self.settings.steps - 1, 1)
        means = float(np.exp((1 - done) * np.log(rates.means) + done * np.log(rates.last_means)))
        return {
            "means": haste * means * self.extent,
            "log_scales": haste * rates.log_scales,
            "quaternions": haste * rates.quaternions,
            "opacity_logits": haste * rates.opacity_logits,
            "sh_dc": haste * rates.sh_dc * self._settling(done),
            "sh_rest": haste * rates.sh_rest * self._settling(done),
        }

    def level(self, step: int) -> int:
        """How often pictures are halved at a step: 2, 1, 0."""
        coarse_steps = self.settings.coarse * self.settings.steps
        if step >= coarse_steps:
            return 0
        return 2 if step < coarse_steps / 2 else 1

    def sh_degree(self, step: int) -> int:
        """Degree of the harmonics that are learned at a step: one more after each fifth of the steps."""
        return min(self.settings.sh_degree, int(step / (_DEGREE_SHARE * self.settings.steps)))

    def leaves_out(self, step: int) -> bool:
        """Whether pixels that contradict the others are left out: not before the scene is roughly there."""
        return self.settings.transients > 0 and step >= _TRANSIENTS_FROM * self.settings.steps

    def _settling(self, done: float) -> float:
        """Let colours come to rest in the last third: a short run has no time to average its noise away."""
        return float(np.clip(1 - (done - 2 / 3) * 3 * 0.9, 0.1, 1))


def camera_extent(views: Sequence[View]) -> float:
    """Largest distance of a camera from the middle of all, a tenth more; at least 1 (Kerbl et al. 2023, their code)."""
    places = np.array([view.camera.position for view in views])
    spread = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    return max(_EXTENT_MARGIN * spread, 1.0)


def view_order(count: int, steps: int, seed: int) -> list[int]:
    """Which view each step learns from: every view once an epoch, each epoch in an order of its own."""
    epochs = range(-(-steps // count))
    shuffled = [np.random.default_rng([seed, epoch]).permutation(count) for epoch in epochs]
    return np.concatenate(shuffled)[:steps].tolist()

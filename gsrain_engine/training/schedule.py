"""Training schedule: learning rates, image sizes, harmonics and the order of views by step."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets.capture import CaptureFrame
from .settings import TrainingSettings

LEVELS = 3  # number of image sizes: full, half and quarter
_TRANSIENTS_FROM = 0.25
"""Share of the steps from which transients are masked: earlier the scene is too rough, later it has overfitted them."""

_DEGREE_SHARE = 0.2  # share of the steps after which each further degree of the harmonics is enabled


@dataclass(frozen=True, slots=True)
class TrainingSchedule:
    """Learning rates, image size and SH degree by step."""

    settings: TrainingSettings
    extent: float
    """Spread of the cameras in the capture's unit; scales the learning rate of the means."""

    def rates(self, step: int) -> dict[str, float]:
        """Learning rate of each tensor at a step, counted from 0."""
        rates, haste = self.settings.rates, self.settings.haste
        done = step / max(self.settings.steps - 1, 1)
        means = float(np.exp((1 - done) * np.log(rates.means) + done * np.log(rates.last_means)))
        # Colors settle in the last third: short runs have no time to average out noise.
        settling = float(np.clip(1 - (done - 2 / 3) * 3 * 0.9, 0.1, 1))
        return {
            "means": haste * means * self.extent,
            "log_scales": haste * rates.log_scales,
            "quaternions": haste * rates.quaternions,
            "opacity_logits": haste * rates.opacity_logits,
            "sh_dc": haste * rates.sh_dc * settling,
            "sh_rest": haste * rates.sh_rest * settling,
        }

    def level(self, step: int) -> int:
        """Number of times images are halved at a step: 2, 1, 0."""
        coarse_steps = self.settings.coarse * self.settings.steps
        if step >= coarse_steps:
            return 0
        return 2 if step < coarse_steps / 2 else 1

    def sh_degree(self, step: int) -> int:
        """Degree of the trained harmonics at a step: one more after each fifth of the steps."""
        return min(self.settings.sh_degree, int(step / (_DEGREE_SHARE * self.settings.steps)))

    def leaves_out(self, step: int) -> bool:
        """True if pixels that contradict other images are masked at this step."""
        return self.settings.transients > 0 and step >= _TRANSIENTS_FROM * self.settings.steps


def camera_extent(views: Sequence[CaptureFrame]) -> float:
    """Largest distance of a camera from their mean plus 10 %, at least 1 (Kerbl et al. 2023, their code)."""
    places = np.array([view.camera.position for view in views])
    spread = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    return max(1.1 * spread, 1.0)


def view_order(count: int, steps: int, seed: int) -> list[int]:
    """View index of each step: every view once per epoch, reshuffled for each epoch."""
    shuffled = [np.random.default_rng([seed, epoch]).permutation(count) for epoch in range(-(-steps // count))]
    return np.concatenate(shuffled)[:steps].tolist()

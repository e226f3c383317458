"""How a training went: loss and number of Gaussians by step, held-out quality now and then."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Shaped


@dataclass(eq=False)
class TrainingCurves:
    """Grows while the training runs."""

    losses: list[float] = field(default_factory=list[float])
    counts: list[int] = field(default_factory=list[int])
    """Gaussians after each step."""
    seconds: list[float] = field(default_factory=list[float])
    """Since the training began, at the end of each step."""
    measured_steps: list[int] = field(default_factory=list[int])
    """How many steps were done when held-out views were looked at."""
    measured_db: list[float] = field(default_factory=list[float])
    """Their mean PSNR, as rendered."""

    def add(self, loss: float, count: int, seconds: float) -> None:
        self.losses.append(loss)
        self.counts.append(count)
        self.seconds.append(seconds)

    def measured(self, steps: int, psnr_db: float) -> None:
        """Take in a look at the held-out views."""
        self.measured_steps.append(steps)
        self.measured_db.append(psnr_db)

    def recent_loss(self, steps: int = 50) -> float:
        """Mean loss of the last steps: single ones differ as their views do."""
        return float(np.mean(self.losses[-steps:])) if self.losses else float("nan")

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return {f"curves:{name}": np.array(values, np.float64) for name, values in vars(self).items()}

    @classmethod
    def restored(cls, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> "TrainingCurves":
        """Return what `state` was taken of."""
        curves = cls()
        for name, values in vars(curves).items():
            kind = int if name in ("counts", "measured_steps") else float
            values.extend(kind(each) for each in arrays[f"curves:{name}"])
        return curves

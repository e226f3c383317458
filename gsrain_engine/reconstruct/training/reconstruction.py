"""What a reconstruction came to: figures, curves and pictures."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from gsrain_engine.datasets.capture import Capture

from .curves import TrainingCurves
from .held_out import Score, mean_of
from .settings import TrainingSettings
from .start import OwnBody


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPicture:
    """A render beside its photograph."""

    score: Score
    rendered: Float32[np.ndarray, "h w 3"]
    truth: UInt8[np.ndarray, "h w 3"]
    seen: Bool[np.ndarray, "h w"] | None
    """Pixels that count; None means all."""
    is_held_out: bool


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """What came out, and how it was made."""

    capture: Capture
    settings: TrainingSettings
    gaussians: int
    seconds: float
    """From the first picture read to the last step; over all runs where it was resumed."""
    curves: TrainingCurves
    before: tuple[Score, ...]
    """Held-out views before the first step."""
    pictures: tuple[MeasuredPicture, ...]
    """All held-out views, and some that were learned from."""
    seconds_by_stage: dict[str, float]
    own_body: OwnBody

    @property
    def held_out(self) -> list[Score]:
        """Scores of the views that the training never saw."""
        return [each.score for each in self.pictures if each.is_held_out]

    @property
    def learned(self) -> list[Score]:
        return [each.score for each in self.pictures if not each.is_held_out]

    @property
    def numbers(self) -> dict[str, Any]:
        """The figures that a command reports; None where nothing was held out."""
        return {
            "seconds": self.seconds,
            "gaussians": self.gaussians,
            "psnr_before_db": mean_of(self.before, "psnr_db"),
            "psnr_held_out_db": mean_of(self.held_out, "psnr_db"),
            "psnr_held_out_exposed_db": mean_of(self.held_out, "psnr_exposed_db"),
            "ssim_held_out": mean_of(self.held_out, "ssim"),
            "lpips_held_out": mean_of(self.held_out, "lpips"),
            "psnr_learned_db": mean_of(self.learned, "psnr_db"),
            "views": len(self.capture),
            "held_out": [asdict(each) for each in self.held_out],
            "steps": len(self.curves.losses),
            "seconds_by_stage": self.seconds_by_stage,
            "own_body": {
                "searched": self.own_body.searched,
                "reason": self.own_body.reason,
                "shares": dict(self.own_body.shares),
            },
            "problems": list(self.capture.problems),
        }

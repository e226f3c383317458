"""Held-out views: selection, render scores and training curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Shaped, UInt8

from ..evaluation.image_metrics import Image, ImageDistance, Mask, fitted_affine, psnr, ssim, with_affine


@dataclass(frozen=True, slots=True)
class RenderScore:
    """Similarity of one render to its ground truth."""

    name: str
    psnr_db: float
    """As rendered, over all valid pixels."""
    ssim: float
    psnr_exposed_db: float
    """Over the right half, after an affine color map fitted on the left half: independent of the image's exposure."""
    lpips: float | None = None
    """As rendered; None without weights."""


def validation_indices(names: Sequence[str], every: int, named: Sequence[str] = ()) -> list[int]:
    """Held-out views: the named ones, else every `every`-th; raises ValueError if one is unknown or no view remains."""
    if named:
        missing = sorted(set(named) - set(names))
        if missing:
            raise ValueError(f"held_out_views: no view is named {missing[0]!r}; the first is {names[0]!r}")
        chosen = [index for index, name in enumerate(names) if name in set(named)]
    else:
        chosen = list(range(every // 2, len(names), every)) if every else []
    if len(chosen) >= len(names):
        raise ValueError(f"held_out: all {len(names)} views would be held out, none is left to learn from")
    return chosen


def score(
    name: str, rendered: Image, image: UInt8[np.ndarray, "h w 3"], mask: Mask | None, lpips: ImageDistance | None = None
) -> RenderScore:
    """Measure a render against its ground truth over the pixels of a mask."""
    rendered, truth = np.clip(rendered, 0, 1), image.astype(np.float32) / 255
    whole = np.ones(image.shape[:2], bool) if mask is None else mask
    middle = image.shape[1] // 2
    left = whole.copy()
    left[:, middle:] = False
    exposed = with_affine(rendered, fitted_affine(rendered, truth, left))
    psnr_exposed_db = psnr(exposed[:, middle:], truth[:, middle:], whole[:, middle:])
    distance = None if lpips is None else lpips(rendered, truth, mask)
    return RenderScore(name, psnr(rendered, truth, whole), ssim(rendered, truth, mask), psnr_exposed_db, distance)


def mean_of(scores: Sequence[RenderScore], field: str) -> float | None:
    """Mean of one score over views; None if no view has it."""
    values = [value for each in scores if (value := getattr(each, field)) is not None]
    return float(np.mean(values)) if values else None


# Training curves


@dataclass(eq=False)
class TrainingCurves:
    """Loss and number of Gaussians by step, and the periodic held-out PSNR."""

    losses: list[float] = field(default_factory=list[float])
    counts: list[int] = field(default_factory=list[int])
    seconds: list[float] = field(default_factory=list[float])
    """Since the start of training, at the end of each step."""
    measured_steps: list[int] = field(default_factory=list[int])
    """Number of steps done at each held-out evaluation."""
    measured_db: list[float] = field(default_factory=list[float])
    """Mean PSNR of the held-out views, as rendered."""

    def add(self, loss: float, count: int, seconds: float) -> None:
        self.losses.append(loss)
        self.counts.append(count)
        self.seconds.append(seconds)

    def measured(self, steps: int, psnr_db: float) -> None:
        self.measured_steps.append(steps)
        self.measured_db.append(psnr_db)

    def recent_loss(self, steps: int = 50) -> float:
        """Mean loss of the last steps; single losses vary with their views."""
        return float(np.mean(self.losses[-steps:])) if self.losses else float("nan")

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return {f"curves:{name}": np.array(values, np.float64) for name, values in vars(self).items()}

    @classmethod
    def restored(cls, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> "TrainingCurves":
        curves = cls()
        for name, values in vars(curves).items():
            kind = int if name in ("counts", "measured_steps") else float
            values.extend(kind(each) for each in arrays[f"curves:{name}"])
        return curves

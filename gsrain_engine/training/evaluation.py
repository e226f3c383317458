"""Views that training never sees: which they are, and how close renders come to them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt8

from ..evaluation.image_metrics import fitted_affine, psnr, ssim, with_affine


@runtime_checkable
class PerceptualMetric(Protocol):
    """A learned distance of pictures: LPIPS."""

    def distance(
        self,
        rendered: Float32[np.ndarray, "h w 3"],
        truth: Float32[np.ndarray, "h w 3"],
        mask: Bool[np.ndarray, "h w"] | None = None,
    ) -> float:
        """Distance of two pictures of 0..1 over the pixels of a mask; 0 for equal ones."""
        ...


@dataclass(frozen=True, slots=True)
class RenderScore:
    """How close one render is to its photograph."""

    name: str
    psnr_db: float
    """As rendered, over all pixels that count."""
    ssim: float
    psnr_exposed_db: float
    """Over the right half only, after an affine map of colour that was fitted on the left half: what remains when the
    picture's own exposure is not held against the scene."""
    lpips: float | None = None
    """As rendered; None without weights."""


def validation_indices(names: Sequence[str], every: int, named: Sequence[str] = ()) -> list[int]:
    """Which views are kept for measuring: the named ones, else every so-many-th, from the middle of the first stretch.

    Raises ValueError for a name that no view has, and where nothing would be left to learn from.
    """
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
    name: str,
    rendered: Float32[np.ndarray, "h w 3"],
    image: UInt8[np.ndarray, "h w 3"],
    mask: Bool[np.ndarray, "h w"] | None,
    perceived: PerceptualMetric | None = None,
) -> RenderScore:
    """Measure a render against a photograph, over the pixels of a mask."""
    rendered, truth = np.clip(rendered, 0, 1), image.astype(np.float32) / 255
    whole = np.ones(image.shape[:2], bool) if mask is None else mask
    middle = image.shape[1] // 2
    left = whole.copy()
    left[:, middle:] = False
    exposed = with_affine(rendered, fitted_affine(rendered, truth, left))
    return RenderScore(
        name,
        psnr(rendered, truth, whole),
        ssim(rendered, truth, mask),
        psnr(exposed[:, middle:], truth[:, middle:], whole[:, middle:]),
        None if perceived is None else perceived.distance(rendered, truth, mask),
    )


def mean_of(scores: Sequence[RenderScore], field: str) -> float | None:
    """Mean of one figure over views; None where there is none."""
    values = [getattr(each, field) for each in scores if getattr(each, field) is not None]
    return float(np.mean(values)) if values else None


# § How a training went: loss and number of Gaussians by step, held-out quality now and then.


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

"""Views that training never sees: which they are, and how close renders come to them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from gsrain_engine.evaluate.image_metrics import psnr, ssim

from ..color_affine import fitted_affine, with_affine


@runtime_checkable
class Perceived(Protocol):
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
class Score:
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


def held_out_indices(names: Sequence[str], every: int, named: Sequence[str] = ()) -> list[int]:
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
    perceived: Perceived | None = None,
) -> Score:
    """Measure a render against a photograph, over the pixels of a mask."""
    rendered, truth = np.clip(rendered, 0, 1), image.astype(np.float32) / 255
    whole = np.ones(image.shape[:2], bool) if mask is None else mask
    middle = image.shape[1] // 2
    left = whole.copy()
    left[:, middle:] = False
    exposed = with_affine(rendered, fitted_affine(rendered, truth, left))
    return Score(
        name,
        psnr(rendered, truth, whole),
        ssim(rendered, truth, mask),
        psnr(exposed[:, middle:], truth[:, middle:], whole[:, middle:]),
        None if perceived is None else perceived.distance(rendered, truth, mask),
    )


def mean_of(scores: Sequence[Score], field: str) -> float | None:
    """Mean of one figure over views; None where there is none."""
    values = [getattr(each, field) for each in scores if getattr(each, field) is not None]
    return float(np.mean(values)) if values else None

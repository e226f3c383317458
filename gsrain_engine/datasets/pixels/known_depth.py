"""What is known of each view before a training: where its surfaces are, and where its sky is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from ..capture import Capture, View
from .measured_depth import completed_depths, measured_depths
from .sky_pixels import sky_masks


@dataclass(frozen=True, slots=True, eq=False)
class KnownDepth:
    """Pictures of the depth along the view axis, one a view, and of the sky."""

    measured: tuple[Float32[np.ndarray, "_ _"], ...]
    """0 where nothing was measured; without what moves."""
    completed: tuple[Float32[np.ndarray, "_ _"], ...]
    """0 in the sky, and where nothing can be told."""
    skies: tuple[Bool[np.ndarray, "_ _"], ...]

    @property
    def usual(self) -> float:
        """Median of what was measured, 0 where nothing was."""
        known = np.concatenate([np.zeros(0, np.float32), *(depth[depth > 0] for depth in self.measured)])
        return float(np.median(known)) if len(known) else 0.0

    def of(self, indices: Iterable[int]) -> "KnownDepth":
        chosen = list(indices)
        return KnownDepth(*(tuple(all_[i] for i in chosen) for all_ in (self.measured, self.completed, self.skies)))


def known_depth(capture: Capture, views: Sequence[View]) -> KnownDepth:
    """Find out what the capture tells of some of its views, without distortion."""
    measured = measured_depths(capture, views)
    skies = sky_masks(views, measured, capture.up)
    completed = completed_depths(capture, views, measured, skies)
    return KnownDepth(tuple(measured), tuple(completed), tuple(skies))

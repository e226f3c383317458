"""How many labelled objects are found, by their distance."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..share_interval import share_interval


@dataclass(frozen=True, slots=True)
class DistanceRecall:
    """Recall of objects between two distances."""

    from_m: float
    to_m: float
    objects: int
    found: int

    @property
    def recall(self) -> float:
        """Share that was found, 0..1; NaN without objects."""
        return self.found / self.objects if self.objects else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the recall (Wilson 1927); 0..1 without objects.

        Holds for objects seen independently: frames of one drive are not, it is then too narrow.
        """
        return share_interval(self.found, self.objects)


def recall_by_distance(
    distances_m: Float[np.ndarray, " n"],
    confidences: Float[np.ndarray, " n"],
    edges_m: Sequence[float],
    least_confidence: float = 0.25,
) -> tuple[DistanceRecall, ...]:
    """Recall between neighbouring `edges_m` (the nearer one belongs to a bin, the farther does not).

    The share of labelled objects that were found, 0 to 1, higher is better; with Wilson's interval (1927).
    An object is found where the confidence of its match (`Match.confidence`, 0 where missed) is at least
    `least_confidence`. Objects outside the edges do not count. Raises ValueError for edges that do not rise.
    """
    edges = np.asarray(edges_m, float)
    if len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise ValueError(
            f"distances between which recall is taken must rise, not {', '.join(f'{e:g}' for e in edges)} m"
        )
    found = (confidences >= least_confidence) & (confidences > 0)
    bins: list[DistanceRecall] = []
    for near, far in pairwise(edges):
        inside = (distances_m >= near) & (distances_m < far)
        bins.append(DistanceRecall(float(near), float(far), int(inside.sum()), int((inside & found).sum())))
    return tuple(bins)

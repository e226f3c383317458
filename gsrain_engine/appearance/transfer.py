"""What every appearance transfer is: clear views in, rainy views out."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from .clear_view import ClearView


@dataclass(frozen=True, slots=True, eq=False)
class RainyView:
    """A view as a transfer made it."""

    clear: ClearView
    image: Float32[np.ndarray, "h w 3"]
    """Display colour (sRGB), 0..1, of the clear picture's size."""
    film: Float32[np.ndarray, "h w"] | None = None
    """Share of what water mirrors, 0..1: it moves with the eye, so that other views rightly disagree about it."""
    left_out: str = ""
    """What the transfer could not do for this view and why, as the end of a sentence; empty where it did all."""


class LeftOut:
    """Counts what a transfer could not do, over all views."""

    def __init__(self) -> None:
        self._views, self._reasons = 0, Counter[str]()

    def add(self, view: RainyView) -> None:
        self._views += 1
        if view.left_out:
            self._reasons[view.left_out] += 1

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return one sentence a reason, with the number of views."""
        return tuple(
            f"{count} of {self._views} {'view' if self._views == 1 else 'views'}: {reason}."
            for reason, count in self._reasons.items()
        )


@runtime_checkable
class Transfer(Protocol):
    """A model that makes views look rainy."""

    @property
    def name(self) -> str:
        """As in `gsrain transfer --method`."""
        ...

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Make views rainy, one by one, in the order in which they are done; each comes out once.

        `views` may be lazy, each worked out when it is asked for: hold on to no more of them than the model needs.
        The same views give the same bytes.
        """
        ...

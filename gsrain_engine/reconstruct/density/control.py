"""What decides where a training gets more Gaussians and where fewer: the contract of all ways to do it."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Shaped

from ..parameters.splat_parameters import SplatParameters, Tensor


@runtime_checkable
class DensityControl(Protocol):
    """Watches a training and changes the number of Gaussians in it.

    The training calls `observe` after each backward pass and `adapt` after each step of the optimizer, with the same
    count of steps (from 0). What is random comes from the generator alone.
    """

    def observe(self, step: int, rendered: Any, rows: slice | Tensor = slice(None)) -> None:
        """Take notes of a picture whose loss has gone backward.

        Args:
            step: How many steps were done before this one.
            rendered: The `Rendered` of `render_gaussians`.
            rows: Which of the Gaussians that were rendered are those under control, in their order.
        """
        ...

    def adapt(self, step: int, parameters: SplatParameters, generator: Tensor) -> str | None:
        """Change Gaussians where that is due at this step; returns what was done, in a few words, or None."""
        ...

    def regularization(self, parameters: SplatParameters) -> Tensor | None:
        """Return what is to be added to each step's loss, or None."""
        ...

    def state(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Return the notes taken since the last change, as arrays: for a checkpoint."""
        ...

    def restore(self, state: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
        """Go back to what `state` returned."""
        ...

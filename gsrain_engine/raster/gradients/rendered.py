"""What differentiable rendering hands out: the picture, and where each Gaussian lies in it."""

from dataclasses import dataclass
from typing import Any

Tensor = Any
"""torch is an extra: no type of it can be named."""


class Footprint:
    """Where Gaussians lie in one picture, and after the backward pass how hard the loss pulls at them there.

    Density control reads it (Kerbl et al. 2023).
    """

    def __init__(self, radii_px: Tensor, centers: Tensor | None = None) -> None:
        self.radii_px = radii_px
        """(n,) three standard deviations of the longer axis in px; 0 where not drawn."""
        self.gradients: Tensor | None = None
        """(n,) set by the backward pass."""
        self._centers = centers

    @property
    def drawn(self) -> Tensor:
        """(n,) bool: which Gaussians the picture is made of."""
        return self.radii_px > 0

    @property
    def screen_gradients(self) -> Tensor:
        """(n,) length of the loss's gradient by each centre in the image, per px; 0 where not drawn.

        Raises:
            RuntimeError: Before a backward pass, or when nothing but colours needed gradients.
        """
        if self.gradients is not None:
            return self.gradients
        if self._centers is None or self._centers.grad is None:
            raise RuntimeError("screen gradients exist after a backward pass through means, scales or a pose only")
        return self._centers.grad.reshape(-1, 2).norm(dim=1)


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """A picture whose parts carry gradients."""

    color: Tensor
    """(h, w, 3) display colour, premultiplied over nothing."""
    alpha: Tensor
    """(h, w)"""
    depth: Tensor
    """(h, w) sum of view depth (m) by weight: expected depth is depth / alpha."""
    footprint: Footprint

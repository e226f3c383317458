"""What several Gaussians in one place must be so that together they look like the one that was there."""

from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.special import comb

from ..parameters.splat_parameters import Tensor

torch: Any = import_module("torch")

MOST_COPIES = 51
"""More in one place count as this many, as in the authors' program: the sums lose their digits beyond."""


def relocated(opacities: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity, and factor of the scales, of each of N equal Gaussians that replace one (Kheradmand et al. 2024, eq. 9).

    In the middle the stack has the opacity of the one; along a line through it, the same integral.

    Args:
        opacities: (n,) of the one.
        copies: (n,) how many are there afterwards, the one included.
    """
    count = copies.clamp(max=MOST_COPIES)
    old = opacities.double()
    new = 1 - (1 - old) ** (1 / count.double())
    terms = torch.as_tensor(_TERMS, device=old.device)[count]
    powers = new[:, None] ** torch.arange(1, MOST_COPIES + 1, device=old.device)
    factor = old / (terms * powers).sum(dim=1)
    return new.to(opacities.dtype), factor.to(opacities.dtype)


def _terms() -> Float64[np.ndarray, "n k"]:
    """(-1)^k C(N, k + 1) / sqrt(k + 1): the double sum of eq. 9, summed over its first index."""
    n, k = np.arange(MOST_COPIES + 1)[:, None], np.arange(MOST_COPIES)[None, :]
    return np.asarray(comb(n, k + 1) * (-1.0) ** k / np.sqrt(k + 1), np.float64)


_TERMS = _terms()

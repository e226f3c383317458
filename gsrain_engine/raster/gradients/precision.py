"""The exponential of the differentiable kernels: a polynomial in float32, exact in float64."""

from typing import no_type_check

import numpy as np
from numba import extending, types

from ..fast_math import exp_of_negative


@no_type_check
def exponential(x):
    """exp(x) for x <= 0 inside compiled code, to the precision that x has; see `exp_of_negative` for float32."""
    return np.exp(x)


@extending.overload(exponential, inline="always")
@no_type_check
def _exponential(x):
    if x == types.float32:
        return lambda x: exp_of_negative(x)  # noqa: PLW0108 - numba wants a function with this one's arguments
    return lambda x: np.exp(x)  # noqa: PLW0108

"""One Adam step over a flat array in a single pass: memory is read and written once, nothing is allocated."""

from typing import no_type_check

import numpy as np
from numba import njit, prange

FIRST_DECAY, SECOND_DECAY, EPSILON = 0.9, 0.999, 1e-15
"""Of the two moments, and what keeps the quotient finite (Kingma and Ba 2015; the last as in 3DGS)."""

_CHUNK = 4096


@njit(cache=True, parallel=True, error_model="numpy")
@no_type_check
def adam_step(values, gradients, first, second, rows, rate, first_share, second_share):
    """Move `values` (n, c) in place, with their moments; every row depends on itself alone.

    Args:
        values: What is trained.
        gradients: Of the loss by `values`.
        first: Running mean of the gradients.
        second: Running mean of their squares.
        rows: (n,) which rows take part, or an empty array for all.
        rate: Learning rate.
        first_share: 1 - FIRST_DECAY ** steps: how much of its final weight the first moment has by now.
        second_share: The same of the second.
    """
    count, channels = values.shape
    kind = values.dtype.type
    first_decay, second_decay, epsilon = kind(FIRST_DECAY), kind(SECOND_DECAY), kind(EPSILON)
    one = kind(1)
    pace, spread = kind(rate / first_share), kind(1 / np.sqrt(second_share))
    everybody = len(rows) == 0
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, count)):
            if everybody or rows[i]:
                for c in range(channels):
                    slope = gradients[i, c]
                    mean = first_decay * first[i, c] + (one - first_decay) * slope
                    square = second_decay * second[i, c] + (one - second_decay) * slope * slope
                    first[i, c] = mean
                    second[i, c] = square
                    values[i, c] -= pace * mean / (np.sqrt(square) * spread + epsilon)

"""Rows of numbers as a PLY file has them, spread over the arrays of Gaussians."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64


def spread_rows(
    rows: Float32[np.ndarray, "r p"],
    columns: Int64[np.ndarray, " c"],
    means: Float32[np.ndarray, "r 3"],
    scales: Float32[np.ndarray, "r 3"],
    quaternions: Float32[np.ndarray, "r 4"],
    opacities: Float32[np.ndarray, " r"],
    sh: Float32[np.ndarray, "r k 3"],
) -> None:
    """Copy numbers into arrays, each row at once.

    Args:
        rows: What the file holds.
        columns: Where in a row stands what goes into the arrays, one after the other and in their own order in memory.
        means: To be filled, as are those after it.
        scales: As the file has them.
        quaternions: As the file has them.
        opacities: As the file has them.
        sh: Harmonics.
    """
    _spread(rows, columns, means, scales, quaternions, opacities, sh.reshape(len(sh), 3 * sh.shape[1]))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _spread(rows, columns, means, scales, quaternions, opacities, sh):
    """Row by row what is read and written lies together; column by column every number is a cache line of its own."""
    for n in range(len(rows)):
        for i in range(3):
            means[n, i] = rows[n, columns[i]]
            scales[n, i] = rows[n, columns[3 + i]]
        for i in range(4):
            quaternions[n, i] = rows[n, columns[6 + i]]
        opacities[n] = rows[n, columns[10]]
        for i in range(sh.shape[1]):
            sh[n, i] = rows[n, columns[11 + i]]

"""Sums over a splat's pixels, tile by tile and then over its tiles: in one order, whatever the number of threads."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int32

from ..fast_math import FAST
from ..tiles import TILE


def add_pairs(
    members: Int32[np.ndarray, " pairs"], by_pair: Float[np.ndarray, "pairs c"], count: int
) -> Float[np.ndarray, "{count} c"]:
    """Add the rows of each splat's tiles in the order of the tiles; `members` as in `TileLists`, of `count` splats."""
    sums = np.zeros((count, by_pair.shape[1]), by_pair.dtype)
    _add_pairs(members, by_pair, sums, numba.get_num_threads())
    return sums


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _add_pairs(members, by_pair, sums, shares):
    """Threads share out the splats, so that no row is written by two; each goes through all pairs."""
    count = len(sums)
    for share in numba.prange(shares):
        first, last = share * count // shares, (share + 1) * count // shares
        for k in range(len(members)):
            n = members[k]
            if first <= n < last:
                for c in range(by_pair.shape[1]):
                    sums[n, c] += by_pair[k, c]


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST | {"reassoc"})
@no_type_check
def add_lanes(lanes, count, sums):
    """Add up `count` lines of lanes; a constant count makes it straight SIMD, always in the same order."""
    for c in range(count):
        total = lanes[c * TILE]
        for v in range(1, TILE):
            total += lanes[c * TILE + v]
        sums[c] = total

"""Cache of Gaussians that are mapped from a file: the CPU renderer holds only the blocks that its frames need."""

from collections.abc import Sequence
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64

from ...scene.gaussians import Gaussians, IdentityKey
from ...scene.mapped_arrays import is_mapped, release_pages

_SHIFT = 4
BLOCK = 1 << _SHIFT
"""Number of consecutive Gaussians that are read together: neighbors, since those of a tree follow a curve."""

_SHARE = 4  # a cache holds this part of all blocks, or more if one frame needs more
_READ_BLOCKS = 1024  # blocks read between two releases of the file's pages
_ROOM = 5 / 4  # blocks of a cache, by those of the frame for which it grew
_IDLE_DRAWS = 64  # draws after which an unused cache is freed; sky and mirror are drawn between frames

WetColors = Float32[np.ndarray, "n k 3"] | None


class BlockCache:
    """Rows of arrays in blocks, of which some are in memory; the least recently used ones are replaced.

    Args:
        sources: Arrays with one row per Gaussian, mapped or not. They must not change.
    """

    def __init__(self, sources: Sequence[np.ndarray]) -> None:
        self._sources = sources
        self._count = len(sources[0])
        blocks = -(-self._count // BLOCK)
        self._slots = np.full(blocks, -1, np.int64)
        """Slot of each block; -1 without one."""
        self._flags = np.zeros(blocks, np.bool_)
        self._clock = 0
        self._reserve(-(-blocks // _SHARE))

    @property
    def nbytes(self) -> int:
        """Maximum memory of the rows; what no frame has needed yet takes none."""
        return sum(each.nbytes for each in self.arrays)

    def rows(self, members: Int64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"]:
        """Make some Gaussians present in `arrays` and return their rows there, valid until the next call."""
        self._flags[:] = False
        _mark(members, self._flags)
        needed = np.flatnonzero(self._flags)
        self._clock += 1
        if len(needed) > len(self._used):
            self._slots[:] = -1
            self._reserve(min(int(_ROOM * len(needed)), len(self._slots)))
        slots = self._slots[needed]
        self._used[slots[slots >= 0]] = self._clock
        missing = needed[slots < 0]
        if len(missing):
            self._read(missing)
        rows = np.empty(len(members), np.int64)
        _translate(members, self._slots, rows)
        return rows

    def _reserve(self, slots: int) -> None:
        self.arrays = tuple(np.empty((BLOCK * slots, *each.shape[1:]), each.dtype) for each in self._sources)
        self._blocks = np.full(slots, -1, np.int64)
        """Block in each slot; -1 if it is free."""
        self._used = np.zeros(slots, np.int64)
        """Time of the last use of each slot."""

    def _read(self, missing: Int64[np.ndarray, " b"]) -> None:
        """Read blocks into the slots that were not used for the longest time."""
        slots = np.argsort(self._used, kind="stable")[: len(missing)]
        left = self._blocks[slots]
        self._slots[left[left >= 0]] = -1
        self._slots[missing], self._blocks[slots], self._used[slots] = slots, missing, self._clock
        offsets = np.arange(BLOCK)
        for first in range(0, len(missing), _READ_BLOCKS):
            part = slice(first, first + _READ_BLOCKS)
            rows = np.minimum(BLOCK * missing[part, None] + offsets, self._count - 1)
            places = BLOCK * slots[part, None] + offsets
            for source, array in zip(self._sources, self.arrays, strict=True):
                array[places] = source[rows]
            release_pages(self._sources)  # the system maps 16 pages for each that is read


class BlockCaches:
    """Caches of one renderer, by the identity of Gaussians and wet colors."""

    def __init__(self) -> None:
        self._caches: dict[tuple[IdentityKey, IdentityKey], BlockCache] = {}
        self._last_draws: dict[tuple[IdentityKey, IdentityKey], int] = {}
        self._draws = 0

    def present(
        self, gaussians: Gaussians, wet_sh: WetColors, members: Int64[np.ndarray, " m"]
    ) -> tuple[Gaussians, Float32[np.ndarray, "r k 3"] | None, Int64[np.ndarray, " m"]]:
        """Gaussians and wet colors in memory, and the rows of `members` in them; unchanged if they are not mapped."""
        if not is_mapped(gaussians.means):
            return gaussians, wet_sh, members
        key = IdentityKey(gaussians), IdentityKey(wet_sh)
        if key not in self._caches:
            self._caches[key] = BlockCache((*gaussians.arrays, *([] if wet_sh is None else [wet_sh])))
        self._last_draws[key] = self._draws
        rows = self._caches[key].rows(members)
        arrays = self._caches[key].arrays
        return Gaussians(*arrays[:5]), None if wet_sh is None else arrays[5], rows

    @property
    def nbytes(self) -> int:
        """Maximum memory of all caches."""
        return sum(each.nbytes for each in self._caches.values())

    def release_unused(self) -> None:
        """Count a draw, and free caches that have not been used for some."""
        self._draws += 1
        for key in [key for key, last in self._last_draws.items() if self._draws - last > _IDLE_DRAWS]:
            del self._caches[key], self._last_draws[key]


@numba.njit(cache=True)
@no_type_check
def _mark(members, flags):
    for n in range(len(members)):
        flags[members[n] >> _SHIFT] = True


@numba.njit(parallel=True, cache=True)
@no_type_check
def _translate(members, slots, rows):
    for n in numba.prange(len(members)):
        i = members[n]
        rows[n] = (slots[i >> _SHIFT] << _SHIFT) | (i & (BLOCK - 1))

"""Cache of Gaussians that are mapped from a file: the CPU renderer holds only the blocks that its frames need."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Int64

from ...kernels import kernel, range_of
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
        self._sources = list(sources)
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
            self._replace(missing)
        rows = np.empty(len(members), np.int64)
        _translate(members, self._slots, rows)
        return rows

    def add(self, source: np.ndarray) -> None:
        """Add an array, as the last one of `arrays`, for all blocks in memory."""
        self._sources.append(source)
        self.arrays.append(self._empty(source))
        held = np.flatnonzero(self._blocks >= 0)
        self._read(self._blocks[held], held, len(self._sources) - 1)

    def drop(self) -> None:
        """Remove the last array."""
        self._sources.pop()
        self.arrays.pop()

    def _reserve(self, slots: int) -> None:
        self._blocks = np.full(slots, -1, np.int64)
        """Block in each slot; -1 if it is free."""
        self._used = np.zeros(slots, np.int64)
        """Time of the last use of each slot."""
        self.arrays: list[np.ndarray] = []
        self.arrays = [self._empty(each) for each in self._sources]

    def _empty(self, source: np.ndarray) -> np.ndarray:
        return np.empty((BLOCK * len(self._used), *source.shape[1:]), source.dtype)

    def _replace(self, missing: Int64[np.ndarray, " b"]) -> None:
        """Read blocks into the slots that were not used for the longest time."""
        slots = np.argsort(self._used, kind="stable")[: len(missing)]
        left = self._blocks[slots]
        self._slots[left[left >= 0]] = -1
        self._slots[missing], self._blocks[slots], self._used[slots] = slots, missing, self._clock
        self._read(missing, slots)

    def _read(self, blocks: Int64[np.ndarray, " b"], slots: Int64[np.ndarray, " b"], first_source: int = 0) -> None:
        sources, arrays, offsets = self._sources[first_source:], self.arrays[first_source:], np.arange(BLOCK)
        for first in range(0, len(blocks), _READ_BLOCKS):
            part = slice(first, first + _READ_BLOCKS)
            rows = np.minimum(BLOCK * blocks[part, None] + offsets, self._count - 1)
            places = BLOCK * slots[part, None] + offsets
            for source, array in zip(sources, arrays, strict=True):
                array[places] = source[rows]
            release_pages(sources)  # the system maps 16 pages for each that is read


@dataclass(slots=True)
class _Entry:
    cache: BlockCache
    last_draw: int
    wet_sh: WetColors = None
    """Wet colors that the cache has, too."""
    last_wet_draw: int = 0


class BlockCaches:
    """Caches of one renderer, by the identity of Gaussians; wet colors are added where they are drawn."""

    def __init__(self) -> None:
        self._entries: dict[IdentityKey, _Entry] = {}
        self._draws = 0

    def present(
        self, gaussians: Gaussians, wet_sh: WetColors, members: Int64[np.ndarray, " m"]
    ) -> tuple[Gaussians, Float32[np.ndarray, "r k 3"] | None, Int64[np.ndarray, " m"]]:
        """Gaussians and wet colors in memory, and the rows of `members` in them; unchanged if they are not mapped."""
        if not is_mapped(gaussians.means):
            return gaussians, wet_sh, members
        key = IdentityKey(gaussians)
        if key not in self._entries:
            self._entries[key] = _Entry(BlockCache(gaussians.arrays), self._draws)
        entry = self._entries[key]
        entry.last_draw = self._draws
        rows = entry.cache.rows(members)
        if wet_sh is not None:
            entry.last_wet_draw = self._draws
            if entry.wet_sh is not wet_sh:
                _forget_wet_colors(entry)
                entry.wet_sh = wet_sh
                entry.cache.add(wet_sh)
        arrays = entry.cache.arrays
        return Gaussians(*arrays[:5], antialiased=gaussians.antialiased), None if wet_sh is None else arrays[5], rows

    @property
    def nbytes(self) -> int:
        """Maximum memory of all caches."""
        return sum(each.cache.nbytes for each in self._entries.values())

    def release_unused(self) -> None:
        """Count a draw, and free caches and wet colors that have not been used for some."""
        self._draws += 1
        for key, entry in list(self._entries.items()):
            if self._draws - entry.last_draw > _IDLE_DRAWS:
                del self._entries[key]
            elif self._draws - entry.last_wet_draw > _IDLE_DRAWS:
                _forget_wet_colors(entry)


def _forget_wet_colors(entry: _Entry) -> None:
    if entry.wet_sh is not None:
        entry.wet_sh = None
        entry.cache.drop()


@kernel()
@no_type_check
def _mark(members, flags):
    for n in range(len(members)):
        flags[members[n] >> _SHIFT] = True


@kernel(parallel=True)
@no_type_check
def _translate(portion, members, slots, rows):
    for n in range_of(portion, len(members)):
        i = members[n]
        rows[n] = (slots[i >> _SHIFT] << _SHIFT) | (i & (BLOCK - 1))

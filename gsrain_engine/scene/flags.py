"""Bit masks of Gaussians, and selection, hide and delete flags."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64, UInt32

from .gaussians import scene_cache


@dataclass(frozen=True, slots=True, eq=False)
class BitMask:
    """One bit for each of `count` Gaussians: a million take 125 kB, so that the undo history can hold many.

    Treat the array as immutable.
    """

    count: int
    words: UInt32[np.ndarray, " w"]
    """Gaussian n is bit n % 32, from the lowest, of word n // 32. Bits from `count` on are 0."""

    def __post_init__(self) -> None:
        if len(self.words) != _words(self.count):
            raise ValueError(f"a mask of {self.count} Gaussians has {_words(self.count)} words, not {len(self.words)}")

    @staticmethod
    def of(flags: Bool[np.ndarray, " n"]) -> "BitMask":
        packed = np.packbits(flags, bitorder="little")
        padded = np.zeros(4 * _words(len(flags)), np.uint8)
        padded[: len(packed)] = packed
        return BitMask(len(flags), padded.view("<u4").astype(np.uint32, copy=False))

    @staticmethod
    def none(count: int) -> "BitMask":
        return BitMask(count, np.zeros(_words(count), np.uint32))

    @staticmethod
    def all(count: int) -> "BitMask":
        return ~BitMask.none(count)

    @property
    def flags(self) -> Bool[np.ndarray, " n"]:
        packed = self.words.astype("<u4", copy=False).view(np.uint8)
        return np.unpackbits(packed, count=self.count, bitorder="little").view(np.bool_)

    @property
    def indices(self) -> Int64[np.ndarray, " m"]:
        """Indices of the set bits, increasing."""
        return np.flatnonzero(self.flags)

    @property
    def size(self) -> int:
        """Number of set bits."""
        return int(np.bitwise_count(self.words).sum())

    def __bool__(self) -> bool:
        return bool(self.words.any())

    def __and__(self, other: "BitMask") -> "BitMask":
        return BitMask(self.count, self.words & other.words)

    def __or__(self, other: "BitMask") -> "BitMask":
        return BitMask(self.count, self.words | other.words)

    def __sub__(self, other: "BitMask") -> "BitMask":
        return BitMask(self.count, self.words & ~other.words)

    def __invert__(self) -> "BitMask":
        words = ~self.words
        if self.count % 32:
            words[-1] &= np.uint32((1 << self.count % 32) - 1)
        return BitMask(self.count, words)

    def same_as(self, other: "BitMask") -> bool:
        """Return whether both masks have the same bits."""
        return self.count == other.count and np.array_equal(self.words, other.words)

    def take(self, indices: Int64[np.ndarray, " m"]) -> "BitMask":
        """Mask of Gaussians picked by index from those of this one."""
        return BitMask.of(self.flags[indices])


@scene_cache(maxsize=256)
def mask_union(first: BitMask, second: BitMask) -> BitMask:
    """Return `first | second`, the identical object each time: renderers identify arrays by identity."""
    return first | second


def _words(count: int) -> int:
    return -(-count // 32)


# Selection flags
# Edits set flags and leave the arrays, so that an undo step costs a few bits.


@dataclass(frozen=True, slots=True, eq=False)
class SelectionFlags:
    """Flags of one member; None for a flag that no Gaussian has."""

    selected: BitMask | None = None
    hidden: BitMask | None = None
    deleted: BitMask | None = None
    """Deleted, except for undo: never written to files."""

    @property
    def left_out(self) -> BitMask | None:
        """Gaussians that are not drawn; the identical object each time."""
        if self.hidden is None or self.deleted is None:
            return self.deleted if self.hidden is None else self.hidden
        return mask_union(self.hidden, self.deleted)


UNMARKED = SelectionFlags()

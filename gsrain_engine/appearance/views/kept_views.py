"""Views that are worked out when they are asked for, and kept for a while: neighbours are asked for again."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import overload

from ..clear_view import ClearView

KEPT = 6
"""Views that stay in memory, 36 bytes a pixel each."""


class KeptViews(Sequence[ClearView]):
    """A sequence of views, each made by a function of its index; the last few that were asked for stay."""

    def __init__(self, count: int, make: Callable[[int], ClearView], kept: int = KEPT) -> None:
        self._count, self._make, self._room = count, make, kept
        self._kept: OrderedDict[int, ClearView] = OrderedDict()

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> ClearView: ...
    @overload
    def __getitem__(self, index: slice) -> "KeptViews": ...
    def __getitem__(self, index: int | slice) -> "ClearView | KeptViews":
        if isinstance(index, slice):
            chosen = range(self._count)[index]
            return KeptViews(len(chosen), lambda i: self[chosen[i]], 0)  # this one keeps them already
        index = range(self._count)[index]
        view = self._kept.pop(index, None) or self._make(index)
        self._kept[index] = view
        while len(self._kept) > self._room:
            self._kept.popitem(last=False)
        return view

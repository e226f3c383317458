"""What was worked out for a view, kept while the same few views are asked for again."""

from collections.abc import Callable
from typing import Generic, TypeVar

from ..clear_view import ClearView

_Found = TypeVar("_Found")
_KEPT = 2


class RecentView(Generic[_Found]):
    """A function of views that remembers its last answers; views are values, known by their identity."""

    def __init__(self, find: Callable[[ClearView], _Found]) -> None:
        self._find = find
        self._kept: list[tuple[ClearView, _Found]] = []

    def of(self, view: ClearView) -> _Found:
        """Return the function's answer for a view."""
        for known, answer in self._kept:
            if known is view:
                return answer
        answer = self._find(view)
        self._kept = [*self._kept[1 - _KEPT :], (view, answer)]
        return answer

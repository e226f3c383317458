"""How well each method's views agree with each other, over the same pairs of views."""

from collections.abc import Sequence
from pathlib import Path

from gsrain_engine.evaluate.consistency.folders import ComparedViews, open_compared
from gsrain_engine.evaluate.consistency.pairs import agreements
from gsrain_engine.evaluate.consistency.warp_error import Agreement, pooled


class PairedViews:
    """The pairs of neighbouring views that all methods are measured on."""

    def __init__(self, folders: Sequence[Path], neighbours: int) -> None:
        """Find the pairs in the first folder that has the most views; raises `CaptureError` for a broken folder."""
        opened = [open_compared(folder) for folder in folders]
        fullest = max(opened, key=lambda each: len(each.views))
        names = _names(fullest)
        self._pairs = [(names[i], names[j]) for i, j in fullest.chosen(neighbours)]

    def agreement(self, folder: Path) -> tuple[int, Agreement | None, Agreement | None]:
        """Return the number of pairs, and their pooled agreement everywhere and outside the water film.

        See `warp_error`: display values of 0..1, 0 is best, and a ratio of 1 changes nothing. Pairs of which a view is
        missing are left out; None where none is left, or nobody knows the film.
        """
        compared = open_compared(folder)
        index = {name: i for i, name in enumerate(_names(compared))}
        pairs = [(index[of], index[to]) for of, to in self._pairs if of in index and to in index]
        rows = list(agreements(compared.views, pairs, has_clear=compared.has_clear))
        dry = [row.outside_film for row in rows if row.outside_film is not None]
        return len(rows), pooled(row.everywhere for row in rows), pooled(dry)


def _names(compared: ComparedViews) -> list[str]:
    return [view.clear.name for view in compared.views]

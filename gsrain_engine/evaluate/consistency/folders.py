"""What consistency is measured on: folders of a transfer, or any capture of pictures with cameras and depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from gsrain_engine.appearance.matching.neighbours import neighbours
from gsrain_engine.appearance.transfer import RainyView
from gsrain_engine.appearance.transferred_folder import is_transferred_folder, read_transferred
from gsrain_engine.appearance.views.kept_views import KeptViews

_KEPT = 6
_USUAL_WIDTH_PX = 960


@dataclass(frozen=True, slots=True, eq=False)
class ComparedViews:
    """Views of one folder."""

    folder: Path
    views: Sequence[RainyView]
    """Each read when it is asked for."""
    has_clear: bool
    """Whether the pictures before their transfer are there."""
    method: str = ""
    """How they were made, where that is known."""
    settings: dict[str, Any] | None = None

    @property
    def title(self) -> str:
        """Name for tables and pictures."""
        return f"{self.folder.name} ({self.method})" if self.method else self.folder.name

    @property
    def has_poses(self) -> bool:
        """Whether it is known where any of the views was taken."""
        return any(self.views[i].clear.has_pose for i in range(len(self.views)))

    def chosen(self, count: int) -> list[tuple[int, int]]:
        """Pair each view with the `count` others that show most of it."""
        clear = KeptViews(len(self.views), lambda i: self.views[i].clear)
        return [(i, j) for i, others in enumerate(neighbours(clear, count)) for j in others]

    def alike(self, other: "ComparedViews", pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Find another folder's pairs in this one by their names; raises ValueError for a view that is not there."""
        if other is self:
            return list(pairs)
        mine = {self.views[i].clear.name: i for i in range(len(self.views))}
        theirs = {i: other.views[i].clear.name for i in {each for pair in pairs for each in pair}}
        missing = sorted(name for name in theirs.values() if name not in mine)
        if missing:
            raise ValueError(f"{self.folder}: has no view {missing[0]!r}, which {other.folder} has")
        return [(mine[theirs[i]], mine[theirs[j]]) for i, j in pairs]


def open_compared(folder: Path, width_px: int | None = None) -> ComparedViews:
    """Open what `gsrain transfer` has written, or a capture whose pictures are compared as they are.

    Wider pictures of a capture are made `width_px` wide (default 960). Raises `CaptureError` where neither
    can be read.
    """
    if is_transferred_folder(folder):
        transferred = read_transferred(folder)
        kept = _Kept(transferred)
        return ComparedViews(folder, kept, True, transferred.record.method, dict(transferred.record.settings))
    from gsrain_engine.appearance.views.capture_views import capture_views
    from gsrain_engine.datasets.open_capture import open_capture  # loads every reader

    clear = capture_views(open_capture(folder), width_px or _USUAL_WIDTH_PX)
    return ComparedViews(folder, _AsTheyAre(clear), False)


class _Kept(Sequence[RainyView]):
    """Holds the last few views that were asked for: a view is in several pairs."""

    def __init__(self, views: Sequence[RainyView]) -> None:
        self._views = views
        self._read = lru_cache(maxsize=_KEPT)(views.__getitem__)

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, index: Any) -> Any:
        return self._read(index)


class _AsTheyAre(Sequence[RainyView]):
    """Pictures of a capture in the place of transferred ones."""

    def __init__(self, views: Sequence[Any]) -> None:
        self._views = views

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, index: Any) -> Any:
        clear = self._views[index]
        return RainyView(clear, clear.image)

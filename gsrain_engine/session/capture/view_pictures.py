"""Recorded pictures of an open capture, read in a thread as they are asked for; the latest wish comes first."""

from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.datasets.capture import Capture, CaptureError

THUMBNAIL_PX = 192
LARGE_PX = 1280
"""Widths that pictures are read in; lines are straight in them, whatever the lens was."""

_MOST = {THUMBNAIL_PX: 400, LARGE_PX: 6}
"""So many of a width are kept: 25 MB of thumbnails, 25 MB of large ones."""

Pixels = UInt8[np.ndarray, "h w 3"]


class Wish(NamedTuple):
    """A picture in a size."""

    view: int
    width_px: int


class ViewPictures:
    """Call everything on the main thread, and `poll` once a frame."""

    def __init__(self, capture: Capture, thread: ThreadPoolExecutor) -> None:
        self.faults: dict[int, str] = {}
        """Why pictures can't be shown, by view."""
        self._capture, self._thread = capture, thread
        self._kept: OrderedDict[Wish, Pixels] = OrderedDict()
        self._wishes: dict[Wish, None] = {}
        self._reading: tuple[Wish, Future[Pixels]] | None = None

    def want(self, view: int, width_px: int) -> Pixels | None:
        """Return a picture at most so wide, or None while it is being read; to be said again each frame."""
        wish = Wish(view, width_px)
        if wish in self._kept:
            self._kept.move_to_end(wish)
            return self._kept[wish]
        if view not in self.faults:
            self._wishes[wish] = None
        return None

    def __iter__(self) -> Iterator[tuple[Wish, Pixels]]:
        return iter(self._kept.items())

    @property
    def is_reading(self) -> bool:
        """Whether something that was asked for is not there yet."""
        return self._reading is not None or bool(self._wishes)

    def poll(self) -> None:
        """Take in what has been read, and read what the last frame asked for."""
        if self._reading is not None and self._reading[1].done():
            (wish, reading), self._reading = self._reading, None
            try:
                self._keep(wish, reading.result())
            except (CaptureError, OSError, ValueError, MemoryError) as error:
                self.faults[wish.view] = str(error)
        wishes = [each for each in self._wishes if each not in self._kept and each.view not in self.faults]
        self._wishes.clear()
        if self._reading is None and wishes:
            wish = max(wishes, key=lambda each: each.width_px)  # what is looked at before what is listed
            self._reading = wish, self._thread.submit(_read, self._capture, wish)

    def _keep(self, wish: Wish, pixels: Pixels) -> None:
        self._kept[wish] = pixels
        same = [each for each in self._kept if each.width_px == wish.width_px]
        for old in same[: -_MOST[wish.width_px]]:
            del self._kept[old]


def _read(capture: Capture, wish: Wish) -> Pixels:
    from gsrain_engine.datasets.prepared import prepared

    view = capture[wish.view]
    return prepared(view, min(wish.width_px, view.camera.width)).image

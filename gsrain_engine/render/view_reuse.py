"""Reuse of what a picture shows indirectly, in mirrors and drops, for pictures that must be fast rather than exact."""

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import UInt8

from ..scene.scene import Scene
from ..water.leveled_ground import LeveledView
from ..water.mirror import Mirror, rows_of_ground

_Image = TypeVar("_Image")

_BEHIND_GLASS = 2  # times as many pictures share the view behind the drops on glass, which shrink it


class ViewReuse:
    """Uses a mirror image, and the view behind drops on glass, for several pictures of one moving camera."""

    def __init__(self, pictures: int) -> None:
        """Draw a mirror image for one picture of so many."""
        self._mirror = _Shared[Mirror](pictures)
        self._behind_glass = _Shared[UInt8[np.ndarray, "h w 3"]](_BEHIND_GLASS * pictures)

    def mirror(self, scene: Scene, view: LeveledView, draw: Callable[[], Mirror]) -> Mirror:
        """Return the last mirror image, or draw one: at every so many pictures, and for another size or horizon."""
        camera = view.camera
        return self._mirror.get((scene.geometry_key, camera.width, camera.height, rows_of_ground(camera)), draw)

    def behind_glass(
        self, scene: Scene, size_px: tuple[int, int], draw: Callable[[], UInt8[np.ndarray, "h w 3"]]
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Return the last view behind glass, or draw one: at every so many pictures, and in another size."""
        return self._behind_glass.get((scene.geometry_key, size_px), draw)


class _Shared(Generic[_Image]):
    """An image that several pictures in a row share, as long as a key stays the same."""

    def __init__(self, pictures: int) -> None:
        self._pictures, self._left = pictures, 0
        self._key: object = None
        self._image: _Image | None = None

    def get(self, key: object, draw: Callable[[], _Image]) -> _Image:
        if self._image is None or self._left <= 0 or key != self._key:
            self._image, self._left, self._key = draw(), self._pictures, key
        self._left -= 1
        return self._image

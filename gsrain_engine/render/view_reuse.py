"""Reuse of what a picture shows indirectly, in mirrors and drops, for pictures that must be fast rather than exact."""

from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from ..scene.scene import Scene
from ..water.leveled_ground import LeveledView
from ..water.mirror import Mirror, rows_of_ground

_BEHIND_GLASS = 2  # times as many pictures share the view behind the drops on glass, which shrink it


class ViewReuse:
    """Uses a mirror image, and the view behind drops on glass, for several pictures of one moving camera."""

    def __init__(self, pictures: int) -> None:
        """Draw a mirror image for one picture of so many."""
        self._pictures, self._left = pictures, 0
        self._key: object = None
        self._mirror: Mirror | None = None
        self._behind: UInt8[np.ndarray, "h w 3"] | None = None
        self._behind_key: object = None
        self._behind_left = 0

    def mirror(self, scene: Scene, view: LeveledView, draw: Callable[[], Mirror]) -> Mirror:
        """Return the last mirror image, or draw one: at every so many pictures, and for another size or horizon."""
        camera = view.camera
        key = scene.geometry_key, camera.width, camera.height, rows_of_ground(camera)
        if self._mirror is None or self._left <= 0 or key != self._key:
            self._mirror, self._left, self._key = draw(), self._pictures, key
        self._left -= 1
        return self._mirror

    def behind_glass(
        self, scene: Scene, size_px: tuple[int, int], draw: Callable[[], UInt8[np.ndarray, "h w 3"]]
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Return the last view behind glass, or draw one: at every so many pictures, and in another size."""
        key = scene.geometry_key, size_px
        if self._behind is None or self._behind_left <= 0 or key != self._behind_key:
            self._behind, self._behind_left, self._behind_key = draw(), _BEHIND_GLASS * self._pictures, key
        self._behind_left -= 1
        return self._behind

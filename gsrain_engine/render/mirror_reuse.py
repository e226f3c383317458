"""Reuse of mirror images, for pictures that must be fast rather than exact."""

from collections.abc import Callable

from ..scene.scene import Scene
from ..water.leveled_ground import LeveledView
from ..water.mirror import Mirror, rows_of_ground


class MirrorReuse:
    """Uses a mirror image for several pictures of one view, for pictures that must be fast rather than exact."""

    def __init__(self, pictures: int) -> None:
        """Draw it for one picture of so many."""
        self._pictures, self._left = pictures, 0
        self._key: object = None
        self._mirror: Mirror | None = None

    def mirror(self, scene: Scene, view: LeveledView, draw: Callable[[], Mirror]) -> Mirror:
        """Return the last mirror image, or draw one: at every so many pictures, and for another size or horizon."""
        camera = view.camera
        key = scene.geometry_key, camera.width, camera.height, rows_of_ground(camera)
        if self._mirror is None or self._left <= 0 or key != self._key:
            self._mirror, self._left, self._key = draw(), self._pictures, key
        self._left -= 1
        return self._mirror

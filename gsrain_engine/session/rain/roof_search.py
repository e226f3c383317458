"""Roofs found before a frame needs them: the search takes seconds, so it goes on beside the window."""

from concurrent.futures import Future, ThreadPoolExecutor

from gsrain_engine.rain.roofs import Roofs, roofs_of
from gsrain_engine.scene.scene import Scene


class RoofSearch:
    """Searches one scene after the other; what it finds is kept where `roofs_of` keeps it."""

    def __init__(self, thread: ThreadPoolExecutor) -> None:
        """Search in a thread."""
        self._thread = thread
        self._scene: Scene | None = None
        self._search: Future[Roofs | None] | None = None

    def knows(self, scene: Scene) -> bool:
        """Say whether asking for the roofs of a scene takes no time."""
        return self._search is not None and self._search.done() and self._is_of(scene)

    @property
    def pending(self) -> list[Future[Roofs | None]]:
        """The search, to wait for where there are no frames to wait with."""
        return [] if self._search is None else [self._search]

    def look_at(self, scene: Scene) -> None:
        """Search a scene once the search before is through; a scene that is known already isn't searched again."""
        waits = self._search is not None and not self._search.done()
        if not waits and not self._is_of(scene):
            self._scene, self._search = scene, self._thread.submit(roofs_of, scene)

    def _is_of(self, scene: Scene) -> bool:
        return self._scene is not None and self._scene.matter == scene.matter

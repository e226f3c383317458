"""Search for the lamps of a scene, which ends with their addition."""

from collections.abc import Generator

from ..scene.find_lamps import find_lamps
from ..scene.lamps import Lamp
from ..scene.progress import Progress
from .document import Document, Recipe
from .edits.lamps import add_found_lamps, unknown_lamps, with_found_lamps
from .jobs.job import Job, JobRunner

LAMPS_TITLE = "Find lamps"


class LampFinder:
    """The search for lamps."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self._document, self._jobs = document, jobs

    def find(self) -> Job[tuple[Lamp, ...]]:
        """Start to search for lamps in a thread, and add those found as one undo step."""
        scene = self._document.scene

        def search() -> Generator[Progress, None, tuple[Lamp, ...]]:
            yield Progress(0.0, "Looking for lamps")
            return tuple(find_lamps(scene))

        def take(found: tuple[Lamp, ...], _: bool) -> str:
            added = unknown_lamps(self._document.scene, found)
            if not added:
                return "No lamps were found: the scene is not dark, or has them already"
            self._document.edit(LAMPS_TITLE, with_found_lamps, found, recipe=Recipe(add_found_lamps, {}))
            return f"{len(added)} lamp{'s'[: len(added) != 1]} added"

        return self._jobs.start(Job("lamps", LAMPS_TITLE, search, in_thread=True), take)

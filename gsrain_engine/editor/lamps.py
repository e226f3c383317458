"""Search for the lamps of a scene, which ends with their addition."""

from collections.abc import Iterator

from ..scene.find_lamps import find_lamps
from ..scene.lamps import Lamp
from ..scene.progress import Progress
from .document import Document, Recipe
from .edits.lamps import add_found_lamps, unknown_lamps, with_found_lamps
from .jobs.job import Job, JobRunner, no_result

LAMPS_TITLE = "Find lamps"


class LampFinder:
    """The search for lamps."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self._document, self._jobs = document, jobs

    def find(self) -> Job[None]:
        """Start to search for lamps in a thread, and add those found as one undo step."""
        scene, found = self._document.scene, list[Lamp]()

        def search() -> Iterator[Progress]:
            found.extend(find_lamps(scene))
            yield Progress(1.0, "Searched")

        def take(_: None, __: bool) -> str:
            added = unknown_lamps(self._document.scene, tuple(found))
            if not added:
                return "No lamps were found: the scene is not dark, or has them already"
            self._document.edit(
                LAMPS_TITLE, with_found_lamps, tuple(found), recipe=Recipe(add_found_lamps, {})
            )  # fmt: skip
            return f"{len(added)} lamp{'s'[: len(added) != 1]} added"

        progress = Progress(0.0, "Looking for lamps")
        job = Job("lamps", LAMPS_TITLE, search, no_result, in_thread=True, progress=progress)
        return self._jobs.start(job, take)

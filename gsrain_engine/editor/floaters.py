"""Search for floaters, which ends with their selection."""

from ..scene.flags import BitMask
from ..scene.gaussians import Gaussians
from ..scene.progress import Progress
from .background_edits import find_floaters
from .document import Document, Recipe
from .edits.floaters import FloaterRules, search_floaters, select_floaters
from .edits.gaussians import selected_count
from .jobs.job import Job, JobRunner

FLOATERS_TITLE = "Find floaters"
_Found = dict[str, tuple[Gaussians, BitMask]]


class FloaterFinder:
    """The last search for floaters."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self.count: int | None = None
        """Number of floaters found; None if the search has not finished."""
        self._document, self._jobs = document, jobs

    def find(self, rules: FloaterRules) -> Job[_Found]:
        """Start to search for floaters in a thread, and select those found as one undo step."""
        scene, self.count = self._document.scene, None

        def take(found: _Found, _: bool) -> str:
            self.count = count = selected_count(select_floaters(self._document.scene, found))
            if not count:
                return "No Gaussian looks like a floater"
            recipe = Recipe(find_floaters, {"rules": rules})
            self._document.edit(FLOATERS_TITLE, select_floaters, found, recipe=recipe)
            verb = "looks like a floater and is" if count == 1 else "look like floaters and are"
            return f"{count:,} Gaussian{'s'[: count != 1]} {verb} selected"

        progress = Progress(0.0, "Looking for floaters")
        job = Job("floaters", FLOATERS_TITLE, lambda: search_floaters(scene, rules), in_thread=True, progress=progress)
        return self._jobs.start(job, take)

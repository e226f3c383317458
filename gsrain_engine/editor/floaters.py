"""Search for floaters, which ends with their selection."""

from ..scene.progress import Progress
from .document import Document
from .edits.floaters import FloaterRules, FloaterSearch, select_floaters
from .edits.gaussians import selected_count
from .jobs.job import Job, JobRunner, no_result

FLOATERS_TITLE = "Find floaters"


class FloaterFinder:
    """The last search for floaters."""

    def __init__(self, document: Document, jobs: JobRunner) -> None:
        self.count: int | None = None
        """Number of floaters found; None if the search has not finished."""
        self._document, self._jobs = document, jobs

    def find(self, rules: FloaterRules) -> Job[None]:
        """Start to search for floaters in a thread, and select those found as one undo step."""
        search, self.count = FloaterSearch(self._document.scene, rules), None

        def take(_: None, __: bool) -> str:
            self.count = count = selected_count(select_floaters(self._document.scene, search.found))
            if not count:
                return "No Gaussian looks like a floater"
            self._document.edit(FLOATERS_TITLE, select_floaters, search.found)
            verb = "looks like a floater and is" if count == 1 else "look like floaters and are"
            return f"{count:,} Gaussian{'s'[: count != 1]} {verb} selected"

        progress = Progress(0.0, "Looking for floaters")
        job = Job("floaters", FLOATERS_TITLE, search.run, no_result, in_thread=True, progress=progress)
        return self._jobs.start(job, take)

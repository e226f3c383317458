"""Job "Find floaters": searches in a thread, and selects the result as one undo step."""

import threading
import traceback
from concurrent.futures import Future, ThreadPoolExecutor

from ...scene.progress import Progress
from ...scene.scene import Scene
from ..edits.floaters import FloaterRules, FloaterSearch, select_floaters
from ..edits.gaussians import selected_count
from ..viewport_state import ViewportState
from .process import JobState

TITLE = "Find floaters"


class FloaterJob:
    """One run of the search, a `BackgroundJob`."""

    ends_with_scene = True

    def __init__(self, scene: Scene, rules: FloaterRules) -> None:
        self.title = TITLE
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Looking for floaters")
        self.error: str | None = None
        self.details: str | None = None
        self.found_count: int | None = None
        """Number of floaters; None until the search is finished."""
        self._search = FloaterSearch(scene, rules)
        self._stop = threading.Event()
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="floaters")
        self._running: Future[None] = self._thread.submit(self._run)
        self._thread.shutdown(wait=False)

    def poll(self, session: ViewportState) -> None:
        """Select the floaters after the search; never blocks."""
        if self.state != "running" or not self._running.done():
            return
        try:
            self._running.result()
        except Exception as error:  # any failure on odd values: the window must survive
            self.error, self.details = f"{type(error).__name__}: {error}", traceback.format_exc()
            self.state = "failed"
            return
        marked = select_floaters(session.scene, self._search.found)
        self.found_count = selected_count(marked)
        if self.found_count:
            session.set_scene(TITLE, marked)
        verb = "looks like a floater and is" if self.found_count == 1 else "look like floaters and are"
        told = f"{self.found_count:,} Gaussian{'s'[: self.found_count != 1]} {verb} selected"
        self.progress = Progress(1.0, told if self.found_count else "No Gaussian looks like a floater")
        self.state = "finished"

    def cancel(self) -> None:
        """Stop at the next chance, without waiting; the selection stays as it was."""
        if self.state == "running":
            self._stop.set()
            self.state = "cancelled"

    def _run(self) -> None:
        for progress in self._search.run():
            self.progress = progress
            if self._stop.is_set():
                return

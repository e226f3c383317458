"""What the Jobs panel shows of any work that goes on behind the window."""

from typing import Protocol, runtime_checkable

from gsrain_engine.scene.progress import Progress

from ..document.viewed_document import ViewedDocument
from .worker import JobState


@runtime_checkable
class BackgroundJob(Protocol):
    """One run of something. Its own threads and processes never touch the session: `poll` does."""

    title: str
    state: JobState
    progress: Progress
    error: str | None
    """What went wrong, as one line; `details` has the rest."""
    details: str | None

    def poll(self, session: ViewedDocument) -> None:
        """Go on, without waiting; once a frame while it runs. Whoever finishes brings the result into the session."""
        ...

    def cancel(self) -> None:
        """Stop, wherever it is, without waiting; the document stays as it was."""
        ...

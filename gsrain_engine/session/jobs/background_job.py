"""What the Jobs panel shows of any work that goes on behind the window."""

from typing import Protocol, runtime_checkable

from gsrain_engine.scene.progress import Progress

from ..document.viewed_document import ViewedDocument
from .worker import JobState


@runtime_checkable
class Work(Protocol):
    """Something that goes on in the background and can be waited for or stopped."""

    title: str
    state: JobState
    progress: Progress

    def cancel(self) -> None:
        """Stop, wherever it is, without waiting; the document stays as it was."""
        ...


@runtime_checkable
class BackgroundJob(Work, Protocol):
    """One run of something. Its own threads and processes never touch the session: `poll` does."""

    ends_with_scene: bool
    """Whether it ends when the session goes to another scene: its result belongs to this one."""
    error: str | None
    """What went wrong, as one line; `details` has the rest."""
    details: str | None

    def poll(self, session: ViewedDocument) -> None:
        """Go on, without waiting; once a frame while it runs. Whoever finishes brings the result into the session."""
        ...

"""Background jobs: a generator of `Progress` in a process of its own, watched from the main thread without waiting.

Small messages travel through a pipe; results travel as files. A worker that dies is a failed job, nothing more.
"""

import multiprocessing
import traceback
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any, Literal

from gsrain_engine.scene.progress import Progress

JobState = Literal["running", "finished", "failed", "cancelled"]
Work = Callable[..., Iterator[Progress]]
"""A function at the top level of a module: it is found again by its name in the new process."""


class Job:
    """One piece of work in another process. Call `poll` once a frame."""

    def __init__(self, title: str, work: Work, *arguments: Any) -> None:
        """Start at once. The arguments must survive pickling; large ones go by file."""
        context = multiprocessing.get_context("spawn")
        self.title = title
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Starting")
        self.error: str | None = None
        """What went wrong, as one line; `details` has the rest."""
        self.details: str | None = None
        self._messages, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=_run, args=(theirs, work, arguments), daemon=True)
        self._process.start()
        theirs.close()

    @property
    def waitable(self) -> Connection:
        """What `multiprocessing.connection.wait` can wait for: something was said, or the worker is gone."""
        return self._messages

    def poll(self) -> None:
        """Take in what the worker has said since the last call; never waits."""
        if self.state != "running":
            return
        try:
            while self.state == "running" and self._messages.poll():
                self._take(self._messages.recv())
        except (EOFError, OSError):
            self._process.join(timeout=1.0)
            if self.state == "running":
                self._fail(f"the worker died (exit code {self._process.exitcode})", None)

    def cancel(self) -> None:
        """Tell the worker to stop, without waiting for it; whatever it had not finished is dropped."""
        if self.state == "running":
            self._process.terminate()
            self.state = "cancelled"

    def close(self) -> None:
        """Wait for the process to be gone and free what it held; any thread may do this, once."""
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._messages.close()

    def _take(self, message: Any) -> None:
        if isinstance(message, Progress):
            shown = message.preview if message.preview is not None else self.progress.preview
            self.progress = message._replace(preview=shown)
        elif message is None:
            self.progress = Progress(1.0, "Done")
            self.state = "finished"
        else:
            self._fail(*message)

    def _fail(self, error: str, details: str | None) -> None:
        self.state, self.error, self.details = "failed", error, details


def _run(messages: Connection, work: Work, arguments: tuple[Any, ...]) -> None:
    """Do the work in the new process: Progress for each step, None at the end, (line, traceback) when it fails."""
    try:
        for progress in work(*arguments):
            messages.send(progress)
        messages.send(None)
    except Exception as error:
        messages.send((f"{type(error).__name__}: {error}", traceback.format_exc()))
    finally:
        messages.close()

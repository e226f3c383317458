"""The temporary folder of one job: made, used and removed in the thread where a session reads and writes files."""

import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from .worker import Job

_Result = TypeVar("_Result")


class JobFolder:
    """Not there before something is done with it; `files` has one thread, so that all happens in turn."""

    def __init__(self, files: ThreadPoolExecutor) -> None:
        self._files = files
        self._path: Path | None = None

    def do(self, work: Callable[[Path], _Result]) -> Future[_Result]:
        """Do something with the folder in the thread."""
        return self._files.submit(self._done, work)

    def remove(self, worker: Job | None) -> None:
        """End the process that works with the folder, then remove it: behind what was asked for before, not waited for.

        Ending a process and emptying a folder take their time, in which the window goes on.
        """
        self._files.submit(self._removed, worker)

    def _done(self, work: Callable[[Path], _Result]) -> _Result:
        if self._path is None:
            self._path = Path(tempfile.mkdtemp(prefix="gsrain-"))
        return work(self._path)

    def _removed(self, worker: Job | None) -> None:
        if worker is not None:
            worker.close()
        if self._path is not None:
            shutil.rmtree(self._path, ignore_errors=True)

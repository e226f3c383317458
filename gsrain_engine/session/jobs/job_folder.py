"""The temporary folder of one job: made, used and removed in the thread where a session reads and writes files."""

import os
import shutil
import tempfile
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from gsrain_engine.scene.file_lock import locked, locked_if_free

from .worker import Job

_Result = TypeVar("_Result")

_PREFIX = "gsrain-job-"


class JobFolder:
    """Not there before something is done with it; `files` has one thread, so that all happens in turn.

    A lock says that its process lives: where that was killed, the next one removes the folder.
    """

    def __init__(self, files: ThreadPoolExecutor) -> None:
        self._files = files
        self._path: Path | None = None
        self._open = ExitStack()

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
            self._path = self._open.enter_context(temporary_folder())
        return work(self._path)

    def _removed(self, worker: Job | None) -> None:
        if worker is not None:
            worker.close()
        self._open.close()


@contextmanager
def temporary_folder() -> Generator[Path]:
    """Make a folder that is there for as long as the block runs; see `remove_abandoned_folders`."""
    with ExitStack() as lock:
        path = _locked_folder(lock)
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)


def _locked_folder(lock: ExitStack) -> Path:
    while True:
        path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        with suppress(FileNotFoundError):
            lock.enter_context(locked(path))
        if path.is_dir():
            return path
        lock.close()  # another process took it for an abandoned one before it was locked


def remove_abandoned_folders() -> None:
    """Remove the folders of this user's processes that were killed. Without effect where the system knows no locks."""
    if os.name != "posix":
        return
    for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if path.is_symlink() or path.stat().st_uid != os.getuid():
                continue
            with locked_if_free(path) as is_free:
                if is_free:
                    shutil.rmtree(path, ignore_errors=True)

"""Folders and files of jobs: temporary folders, a copy of the document in one, and reports."""

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TypeVar

import platformdirs

from ...scene.files import lock_path, try_lock_path
from ...scene.formats.scene_folder import FileCache, write_scene_folder
from ...scene.scene import Scene
from .process import WorkerProcess, WorkerThread

_Result = TypeVar("_Result")
JOB_FOLDER_PREFIX = "gsrain-job-"


class JobTempDir:
    """The temporary folder of one job, created on first use; `files` has one thread, so that all access is in order.

    A lock marks the process as alive; after it was killed, a later process removes the folder.
    """

    def __init__(self, files: ThreadPoolExecutor) -> None:
        self._files = files
        self._path: Path | None = None
        self._open = ExitStack()

    def do(self, work: Callable[[Path], _Result]) -> Future[_Result]:
        """Call `work` with the folder in the thread."""

        def done() -> _Result:
            if self._path is None:
                self._path = self._open.enter_context(temporary_folder())
            return work(self._path)

        return self._files.submit(done)

    def remove(self, worker: WorkerProcess | WorkerThread | None = None) -> None:
        """End the worker, then remove the folder, after all earlier tasks and without waiting.

        Both take time, during which the window continues.
        """
        if worker is not None:
            worker.cancel()
            self._files.submit(worker.close)
        self._files.submit(self._open.close)


@contextmanager
def temporary_folder() -> Generator[Path]:
    """Create a folder for the duration of the block; see `remove_abandoned_job_folders`."""
    with ExitStack() as lock:
        while True:
            path = Path(tempfile.mkdtemp(prefix=JOB_FOLDER_PREFIX))
            with suppress(FileNotFoundError):
                lock.enter_context(lock_path(path))
            if path.is_dir():
                break
            lock.close()  # another process removed it as abandoned before it was locked
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)


def remove_abandoned_job_folders() -> None:
    """Remove folders of this user's killed processes. Does nothing on systems other than POSIX."""
    if os.name != "posix":
        return
    for path in Path(tempfile.gettempdir()).glob(f"{JOB_FOLDER_PREFIX}*"):
        with suppress(OSError):
            if path.is_symlink() or path.stat().st_uid != os.getuid():
                continue
            with try_lock_path(path) as is_free:
                if is_free:
                    shutil.rmtree(path, ignore_errors=True)


# Copy of the document


def write_copy(scene: Scene, folder: Path, known: FileCache) -> Path:
    """Write a scene into a temporary folder and return the scene folder. Links known files instead of writing them."""
    copy = folder / "scene"
    write_scene_folder(scene, copy, known, linking=True, in_drawing_order=True)
    known.forget(copy)  # it will be removed soon
    return copy


# Reports

_MAX_SUBJECT_BYTES = 120  # of the report's subject in its file name


def new_report(name: str) -> Path:
    """Choose a report file for `name`, by the present date and time; its folder may not exist yet."""
    folder = platformdirs.user_data_path("gsrain", appauthor=False) / "reports"
    about = re.sub(r"[/\x00-\x1f\x7f]", "_", name).encode(errors="replace")[:_MAX_SUBJECT_BYTES].decode(errors="ignore")
    when = f"{datetime.now():%Y-%m-%d_%H-%M-%S}"
    places = (folder / f"{about}_{when}{suffix}.html" for suffix in ("", *(f"_{number}" for number in range(2, 100))))
    return next((place for place in places if not place.exists()), folder / f"{about}_{when}.html")

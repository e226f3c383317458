"""Folders and files of jobs: temporary folders, a copy of the document in one, and reports."""

import os
import re
import shutil
import tempfile
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from itertools import chain, count
from pathlib import Path

import platformdirs

from ...safe_io.files import lock_path
from ...scene.formats.scene_folder import FileCache, write_scene_folder
from ...scene.scene import Scene

JOB_FOLDER_PREFIX = "gsrain-job-"


@contextmanager
def temporary_folder() -> Generator[Path]:
    """Create a folder for the duration of the block.

    A lock marks the process as alive; after it was killed, `remove_abandoned_job_folders` of a later one removes the
    folder.
    """
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
            with lock_path(path, waiting=False) as is_free:
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
    return new_file(folder, about, ".html")


def new_file(folder: Path, name: str, suffix: str) -> Path:
    """Choose an unused file name by the present date and time."""
    dated = f"{name}_{datetime.now():%Y-%m-%d_%H-%M-%S}"
    stems = chain([dated], (f"{dated}_{number}" for number in count(2)))
    return next(file for stem in stems if not os.path.lexists(file := folder / f"{stem}{suffix}"))

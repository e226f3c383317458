"""The document on the disk for another process: a temporary scene folder, and the end of it."""

import shutil
import tempfile
from concurrent.futures import Future
from pathlib import Path

from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.formats.scene_folder import write_scene_folder
from gsrain_engine.scene.scene import Scene

from .worker import Job

SCENE = "scene"
"""Name of the scene folder in the temporary one."""


def copy_scene(scene: Scene, known: KnownFiles) -> Path:
    """Write a scene for another process; returns the temporary folder. Files that are known are linked, not written."""
    folder = Path(tempfile.mkdtemp(prefix="gsrain-"))
    try:
        write_copy(scene, folder, known)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def write_copy(scene: Scene, folder: Path, known: KnownFiles) -> Path:
    """Write a scene into a temporary folder; returns the scene folder in it."""
    write_scene_folder(scene, folder / SCENE, known, linking=True, in_drawing_order=True)
    known.forget(folder / SCENE)  # it will be gone soon
    return folder / SCENE


def remove_copy(worker: Job | None, saving: "Future[Path] | None", folder: Path | None) -> None:
    """End the process that reads the copy, then remove it; in the thread that wrote it, after whatever came before."""
    if worker is not None:
        worker.close()
    if saving is not None and not saving.cancelled() and saving.exception() is None:
        folder = saving.result()
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)

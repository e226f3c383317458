"""The document on the disk for another process: a scene folder in a job's temporary one."""

from pathlib import Path

from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.formats.scene_folder import write_scene_folder
from gsrain_engine.scene.scene import Scene

_SCENE = "scene"


def write_copy(scene: Scene, folder: Path, known: KnownFiles) -> Path:
    """Write a scene into a temporary folder; returns the scene folder. Files that are known are linked, not written."""
    copy = folder / _SCENE
    write_scene_folder(scene, copy, known, linking=True, in_drawing_order=True)
    known.forget(copy)  # it will be gone soon
    return copy

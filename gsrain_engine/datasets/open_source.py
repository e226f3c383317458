"""Opening of what is named in one word: a scene or a capture."""

from pathlib import Path

from ..safe_io.fingerprints import input_fingerprint
from ..scene.formats.registry import format_of
from ..scene.formats.scene_files import is_foreign_scene_folder
from ..scene.open import is_built_in, load_scene, load_sorted_scene, scene_folder_of, scene_hash
from ..scene.scene import Scene
from .capture import Capture
from .open_capture import capture_format, open_capture


def names_scene(name: Path | str | None) -> bool:
    """Return whether a name is that of a scene; None is the street.

    Ambiguous folders, such as scene.json with images, count as scenes.
    """
    if is_built_in(name):
        return True
    path = Path(str(name))
    return scene_folder_of(path) is not None or format_of(path) is not None or is_foreign_scene_folder(path)


def open_source(name: Path | str | None) -> Scene | Capture:
    """Open a scene, in drawing order, or a capture.

    Raises `SceneFormatError` or `CaptureError`, which name the file and what is wrong.
    """
    return load_sorted_scene(name) if names_scene(name) else open_capture(str(name))


def source_hash(name: Path | str | None) -> str:
    """Return a hash (16 hex digits) of a source: of a scene's contents, or of a capture's names, sizes and times."""
    return scene_hash(None if name is None else str(name)) if names_scene(name) else input_fingerprint(Path(str(name)))


def missing_source(name: Path | str | None) -> list[str]:
    """Return the reason if a source is not there, as a list of one line; empty if it is, or for None."""
    if name is None or is_built_in(name) or Path(name).exists() or capture_format(name) is not None:
        return []
    try:
        load_scene(name) if names_scene(name) else open_capture(name)
    except ValueError as error:
        return [str(error)]
    return []

"""Content hashes of scenes and files, independent of their path and name."""

import hashlib
from pathlib import Path

from ..safe_io.limits import open_file
from .files import SceneFormatError
from .formats.scene_folder import scene_folder_files
from .open import folder_to_read, is_built_in_street, street_fingerprint

_DIGITS = 16


def scene_hash(name: str | None) -> str:
    """Hash (16 hex digits) of a scene by the name that `load_scene` takes.

    It covers the bytes of its files, or the source of the built-in street. Raises `SceneFormatError` if it does not
    exist.
    """
    if is_built_in_street(name):
        return street_fingerprint()
    path = Path(str(name))
    folder = folder_to_read(path)
    if folder is None:
        if not path.is_file():
            raise SceneFormatError(path, "no such scene")
        return file_hash(path)
    found = hashlib.sha256()
    for file in scene_folder_files(folder):
        found.update(f"{file.relative_to(folder).as_posix()}\0{file_hash(file)}\n".encode())
    return found.hexdigest()[:_DIGITS]


def file_hash(path: Path) -> str:
    """Hash (SHA-256, 16 hex digits) of a file's bytes; raises OSError if it can't be read."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:_DIGITS]

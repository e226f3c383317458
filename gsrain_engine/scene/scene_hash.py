"""Hashes of what files hold: equal hashes, equal scenes, wherever and under whatever name they lie."""

import hashlib
from pathlib import Path

from ..safe_io.limits import open_file
from .files import SceneFormatError
from .formats.scene_folder import scene_folder_files
from .open import folder_to_read, is_built_in_street, street_fingerprint

_DIGITS = 16


def scene_hash(name: str | None) -> str:
    """Return a hash (16 hex digits) of a scene that a person names.

    It is that of the bytes of its files; of the built-in street, that of its source. Raises `SceneFormatError` for what
    is not there.
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
    """Return a hash (SHA-256, 16 hex digits) of a file's bytes; raises OSError where it can't be read."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:_DIGITS]

"""Fingerprints of files and folders, by which a run says what it was made of."""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


def input_fingerprint(path: Path) -> str:
    """Hash (16 hex digits) of names, sizes and times, not contents, of a file or folder; "absent" without one."""
    if not path.exists():
        return "absent"
    found = hashlib.sha256()
    for file in [path] if path.is_file() else _files_below(path):
        about = file.stat()
        found.update(f"{file.relative_to(path).as_posix()}\0{about.st_size}\0{about.st_mtime_ns}\n".encode())
    return found.hexdigest()[:16]


def _files_below(folder: Path) -> Iterator[Path]:
    for root, folders, files in os.walk(folder):
        folders.sort()
        yield from (Path(root) / name for name in sorted(files) if (Path(root) / name).is_file())

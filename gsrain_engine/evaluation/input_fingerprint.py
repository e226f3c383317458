"""Fingerprint of input files by names, sizes and modification times, without their content."""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


def input_fingerprint(path: Path) -> str:
    """Return a hash (SHA-256, 16 hex digits) over names, sizes and times of a file, or of all files in a folder.

    Contents are not read, since weights and datasets are large. "absent" for a missing path.
    """
    found = hashlib.sha256()
    if not path.exists():
        return "absent"
    for file in [path] if path.is_file() else _below(path):
        about = file.stat()
        name = file.relative_to(path).as_posix()
        found.update(f"{name}\0{about.st_size}\0{about.st_mtime_ns}\n".encode())
    return found.hexdigest()[:16]


def _below(folder: Path) -> Iterator[Path]:
    for root, folders, files in os.walk(folder):
        folders.sort()
        yield from (Path(root) / name for name in sorted(files) if (Path(root) / name).is_file())

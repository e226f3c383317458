"""What a scene folder looked like when it was read or written: to notice that somebody else has changed it since."""

import hashlib
from pathlib import Path

import msgspec

from gsrain_engine.scene.formats.scene_folder import SCENE_FILE
from gsrain_engine.untrusted.limits import read_file


class DiskStamp(msgspec.Struct, frozen=True, kw_only=True):
    """State of a folder's `scene.json`."""

    modified_ns: int
    size: int
    digest: str


def stamp_of(folder: Path) -> DiskStamp | None:
    """State of a scene folder now; None where there is no scene."""
    file = folder / SCENE_FILE
    try:
        status, data = file.stat(), read_file(file)
    except OSError:
        return None
    digest = hashlib.blake2b(data, digest_size=16).hexdigest()
    return DiskStamp(modified_ns=status.st_mtime_ns, size=len(data), digest=digest)


def has_changed(folder: Path, since: DiskStamp | None) -> bool:
    """Whether a scene stands there that is not the one of before; to be touched alone is no change."""
    try:
        status = (folder / SCENE_FILE).stat()
    except OSError:
        return False  # gone: nothing that could be lost
    if since is not None and (status.st_mtime_ns, status.st_size) == (since.modified_ns, since.size):
        return False
    now = stamp_of(folder)
    return now is not None and (since is None or now.digest != since.digest)

"""Names of files to be written: those that a disk takes, and long ones that are derived from names of people's own."""

import hashlib
import os
import re
import sys
from pathlib import Path

from gsrain_engine.untrusted.printable import printable

DEFAULT_NAME_BYTES = 255
"""That a name may have on nearly all disks; some that encrypt take 143."""

_MAX_PATH_BYTES = 4096
_PART_BYTES = 64
"""Of a path that stay free for what is written for a while on the way to it, and for numbered files in it."""
_STEM_BYTES = 160
"""Of a derived name without its ending: passes, cameras and hashes may be added."""
_HASH_DIGITS = 8
_IMPOSSIBLE = re.compile(r'[\\/:*?"<>|\x00-\x1f\x7f]+')


def file_word(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name as part of a file's: what would lead into another folder, or nowhere, becomes a dash.

    One of more than `max_bytes` is `shortened`.
    """
    return shortened(_IMPOSSIBLE.sub("-", name).lstrip(".") or "-", max_bytes)


def shortened(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name of at most so many bytes: one that is longer is cut, and ends in a hash of the whole.

    Names of the same beginning stay apart, and the same name gives the same word everywhere.
    """
    whole = _bytes(name)
    if len(whole) <= max_bytes:
        return os.fsdecode(whole)
    digest = hashlib.blake2b(whole, digest_size=_HASH_DIGITS // 2).hexdigest()
    return f"{whole[: max_bytes - _HASH_DIGITS - 1].decode(sys.getfilesystemencoding(), errors='ignore')}-{digest}"


def name_problem(path: Path) -> str | None:
    """Return what a disk has against the name of a file or folder that is to be written; None where nothing."""
    if "\0" in str(path):
        return "a name can't hold a zero byte"
    try:
        os.fsencode(path)
    except UnicodeEncodeError as error:
        sign = repr(error.object[error.start : error.end])
        return f"the character set of this system ({error.encoding}) lacks {sign}; set LC_ALL=C.UTF-8"
    place = Path(os.path.abspath(path))  # noqa: PTH100  that of Path keeps `..`, which counts
    max_bytes = _max_name_bytes(place.parent)
    for part in place.parts[1:]:
        if (size := len(os.fsencode(part))) > max_bytes:
            return f"the name {printable(part[:24])}... has {size} bytes, and the disk takes {max_bytes}"
    if (size := len(os.fsencode(place))) > _MAX_PATH_BYTES - _PART_BYTES:
        return f"the path has {size} bytes, and the disk takes {_MAX_PATH_BYTES - _PART_BYTES}"
    return None


def _max_name_bytes(folder: Path) -> int:
    """Bytes that a name in a folder may have, by the next folder above it that is there."""
    for each in (folder, *folder.parents):
        try:
            return os.pathconf(each, "PC_NAME_MAX")
        except (OSError, ValueError, AttributeError):  # not there, or a system that has none
            continue
    return DEFAULT_NAME_BYTES


def _bytes(name: str) -> bytes:
    try:
        return os.fsencode(name)
    except UnicodeEncodeError:  # half of a pair of UTF-16, which no file's name can hold
        return name.encode(errors="replace")

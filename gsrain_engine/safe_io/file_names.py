"""File names: safe, short enough, and possible on the disk."""

import hashlib
import os
import re
import sys
from pathlib import Path

from .text_files import printable_line

DEFAULT_NAME_BYTES = 255
"""Length limit on nearly all file systems; some encrypting ones allow 143."""

_MAX_PATH_BYTES = 4096
_PART_BYTES = 64  # bytes reserved in a path for temporary names and for numbered files in it
_STEM_BYTES = 160  # bytes of a derived name without its suffix: passes, cameras and hashes may be appended
_HASH_DIGITS = 8
_IMPOSSIBLE = re.compile(r'[\\/:*?"<>|\x00-\x1f\x7f]+')


def visible_siblings(path: Path) -> list[str]:
    """Names in the folder of a path that a user may have meant: neither hidden nor locks. Empty without a folder."""
    if not path.parent.is_dir():
        return []
    names = (each.name for each in path.parent.iterdir())
    return [name for name in names if not name.startswith(".") and not name.endswith(".lock")]


def file_word(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name as part of a file name: separators and other unsafe characters become dashes.

    A name of more than `max_bytes` is `shortened`.
    """
    return shortened(_IMPOSSIBLE.sub("-", name).lstrip(".") or "-", max_bytes)


def shortened(name: str, max_bytes: int = _STEM_BYTES) -> str:
    """Return a name of at most `max_bytes`: a longer one is cut, and ends in a hash of the whole.

    Names with a common beginning stay distinct, and the result is the same on every machine.
    """
    whole = _bytes(name)
    if len(whole) <= max_bytes:
        return os.fsdecode(whole)
    digest = hashlib.blake2b(whole, digest_size=_HASH_DIGITS // 2).hexdigest()
    return f"{whole[: max_bytes - _HASH_DIGITS - 1].decode(sys.getfilesystemencoding(), errors='ignore')}-{digest}"


def name_problem(path: Path) -> str | None:
    """Reason why the file system would refuse to create a file or folder of this name; None if there is none."""
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
            return f"the name {printable_line(part[:24])}... has {size} bytes, and the disk takes {max_bytes}"
    if (size := len(os.fsencode(place))) > _MAX_PATH_BYTES - _PART_BYTES:
        return f"the path has {size} bytes, and the disk takes {_MAX_PATH_BYTES - _PART_BYTES}"
    return None


def _max_name_bytes(folder: Path) -> int:
    """Maximum bytes of a name in a folder, from its nearest existing parent."""
    for each in (folder, *folder.parents):
        try:
            return os.pathconf(each, "PC_NAME_MAX")
        except (OSError, ValueError, AttributeError):  # missing, or a system without this limit
            continue
    return DEFAULT_NAME_BYTES


def _bytes(name: str) -> bytes:
    try:
        return os.fsencode(name)
    except UnicodeEncodeError:  # a lone UTF-16 surrogate, which no file name can hold
        return name.encode(errors="replace")

"""Names of views that are fit for files, and of the cameras whose pictures lie in folders of their own."""

from collections import Counter
from collections.abc import Sequence
from pathlib import PurePosixPath


def view_names(pictures: Sequence[str]) -> list[str]:
    """Name views after their pictures' paths, one each: folders that all share and suffixes that nobody needs left out.

    Other folders stay, joined by "_".
    """
    flat = ["_".join(parts) for parts in _parts(pictures)]
    short = [name.rpartition(".")[0] or name for name in flat]
    counted = Counter(short)
    return _apart([each if counted[each] == 1 else whole for each, whole in zip(short, flat, strict=True)])


def sensor_names(pictures: Sequence[str]) -> list[str]:
    """Name the camera of each picture after its folder, without folders that all share; empty where that is all."""
    return ["_".join(parts[:-1]) for parts in _parts(pictures)]


def _parts(pictures: Sequence[str]) -> list[tuple[str, ...]]:
    """Folders and name of each picture, without the folders that all have in common."""
    parts = [
        tuple(part for part in PurePosixPath(picture.replace("\\", "/")).parts if part not in ("/", ".", ".."))
        or ("unnamed",)
        for picture in pictures
    ]
    shared = 0
    while parts and all(len(each) > shared + 1 and each[shared] == parts[0][shared] for each in parts):
        shared += 1
    return [each[shared:] for each in parts]


def _apart(names: Sequence[str]) -> list[str]:
    """Number the names that come again."""
    apart: dict[str, None] = {}
    for name in names:
        number, free = 1, name
        while free in apart:
            number += 1
            free = f"{name}_{number}"
        apart[free] = None
    return list(apart)

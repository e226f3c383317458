"""Reading and writing of scenes as files or folders of any format."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...safe_io.errors import SceneFormatError
from ...safe_io.file_names import visible_siblings
from ..scene import Scene
from ..transforms import recentered
from ._common import printable_name, single_layer, stem_of
from .hugsim import hugsim_files, is_hugsim_folder, read_hugsim
from .registry import close_match, format_of, read_scene_file, write_scene_file
from .scene_folder import SCENE_FILE, FileCache, read_scene_folder, write_scene_folder
from .sog import is_sog_folder, read_sog

SOG_FILE = "meta.json"
"""Description file of a SOG scene unpacked into a folder."""

_MAX_LISTED = 3
_ITERATIONS, _ITERATION = (
    "point_cloud/iteration_*/point_cloud.ply",
    re.compile(r"(?:^|/)point_cloud/iteration_(\d{1,9})/point_cloud\.ply$"),
)
INNER_SCENE = "scene"
"""Folder of the scene in the output of `gsrain street`."""


def read_scene(path: Path | str, known: FileCache | None = None) -> Scene:
    """Read a scene folder, a file of any format in `FORMATS`, or a SOG folder.

    Records in `known` which Gaussians the files of a scene folder hold.

    A single file becomes one background layer named after it, with a unit of 1 m and -y upwards: the axes of COLMAP and
    3DGS captures, and an assumed unit, as the file holds none. A `.usdz` holds layers, actors, rigs, axes and unit. Of
    the output folder of a training of 3DGS, the last iteration is read.

    Raises `SceneFormatError` if it does not exist or can't be read, is no scene, is damaged, or is from a newer
    program; the message is one sentence.
    """
    path = Path(path)
    try:
        return _read(path, known)
    except FileNotFoundError as error:
        missing = Path(error.filename or path)
        raise SceneFormatError(missing, f"there is no such file or folder{_sibling_file(missing)}") from None
    except OSError as error:
        raise SceneFormatError(error.filename or path, f"can't be read: {error.strerror or error}") from None


def is_foreign_scene_folder(folder: Path) -> bool:
    """Return whether a folder holds a scene of another program: of SOG or HUGSIM, or a training of 3DGS."""
    return is_sog_folder(folder) or is_hugsim_folder(folder) or trained_file(folder) is not None


def foreign_scene_files(folder: Path) -> list[Path]:
    """Files of a scene of another program that are read, by name."""
    if is_hugsim_folder(folder):
        return hugsim_files(folder)
    if not is_sog_folder(folder) and (trained := trained_file(folder)) is not None:
        return [trained]
    return sorted(file for file in folder.rglob("*") if file.suffix in (".json", ".webp") and file.is_file())


def trained_file(folder: Path) -> Path | None:
    """File of the last iteration in the output folder of a training of 3DGS; None without one."""
    try:
        names = [file.relative_to(folder).as_posix() for file in folder.glob(_ITERATIONS)]
    except OSError:
        return None
    found = last_iteration(names)
    return None if found is None else folder / found


def last_iteration(names: Sequence[str]) -> str | None:
    """Name of the last iteration's file among names of files; None without one."""
    numbered = [(int(found[1]), name) for name in names if (found := _ITERATION.search(name))]
    return max(numbered)[1] if numbered else None


def names_scene_folder(path: Path) -> bool:
    """Return whether a scene is written to this path as a folder: its name has no suffix of a file format."""
    return path.is_dir() or (format_of(path) is None and not re.fullmatch(r"\.[A-Za-z]\w*", path.suffix))


def write_scene(
    scene: Scene, path: Path | str, known: FileCache | None = None, *, in_drawing_order: bool = False
) -> None:
    """Write a scene folder, or, if the name ends in a suffix of `FORMATS`, a single file. Missing parents are created.

    A single file gets all visible layers, and the visible actors as at time 0, in meters with -y upwards (see
    `flatten_scene`), but a `.usdz`, which keeps layers, tracks and rigs. In a scene folder, files that hold the
    identical Gaussians according to `known` are not written again; `in_drawing_order` records there that the Gaussians
    are in LOD order and need no sorting when opened. Either is written atomically; the old one stays until then.

    Raises `SceneFormatError` if the format can't be written or another kind of file is in the way, and `OSError` if the
    file system refuses.
    """
    path = Path(path)
    path.absolute().parent.mkdir(parents=True, exist_ok=True)
    if names_scene_folder(path):
        write_scene_folder(scene, path, known, in_drawing_order=in_drawing_order)
    else:
        write_scene_file(scene, path)


def _read(path: Path, known: FileCache | None) -> Scene:
    path.stat()  # a missing file is reported as such, whatever its suffix
    if path.name == SCENE_FILE:
        path = path.parent
    if not path.is_dir():
        found = read_scene_file(path)
        if isinstance(found, Scene):
            return recentered(found)
        row = format_of(path)
        return recentered(single_layer(stem_of(path, row.suffix if row else ""), found))
    if (path / SCENE_FILE).is_file():
        return read_scene_folder(path, known)
    if is_sog_folder(path):
        return recentered(single_layer(path.resolve().name, read_sog(path)))
    if is_hugsim_folder(path):
        return read_hugsim(path)
    if not (path / INNER_SCENE / SCENE_FILE).is_file() and (trained := trained_file(path)) is not None:
        return replace(_read(trained, known), name=printable_name(path.resolve().name))
    if (path / INNER_SCENE / SCENE_FILE).is_file():
        return read_scene_folder(path / INNER_SCENE, known)
    told = f"a scene folder holds {SCENE_FILE} and a SOG folder {SOG_FILE}; this has neither"
    if (path / SOG_FILE).is_file():
        told += f" (its {SOG_FILE} is none of SOG: it does not say where the means are)"
    inside = scene_files_in(path)
    raise SceneFormatError(path, told + (f"; give one of the files in it: {', '.join(inside)}" if inside else ""))


def scene_files_in(folder: Path) -> list[str]:
    """Names of up to three scenes in a folder; empty if it can't be read."""
    try:
        names = sorted(each.name for each in folder.iterdir() if each.is_file() and format_of(each) is not None)
    except OSError:
        return []
    found = [name for name in names if name != SOG_FILE]
    return found if len(found) <= _MAX_LISTED else [*found[:_MAX_LISTED], f"and {len(found) - _MAX_LISTED} more"]


def _sibling_file(path: Path) -> str:
    """Suggest a file in the same folder with a similar name, if there is one."""
    try:
        return close_match(path.name, visible_siblings(path))
    except OSError:
        return ""

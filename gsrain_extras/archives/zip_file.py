"""Zip files of one scene: a file of any format, or a folder with one."""

import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.safe_io.limits import ExpansionBudget, read_file
from gsrain_engine.scene.formats import Format, read_scene
from gsrain_engine.scene.formats.registry import format_of
from gsrain_engine.scene.formats.scene_files import last_iteration
from gsrain_engine.scene.formats.stored_zip import open_zip, read_member
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.transforms import flatten_scene

_OF_FOLDERS = ("scene.json", "meta.json", "lod-meta.json", "scene.pth", "gs.pth")
"""Files that name a scene together with others of their folder; the first kind of which there is one counts."""

_WITH_OTHERS = (".gltf",)  # suffixes of files that may name others
_IGNORED = ("__MACOSX", ".")  # beginnings of names that archivers add
_LEFT_OUT = (".lod",)  # trees are mapped into memory, and built anew instead
_MAX_LISTED = 3


def read_zip(path: Path) -> Gaussians:
    """Read all that is visible in a zipped scene as at its first moment; see `read_zip_scene`."""
    return flatten_scene(read_zip_scene(path))


def read_zip_scene(path: Path) -> Scene:
    """Read the only scene in a zip file, or the last iteration of a training of 3DGS; it is unpacked to a folder.

    Raises `SceneFormatError` if there is none or more than one in it, or it is damaged or expands too much.
    """
    data = read_file(path)
    budget = ExpansionBudget(len(data), path)
    with open_zip(path, data) as archive, tempfile.TemporaryDirectory(prefix="gsrain-zip-") as folder:
        name, needed = _only_scene(path, _names(path, archive))
        for each in needed:
            place = Path(folder, *PurePosixPath(each).parts)
            place.parent.mkdir(parents=True, exist_ok=True)
            content = read_member(path, archive, each, budget.left_bytes)
            budget.spend(len(content))
            place.write_bytes(content)
        found = Path(folder, *PurePosixPath(name).parts)
        try:
            return read_scene(found)
        except SceneFormatError as error:
            part = "" if error.path == found else f"{Path(error.path).name} in it: "
            raise SceneFormatError(path, f"{part}{error.problem}") from None


def _names(path: Path, archive: zipfile.ZipFile) -> list[str]:
    """Names of the files in an archive, without those of archivers, in order."""
    names = [each.filename for each in archive.infolist() if each.filename and not each.is_dir()]
    for name in names:
        parts = PurePosixPath(name).parts
        if PurePosixPath(name).is_absolute() or ".." in parts or "\\" in name or ":" in name or "\0" in name:
            raise SceneFormatError(path, f"{name[:40]!r} is no name of a file inside of it")
    return sorted(name for name in names if not any(p.startswith(_IGNORED) for p in PurePosixPath(name).parts))


def _only_scene(path: Path, names: Sequence[str]) -> tuple[str, list[str]]:
    """Name of the only scene, a file or a folder, and the files that it needs."""
    for kind in _OF_FOLDERS:
        folders = [str(PurePosixPath(name).parent) for name in names if PurePosixPath(name).name == kind]
        if len(folders) == 1 or (folders and kind == "lod-meta.json"):
            inside = [each for each in names if folders[0] == "." or each.startswith(f"{folders[0]}/")]
            return folders[0], [each for each in inside if not each.endswith(_LEFT_OUT)]
        if folders:
            raise SceneFormatError(path, f"it holds {len(folders)} scenes ({kind}): unpack it, and give one of them")
    scenes = [name for name in names if format_of(Path(name)) is not None and not name.lower().endswith(".zip")]
    if (trained := last_iteration(scenes)) is not None:
        scenes = [trained]
    if len(scenes) != 1:
        listed = ", ".join(scenes[:_MAX_LISTED]) + (", ..." if len(scenes) > _MAX_LISTED else "")
        held = f"{len(scenes)} scenes ({listed}): unpack it, and give one of them" if scenes else "no scene"
        raise SceneFormatError(path, f"it holds {held}")
    beside = str(PurePosixPath(scenes[0]).parent)
    others = names if scenes[0].lower().endswith(_WITH_OTHERS) else scenes
    return scenes[0], [each for each in others if str(PurePosixPath(each).parent).startswith(beside) or beside == "."]


FORMAT = Format(".zip", read_zip, None, "one scene of any of these formats, or its folder", read_scene=read_zip_scene)

"""Scene folders: `scene.json`, one 3DGS PLY per layer and actor, and files of their wet colors."""

import hashlib
import logging
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float32

from ...safe_io.errors import SceneFormatError, readable_validation_error
from ...safe_io.files import hold_for_writing, lock_path, naming_path, sync, whole_file, whole_folder
from ...safe_io.limits import open_file, read_file
from ...safe_io.numpy_files import read_array_header
from ...safe_io.text_files import check_finite as check_finite_values
from ..gaussians import Gaussians
from ..lod_tree import LodTree
from ..mapped_arrays import map_arrays
from ..scene import Actor, Layer, Scene
from ._common import check_finite
from .lod_file import read_lod_tree, write_lod_tree
from .ply import ply_rows, write_ply
from .registry import check_writable, read_gaussians
from .scene_json import SCENE_VERSION, SceneRecord, record_of, scene_of

logger = logging.getLogger("gsrain")
SCENE_FILE = "scene.json"
_LARGEST_SCENE_FILE = 1 << 26
"""Bytes; an hour's track at 10 Hz takes 5 MB; a mask of a million Gaussians at most 0.17 MB."""

_OURS = re.compile(r"\d{3}-.+-([0-9a-f]{12})\.(?:ply|wet\.npy|lod)|\.\d{3}-.+\.part|\.scene\.json\.[0-9a-f]{8}\.part")
"""Names that only this program uses, also for the remains of killed writers. The group is the hash of the contents."""


class _FolderVersion(msgspec.Struct):
    version: int


class _FolderOrder(msgspec.Struct):
    in_drawing_order: bool = False


# Cache of written files

Contents = Gaussians | Float32[np.ndarray, "_ _ 3"]
"""Content of one file: Gaussians, or harmonics alone. Both are immutable."""


class _CachedFile(NamedTuple):
    contents: Contents
    path: Path
    state: tuple[int, int, int]


class FileCache:
    """Values last read from, or written to, each folder, so that unchanged ones are not written again. Not thread-safe.

    Identical objects have identical bytes; a file changed since by another program is not trusted. Holds references to
    the values, as their scene does anyway, until the folder is written again.
    """

    def __init__(self) -> None:
        self._folders: dict[Path, list[_CachedFile]] = {}

    def remember(self, folder: Path, kept: list[tuple[Contents, Path]]) -> None:
        """Record which files of a folder hold which values, replacing earlier records of this folder."""
        self._folders[folder.resolve()] = [_CachedFile(contents, path, _state(path)) for contents, path in kept]

    def forget(self, folder: Path) -> None:
        self._folders.pop(folder.resolve(), None)

    def file_in(self, folder: Path, contents: Contents, taken: set[Path]) -> Path | None:
        """File of this folder with exactly these values, except taken ones; None if there is none."""
        files = _with_contents(self._folders.get(folder.resolve(), []), contents)
        return next((path for path in files if path not in taken), None)

    def file_anywhere(self, contents: Contents) -> Path | None:
        """File of any folder with exactly these values; None if there is none."""
        return next(_with_contents(chain.from_iterable(self._folders.values()), contents), None)


def _with_contents(files: Iterable[_CachedFile], contents: Contents) -> Iterator[Path]:
    for each in files:
        with suppress(OSError):
            if each.contents is contents and _state(each.path) == each.state:
                yield each.path


def _state(path: Path) -> tuple[int, int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size, status.st_ino


def read_scene_folder(folder: Path, known: FileCache | None = None) -> Scene:
    """Read a scene folder of this version or an older one; records in `known` which Gaussians its files hold.

    Raises `SceneFormatError` if a file is missing, damaged, newer than this program or outside the folder.
    """
    record = _read_record(folder)
    try:
        places = _places(folder, record)
        trees = _mapped_trees([places[file] for file in record.files]) if record.in_drawing_order else {}
        gaussians = [_gaussians_of(places[file], trees) for file in record.files]
        wet = [
            None if file is None else read_harmonics(places[file], each.sh.shape, maps=places[own] in trees)
            for file, own, each in zip(record.wet_files, record.files, gaussians, strict=True)
        ]
    except (SceneFormatError, FileNotFoundError):
        if _read_record(folder) == record:
            raise
        return read_scene_folder(folder, known)  # another process has replaced the scene and its files meanwhile
    if known is not None:
        read = [*gaussians, *(each for each in wet if each is not None)]
        known.remember(folder, list(zip(read, places.values(), strict=True)))
    try:
        scene = scene_of(record, gaussians, wet)
    except ValueError as error:
        raise SceneFormatError(folder / SCENE_FILE, str(error)) from None
    for member, file in zip(scene.members, record.files, strict=True):
        if places[file] in trees:
            scene = scene.with_member(member.key, tree=trees[places[file]])
    return scene


def scene_folder_files(folder: Path) -> list[Path]:
    """Files of a scene folder: `scene.json`, then those of its layers and actors.

    Raises `SceneFormatError` if one is missing, or `scene.json` is no scene description.
    """
    return [folder / SCENE_FILE, *_places(folder, _read_record(folder)).values()]


def is_in_drawing_order(folder: Path) -> bool:
    """Return whether the Gaussians of a scene folder are in LOD order.

    Raises `SceneFormatError` if its `scene.json` is no scene description.
    """
    return msgspec.json.decode(_checked_version(folder), type=_FolderOrder).in_drawing_order


def write_scene_folder(
    scene: Scene,
    folder: Path,
    known: FileCache | None = None,
    *,
    linking: bool = False,
    in_drawing_order: bool = False,
) -> None:
    """Write or replace a scene folder atomically: readers always find the old scene or the new one, complete.

    A new folder is written next to its path and renamed. In an existing one, new Gaussians are written to new files,
    `scene.json` is replaced, which switches to the new scene, and then the old files are removed, with the remains of
    killed writers. Unrelated files stay. Files that hold the identical Gaussians according to `known` stay in place;
    with `linking`, those of other folders are hard-linked here instead of written again.

    One process writes at a time.

    Raises:
        PathInUseError: When another process writes to the folder, or has reserved it.
        SceneFormatError: When the path holds anything but a scene folder of this version or an older one, or when the
            scene has values that could not be read again.
        OSError: When it can't be written; the old scene is unchanged.
    """
    folder = folder.resolve()
    writer = _Writer(scene, known or FileCache(), linking, in_drawing_order)
    _check_writable(scene, folder, writer.known)
    if _is_new(folder):
        with whole_folder(folder) as beside:
            placed = writer.write(beside, set())
        placed = [(contents, folder / file.relative_to(beside)) for contents, file in placed]
    else:
        with hold_for_writing(folder), lock_path(folder), naming_path(folder, folder):
            old = _replaceable_files(folder)
            placed = writer.write(folder, old)
            used = {file for _, file in placed}
            for file in (old | _leftovers(folder)) - used - {tree_file(file) for file in used}:
                if _is_own(folder, file):  # removes only a link itself, never its target
                    file.unlink(missing_ok=True)
    writer.known.remember(folder, placed)


def _check_writable(scene: Scene, folder: Path, known: FileCache) -> None:
    """Reject a scene that could not be read again, before it replaces one that can."""
    gaussians = [each.gaussians for each in scene.members]
    for member in scene.members:
        if known.file_anywhere(member.gaussians) is None:  # values from a file were checked when read
            check_writable(folder, member.gaussians, f" of {_kind(member)[:-1]} {member.name!r}")
        if member.wet_sh is not None and known.file_anywhere(member.wet_sh) is None:
            check_finite(folder, {f"wet color of {_kind(member)[:-1]} {member.name!r}": member.wet_sh})
    record = record_of(scene, [""] * len(gaussians))
    try:
        check_finite_values(msgspec.to_builtins(record))  # JSON has neither NaN nor infinity: msgspec would write null
        scene_of(msgspec.json.decode(msgspec.json.encode(record), type=SceneRecord), gaussians)
    except (ValueError, RecursionError) as error:  # includes msgspec's errors and text that is not Unicode
        raise SceneFormatError(folder / SCENE_FILE, f"can't be written: {error}") from None


def _is_new(folder: Path) -> bool:
    if folder.exists() and not folder.is_dir():
        raise SceneFormatError(folder, "can't be written as a scene folder: a file of that name is in the way")
    return not folder.exists() or not any(folder.iterdir())


def _replaceable_files(folder: Path) -> set[Path]:
    """Check that a folder may be replaced, and return the files of its layers and actors."""
    if not (folder / SCENE_FILE).is_file():
        raise SceneFormatError(folder, f"not replaced: it holds files but no {SCENE_FILE}, so it is no scene folder")
    _checked_version(folder)
    try:
        return set(_places(folder, _read_record(folder)).values())
    except SceneFormatError:
        return set()  # a damaged scene may be replaced; its files are unknown


def _leftovers(folder: Path) -> set[Path]:
    """Files in a scene folder with names that only this program uses, including those of its present scene."""
    places = (folder, folder / "layers", folder / "actors")
    return {file for place in places if place.is_dir() for file in place.iterdir() if _OURS.fullmatch(file.name)}


@dataclass(frozen=True)
class _Writer:
    scene: Scene
    known: FileCache
    linking: bool
    in_drawing_order: bool

    def write(self, folder: Path, kept: set[Path]) -> list[tuple[Contents, Path]]:
        """Write files and `scene.json`; on failure remove the written files, except those in `kept`.

        Returns the contents of each file.
        """
        placed: list[tuple[Contents, Path]] = []
        written: set[Path] = set()

        def placed_at(member: Layer | Actor, index: int, contents: Contents) -> str:
            file = self.known.file_in(folder, contents, {file for _, file in placed})
            if file is None or file not in kept:
                file = self._written(member.name, contents, folder / _kind(member), index)
                written.add(file)
            placed.append((contents, file))
            return file.relative_to(folder).as_posix()

        try:
            members = list(enumerate(self.scene.members))
            names = [placed_at(each, index, each.gaussians) for index, each in members]
            wet_names = [
                None if each.wet_sh is None else placed_at(each, index, each.wet_sh) for index, each in members
            ]
            for each, (_, file) in zip(self.scene.members, placed, strict=False):
                if self.in_drawing_order and each.tree is not None and each.tree.fits(each.gaussians):
                    written |= self._tree_written(each.tree, file)
            for kind in {file.parent for file in written}:
                sync(kind)
            record = record_of(self.scene, names, wet_names, in_drawing_order=self.in_drawing_order)
            with whole_file(folder / SCENE_FILE) as beside:
                beside.write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=1))
        except BaseException:
            for file in written - kept:
                file.unlink(missing_ok=True)
            raise
        return placed

    def _written(self, name: str, contents: Contents, folder: Path, index: int) -> Path:
        """Write one file whose name ends in a hash of its bytes, so that it never overwrites a different one."""
        folder.mkdir(exist_ok=True)
        label = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:40] or "unnamed"
        beside = folder / f".{index:03d}-{label}.part"
        try:
            digest = self._linked(contents, beside)
            if digest is None:
                if isinstance(contents, Gaussians):
                    write_ply(contents, beside)
                else:
                    write_harmonics(contents, beside)
                sync(beside)
                with beside.open("rb") as file:
                    digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=6)).hexdigest()
            suffix = ".ply" if isinstance(contents, Gaussians) else SUFFIX
            return beside.replace(folder / f"{index:03d}-{label}-{digest}{suffix}")
        finally:
            beside.unlink(missing_ok=True)

    def _tree_written(self, tree: LodTree, file: Path) -> set[Path]:
        """Write a tree next to the file of its Gaussians, or link it, unless it is there."""
        path = tree_file(file)
        with suppress(SceneFormatError, OSError):
            read_lod_tree(path, file)
            return set()
        source = self.known.file_anywhere(tree.gaussians) if self.linking else None
        if source is not None and source.samefile(file) and tree_file(source).is_file():
            with suppress(OSError):  # another file system, or one without hard links
                path.unlink(missing_ok=True)
                os.link(tree_file(source).resolve(), path)
                return {path}
        with whole_file(path) as beside:
            write_lod_tree(tree, beside, file)
        return {path}

    def _linked(self, contents: Contents, target: Path) -> str | None:
        """Hard-link a known file with these values to `target`; returns the hash in the known file's name.

        If the file system can't link, the file is copied: written anew, numbers could differ in their last bits. None
        if there is no such file.
        """
        source = self.known.file_anywhere(contents) if self.linking else None
        ours = None if source is None else _OURS.fullmatch(source.name)
        if source is None or ours is None:
            return None
        target.unlink(missing_ok=True)
        try:
            os.link(source.resolve(), target)
        except OSError:  # another file system, or one without hard links
            shutil.copyfile(source, target)
            sync(target)
        return ours[1]


def tree_file(file: Path) -> Path:
    """Path of the tree of the Gaussians in a file."""
    return file.with_suffix(".lod")


def _mapped_trees(files: Iterable[Path]) -> dict[Path, LodTree]:
    """Trees next to files of Gaussians, with those Gaussians; the first one that can't be used is reported."""
    trees: dict[Path, LodTree] = {}
    damages: list[Exception] = []
    for file in files:
        path = tree_file(file)
        if path.is_file():
            try:
                trees[file] = read_lod_tree(path, file)
            except (SceneFormatError, OSError) as error:  # the scene opens without it
                damages.append(error)
    if damages:
        logger.warning("Level-of-detail trees are not used (%d): %s", len(damages), damages[0])
    return trees


def _gaussians_of(file: Path, trees: dict[Path, LodTree]) -> Gaussians:
    if file in trees:
        return trees[file].gaussians
    gaussians = read_gaussians(file)
    if file.suffix == ".ply" and len(gaussians) != ply_rows(file):
        raise SceneFormatError(file, "has unusable Gaussians: without them, masks and wet colors would fit no more")
    return gaussians


def _kind(member: Layer | Actor) -> str:
    return member.key.split("/")[0]


def _read_record(folder: Path) -> SceneRecord:
    data = _checked_version(folder)
    try:
        return msgspec.json.decode(data, type=SceneRecord)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(folder / SCENE_FILE, readable_validation_error(error, SceneRecord)) from None


def _checked_version(folder: Path) -> bytes:
    """Content of `scene.json`, after a check that its version is readable."""
    path = folder / SCENE_FILE
    data = read_file(path, _LARGEST_SCENE_FILE)
    try:
        version = msgspec.json.decode(data, type=_FolderVersion).version
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(path, f"not the description of a scene: {error}") from None
    if version > SCENE_VERSION:
        raise SceneFormatError(
            path, f"version {version} is of a newer program; this one reads versions up to {SCENE_VERSION}"
        )
    return data


def _places(folder: Path, record: SceneRecord) -> dict[str, Path]:
    """Paths of a record's files, in order; each name must be inside the folder and used once.

    A path may be a link to a file elsewhere: people store large files on another disk.
    """
    home = folder.resolve()
    places: dict[str, Path] = {}
    for file in record.every_file:
        place = Path(os.path.normpath(home / file.replace("\0", "?")))
        if Path(file).is_absolute() or home not in place.parents:
            raise SceneFormatError(folder / SCENE_FILE, f"file {file!r} must lie inside the scene folder")
        if not _is_file(place):
            raise SceneFormatError(folder / SCENE_FILE, f"there is no file {file!r} in the scene folder{_link(place)}")
        if place in places.values():
            raise SceneFormatError(folder / SCENE_FILE, f"file {file!r} must belong to one layer or actor only")
        places[file] = place
    return places


def _is_file(place: Path) -> bool:
    try:
        return place.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _link(place: Path) -> str:
    """Describe the target of a broken link."""
    try:
        return f" (what stands there is a link to {place.readlink()})"
    except (OSError, ValueError):
        return ""


def _is_own(folder: Path, file: Path) -> bool:
    """Return whether a file, or a link, is in the folder itself, not in a linked folder elsewhere."""
    return file.parent.resolve().is_relative_to(folder)


# Wet color files
# Spherical harmonics as a NumPy array file (.npy, version 1.0).

SUFFIX = ".wet.npy"
_HARMONICS_ROWS = 1 << 18  # rows that are checked at a time before a file is mapped


def read_harmonics(path: Path, shape: tuple[int, ...], *, maps: bool = False) -> Float32[np.ndarray, "n k 3"]:
    """Read harmonics of a given shape (n, k, 3), that of the clear colors; with `maps`, map them into memory.

    Raises `SceneFormatError` if the file is damaged, or has other content or another shape.
    """
    with open_file(path) as file:
        try:
            found, is_fortran, dtype = read_array_header(file)
        except ValueError as error:
            raise SceneFormatError(path, f"no array file of wet colors: {error}") from None
        if dtype != np.dtype("<f4") or is_fortran or found != shape:
            order = " in Fortran's order" if is_fortran else ""
            raise SceneFormatError(path, f"holds {dtype} {found}{order}, expected float32 {shape} as the clear colors")
        offset, step = file.tell(), _HARMONICS_ROWS if maps else shape[0]
        sh = np.empty((min(step, shape[0]), *shape[1:]), np.float32)
        for first in range(0, shape[0], max(step, 1)):
            rows = sh[: shape[0] - first]
            if file.readinto(rows.view(np.uint8).reshape(-1).data) != rows.nbytes:
                break
            check_finite(path, {"wet color": rows})
        else:
            if not file.read(1):
                return map_arrays(file, [(shape, dtype, offset)])[0] if maps else sh
        raise SceneFormatError(
            path, f"does not end after the {4 * int(np.prod(shape)):,} bytes that {shape} numbers take"
        )


def write_harmonics(sh: Float32[np.ndarray, "n k 3"], path: Path) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array(file, np.ascontiguousarray(sh, "<f4"), version=(1, 0), allow_pickle=False)

"""Scene folders: `scene.json`, and one 3DGS PLY a layer and actor."""

import hashlib
import re
from pathlib import Path

import msgspec

from ..atomic_files import sync, whole_file, whole_folder
from ..errors import SceneFormatError
from ..gaussians import Gaussians
from ..scene import Scene
from .gaussian_files import check_writable, read_gaussians
from .ply import write_ply
from .scene_record import SCENE_VERSION, SceneRecord, places_not_finite, record_of, scene_of

SCENE_FILE = "scene.json"

_LARGEST_SCENE_FILE = 1 << 26
"""Bytes; a track of an hour at 10 Hz takes 5 MB."""


class _Version(msgspec.Struct):
    version: int


def read_scene_folder(folder: Path) -> Scene:
    """Read a scene folder of this version or an older one.

    Raises:
        SceneFormatError: When a file is missing, damaged, newer than this program or outside the folder.
    """
    record = _read_record(folder)
    places = _places(folder, record)
    gaussians = [read_gaussians(place) for place in places]
    try:
        return scene_of(record, gaussians)
    except ValueError as error:
        raise SceneFormatError(folder / SCENE_FILE, str(error)) from None


def write_scene_folder(scene: Scene, folder: Path) -> None:
    """Write a scene folder, or replace one: at every moment, readers find the old scene or the new one, whole.

    A new folder is written beside its place and renamed. In an existing one, the new Gaussians get files of their own,
    `scene.json` is replaced, which is the moment of change, and then the old files go. Other files in it stay.

    Raises:
        SceneFormatError: When something that is no scene folder, or one of a newer program, is in the way; or when the
            scene has values that could not be read again.
        OSError: When it can't be written; what was there is as before.
    """
    folder = folder.resolve()
    _check_writable(scene, folder)
    if _is_new(folder):
        with whole_folder(folder) as beside:
            _write_all(scene, beside, set())
    else:
        old = _replaceable_files(folder)
        new = _write_all(scene, folder, old)
        for file in old - new:
            file.unlink(missing_ok=True)


def _check_writable(scene: Scene, folder: Path) -> None:
    """Refuse a scene that could not be read again, before it takes the place of one that can."""
    members = _members(scene)
    for kind, name, gaussians in members:
        check_writable(folder, gaussians, f" of {kind[:-1]} {name!r}")
    record = record_of(scene, [""] * len(members))
    path = folder / SCENE_FILE
    for place in places_not_finite(msgspec.to_builtins(record)):
        raise SceneFormatError(path, f"can't be written: expected a finite number - at `{place}`")
    try:
        scene_of(msgspec.json.decode(msgspec.json.encode(record), type=SceneRecord), [part for *_, part in members])
    except (ValueError, RecursionError) as error:  # among them msgspec's errors, and text that is no Unicode
        raise SceneFormatError(path, f"can't be written: {error}") from None


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
        return set(_places(folder, _read_record(folder)))
    except SceneFormatError:
        return set()  # a damaged scene may be replaced; what its files were can't be known


def _write_all(scene: Scene, folder: Path, kept: set[Path]) -> set[Path]:
    """Write files and `scene.json`; on failure remove again what was written, but for the files in `kept`."""
    written: list[Path] = []
    try:
        for kind, name, gaussians in _members(scene):
            written.append(_write_member(gaussians, folder / kind, len(written), name))
        for kind in {place.parent for place in written}:
            sync(kind)
        record = record_of(scene, [place.relative_to(folder).as_posix() for place in written])
        with whole_file(folder / SCENE_FILE) as beside:
            beside.write_bytes(msgspec.json.format(msgspec.json.encode(record), indent=1))
    except BaseException:
        for place in set(written) - kept:
            place.unlink(missing_ok=True)
        raise
    return set(written)


def _members(scene: Scene) -> list[tuple[str, str, Gaussians]]:
    """Subfolder, name and Gaussians of all layers, then all actors."""
    return [(each.key.split("/")[0], each.name, each.gaussians) for each in scene.members]


def _write_member(gaussians: Gaussians, folder: Path, index: int, name: str) -> Path:
    """Write one PLY whose name ends in a hash of its bytes, so that it never stands in the place of another."""
    folder.mkdir(exist_ok=True)
    label = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:40] or "unnamed"
    beside = folder / f".{index:03d}-{label}.part"
    try:
        write_ply(gaussians, beside)
        sync(beside)
        with beside.open("rb") as file:
            digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=6)).hexdigest()
        return beside.replace(folder / f"{index:03d}-{label}-{digest}.ply")
    finally:
        beside.unlink(missing_ok=True)


def _read_record(folder: Path) -> SceneRecord:
    data = _checked_version(folder)
    try:
        return msgspec.json.decode(data, type=SceneRecord)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(folder / SCENE_FILE, str(error)) from None


def _checked_version(folder: Path) -> bytes:
    """Bytes of `scene.json`, once its version is known to be readable."""
    path = folder / SCENE_FILE
    if path.stat().st_size > _LARGEST_SCENE_FILE:
        raise SceneFormatError(path, f"has {path.stat().st_size} bytes, at most {_LARGEST_SCENE_FILE} would be right")
    data = path.read_bytes()
    try:
        version = msgspec.json.decode(data, type=_Version).version
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(path, f"not the description of a scene: {error}") from None
    if version > SCENE_VERSION:
        raise SceneFormatError(
            path, f"version {version} is of a newer program; this one reads versions up to {SCENE_VERSION}"
        )
    return data


def _places(folder: Path, record: SceneRecord) -> list[Path]:
    """Where a record's files are; every one inside the folder and used once."""
    places: list[Path] = []
    for file in record.files:
        place = (folder / file.replace("\0", "?")).resolve()
        if Path(file).is_absolute() or not place.is_relative_to(folder.resolve()):
            raise SceneFormatError(folder / SCENE_FILE, f"file {file!r} must lie inside the scene folder")
        if not place.is_file():
            raise SceneFormatError(folder / SCENE_FILE, f"there is no file {file!r} in the scene folder")
        if place in places:
            raise SceneFormatError(folder / SCENE_FILE, f"file {file!r} must belong to one layer or actor only")
        places.append(place)
    return places

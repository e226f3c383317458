"""Opens what a person names: a file, a folder, or the built-in street."""

import hashlib
import logging
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import platformdirs
from jaxtyping import Int64

from gsrain_engine.scene import drawing_order
from gsrain_engine.scene.drawing_order import put_into_drawing_order
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.formats.scene_files import INNER_SCENE
from gsrain_engine.scene.formats.scene_folder import SCENE_FILE, is_in_drawing_order
from gsrain_engine.scene.formats.sog import is_sog_folder
from gsrain_engine.scene.marks import UNMARKED, Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import rows_of
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street import build
from gsrain_engine.scene.street.parameters import StreetParameters

logger = logging.getLogger("gsrain")

STREET = "street"


def open_scene(name: Path | str | None, known: KnownFiles | None = None) -> Scene:
    """Read a scene; none, or "street" where no scene of that name stands, is the built-in street.

    `known` learns which Gaussians the files of a scene folder hold. Raises `SceneFormatError` for what can't be read.
    """
    return cached_street() if is_built_in(name) else read_scene(Path(str(name)), known)


def open_to_draw(name: Path | str | None, known: KnownFiles | None = None) -> Scene:
    """Read a scene as `open_scene` does, and bring the Gaussians of each layer into their drawing order."""
    scene = open_scene(name, known)
    if is_built_in(name):  # the street is kept in that order
        return scene
    folder = folder_to_read(Path(str(name)))
    if folder is not None and is_in_drawing_order(folder):
        return scene
    if folder is not None and known is not None:
        known.forget(folder)
    return _put_into_order(scene)


def scene_folder_of(path: Path) -> Path | None:
    """The scene folder that a path names, by itself or by its `scene.json`; None for anything else."""
    folder = path.parent if path.name == SCENE_FILE else path
    return folder.resolve() if (folder / SCENE_FILE).is_file() else None


def folder_to_read(path: Path) -> Path | None:
    """The scene folder that is read for a path: the one that it names, or `scene` in what `gsrain street` has written.

    None for anything else.
    """
    return scene_folder_of(path) or scene_folder_of(path / INNER_SCENE)


def cached_street() -> Scene:
    """Return the built-in street: built once, then read from the cache folder."""
    folder = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / f"street-{street_fingerprint()}"
    if folder.is_dir():
        try:
            return read_scene(folder)
        except SceneFormatError as error:
            logger.warning("The cached street is damaged and is built again: %s", error)
            shutil.rmtree(folder, ignore_errors=True)
    scene = build.build_street()
    scene = _put_into_order(scene)
    try:
        write_scene(scene, folder, in_drawing_order=True)
    except (SceneFormatError, OSError) as error:
        logger.warning("The street can't be kept for the next start: %s", error)
        return scene
    return read_scene(folder)  # so that the first run shows the very numbers of every later one


def is_built_in(name: Path | str | None) -> bool:
    """Whether a name means the built-in street.

    A folder of that name which is no scene, such as `gsrain street street` writes, does not stand in its way.
    """
    return name is None or (name == STREET and not _is_scene(Path(name)))


def _is_scene(path: Path) -> bool:
    return path.is_file() or scene_folder_of(path) is not None or is_sog_folder(path)


def _put_into_order(scene: Scene) -> Scene:
    """Bring arrays that were just made into their drawing order; what is marked stays marked, wet colours go along."""
    kept = {key for masks in scene.selections.values() for key in masks}
    orders: dict[str, Int64[np.ndarray, " n"]] = {}
    for member in scene.members:
        if member.marks is UNMARKED and member.key not in kept and member.wet_sh is None:
            put_into_drawing_order(member.gaussians)
        else:
            order = orders[member.key] = drawing_order.drawing_order(member.gaussians).astype(np.int64)
            marks = Marks(*(mask and mask.take(order) for mask in _masks(member.marks)))
            gaussians, wet_sh = rows_of(member, order)
            scene = scene.with_member(member.key, gaussians=gaussians, wet_sh=wet_sh, marks=marks)
    selections = {
        name: {key: mask.take(orders[key]) for key, mask in masks.items()} for name, masks in scene.selections.items()
    }
    return replace(scene, selections=selections)


def _masks(marks: Marks) -> tuple[Mask | None, Mask | None, Mask | None]:
    return marks.selected, marks.hidden, marks.deleted


def street_fingerprint() -> str:
    """Return a hash of the built-in street's parameters and source: another version of it is another scene."""
    digest = hashlib.sha256(msgspec.json.encode(StreetParameters()))
    for source in (Path(drawing_order.__file__), *sorted(Path(build.__file__).parent.glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]

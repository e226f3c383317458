"""Opens what a person names: a file, a folder, or the built-in street."""

import hashlib
import logging
import shutil
from pathlib import Path

import msgspec
import platformdirs

from gsrain_engine.scene import drawing_order
from gsrain_engine.scene.drawing_order import put_into_drawing_order
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street import build
from gsrain_engine.scene.street.parameters import StreetParameters

logger = logging.getLogger("gsrain")

STREET = "street"


def open_scene(name: str | None) -> Scene:
    """Read a scene; none, or "street" where no such file stands, is the built-in street.

    Raises `SceneFormatError` for what can't be read.
    """
    return cached_street() if _is_built_in(name) else read_scene(Path(str(name)))


def open_to_draw(name: str | None) -> Scene:
    """Read a scene as `open_scene` does, and bring the Gaussians of each layer into their drawing order."""
    scene = open_scene(name)
    if not _is_built_in(name):  # the street is kept in that order
        _put_into_order(scene)
    return scene


def cached_street() -> Scene:
    """Return the built-in street: built once, then read from the cache folder."""
    folder = Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / f"street-{_fingerprint()}"
    if folder.is_dir():
        try:
            return read_scene(folder)
        except SceneFormatError as error:
            logger.warning("The cached street is damaged and is built again: %s", error)
            shutil.rmtree(folder, ignore_errors=True)
    scene = build.build_street()
    _put_into_order(scene)
    try:
        write_scene(scene, folder)
    except (SceneFormatError, OSError) as error:
        logger.warning("The street can't be kept for the next start: %s", error)
        return scene
    return read_scene(folder)  # so that the first run shows the very numbers of every later one


def _is_built_in(name: str | None) -> bool:
    return name is None or (name == STREET and not Path(name).exists())


def _put_into_order(scene: Scene) -> None:
    for member in scene.members:
        put_into_drawing_order(member.gaussians)


def _fingerprint() -> str:
    """Parameters and source of the street: another version of it is another cache."""
    digest = hashlib.sha256(msgspec.json.encode(StreetParameters()))
    for source in (Path(drawing_order.__file__), *sorted(Path(build.__file__).parent.glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]

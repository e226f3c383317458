"""Opens what a person names: a file, a folder, or the built-in street."""

import hashlib
import logging
import shutil
from pathlib import Path

import msgspec
import platformdirs

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
    if name is None or (name == STREET and not Path(name).exists()):
        return cached_street()
    return read_scene(Path(name))


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
    try:
        write_scene(scene, folder)
    except (SceneFormatError, OSError) as error:
        logger.warning("The street can't be kept for the next start: %s", error)
        return scene
    return read_scene(folder)  # so that the first run shows the very numbers of every later one


def _fingerprint() -> str:
    """Parameters and source of the street: another version of it is another cache."""
    digest = hashlib.sha256(msgspec.json.encode(StreetParameters()))
    for source in sorted(Path(build.__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]

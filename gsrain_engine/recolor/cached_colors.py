"""Wet colors that are computed once, and then read from a cache."""

import hashlib
import logging
from collections.abc import Callable, Generator
from pathlib import Path

import msgspec
import numpy as np
import platformdirs

from ..appearance.wet_look.settings import WetSettings
from ..safe_io.errors import SceneFormatError
from ..scene.progress import Progress
from ..scene.scene import Layer, Scene
from .recolor import wet_scene
from .result import read_recolored, with_colors, write_recolored

logger = logging.getLogger("gsrain")
_VERSION = 5
"""Version of the computation; raise it when the wet look or the recoloring changes its results."""
_MAX_FILES = 24


def cached_wet_scene(
    scene: Scene, settings: WetSettings | None = None, folder: Path | None = None
) -> Generator[Progress, None, Scene]:
    """Give a scene wet colors as `wet_scene` does, unless it has some; computed ones are kept, see `cached_scene`."""
    if scene.has_rainy_light:
        return scene
    file = (folder or wet_color_folder()) / f"{wet_color_key(scene, settings)}.npz"
    return (yield from cached_scene(scene, file, lambda: wet_scene(scene, settings)))


def wet_color_file(scene: Scene, settings: WetSettings) -> Path:
    """File in the cache for a scene's computed wet colors."""
    return wet_color_folder() / f"{wet_color_key(scene, settings)}.npz"


def cached_scene(
    scene: Scene, file: Path, compute: Callable[[], Generator[Progress, None, Scene]]
) -> Generator[Progress, None, Scene]:
    """Give a scene the wet colors of a file in the cache, or compute them and write it.

    Files are named by a hash of what the colors depend on, and replaced atomically. A damaged file is reported and
    computed again; a folder that can't be written costs the cache only.
    """
    if file.is_file():
        try:
            found = with_colors(scene, read_recolored(file))
            file.touch()
            return found
        except (SceneFormatError, OSError, KeyError, ValueError) as error:
            logger.warning("%s: these wet colors are unusable and are computed again (%s)", file, error)
    wet = yield from compute()
    try:
        write_recolored(file, {each.key: each.wet_sh for each in wet.members if each.wet_sh is not None})
        _forget_oldest(file.parent)
    except (SceneFormatError, OSError) as error:
        logger.warning("%s: the wet colors can't be kept for the next time (%s)", file, error)
    return wet


def wet_color_folder() -> Path:
    """Folder of the cache: `wet-colors` in the user's cache folder."""
    return Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "wet-colors"


def wet_color_key(scene: Scene, settings: WetSettings | None = None) -> str:
    """Hash (SHA-256, 32 hex digits) of everything that wet colors depend on: Gaussians, places, settings."""
    digest = hashlib.sha256(f"{_VERSION} ".encode())
    digest.update(msgspec.json.encode(settings or WetSettings()))
    plain = scene.metres_per_unit, scene.up, scene.ground_m, [each.key for each in scene.members]
    digest.update(msgspec.json.encode(plain))
    for each in scene.members:
        g, flags = each.gaussians, each.marks.left_out
        arrays = [g.means, g.scales, g.quaternions, g.opacities, g.sh]
        arrays += [] if flags is None else [flags.flags]
        arrays += [each.to_scene] if isinstance(each, Layer) else [each.track.times, each.track.positions]
        for array in arrays:
            digest.update(f"{array.dtype} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
        digest.update(repr((each.visible, each.opacity, each.grading)).encode())
    for name, rig in scene.rigs.items():
        digest.update(f"{name} {[(camera.name, camera.width, camera.height) for camera in rig]}".encode())
        for camera in rig:
            digest.update(np.ascontiguousarray(camera.camera_to_ego).data)
    if scene.ego is not None:
        digest.update(np.ascontiguousarray(scene.ego.positions).data)
    if scene.path is not None:
        digest.update(np.ascontiguousarray(scene.path.positions).data)
    return digest.hexdigest()[:32]


def _forget_oldest(folder: Path) -> None:
    """Keep the files that were used last."""
    files = sorted(folder.glob("*.npz"), key=lambda file: file.stat().st_mtime_ns, reverse=True)
    for file in files[_MAX_FILES:]:
        file.unlink(missing_ok=True)

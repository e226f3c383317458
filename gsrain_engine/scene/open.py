"""Scene loading by name: a file, a folder, a built-in scene, or a random one."""

import hashlib
import logging
import re
import shutil
from dataclasses import replace
from inspect import getsource
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Int64

from ..plugins import ExtensionError
from ..safe_io.errors import SceneFormatError
from ..safe_io.limits import file_sha256
from . import lod_order, lod_tree
from .built_in import DEFAULT_SCENE, BuiltInScene, built_in_names, built_in_scene
from .camera import Camera
from .flags import UNMARKED, SelectionFlags
from .formats.scene_files import INNER_SCENE, foreign_scene_files, is_foreign_scene_folder, read_scene, write_scene
from .formats.scene_folder import SCENE_FILE, FileCache, is_in_drawing_order, scene_folder_files
from .gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from .lod_order import sort_into_lod_order
from .lod_tree import MIN_GAUSSIANS, build_lod_tree
from .scene import Layer, Scene, take_gaussians

logger = logging.getLogger("gsrain")
_MIN_FOR_TREE = 4096  # number of Gaussians of a member below which a tree saves nothing


def load_scene(name: Path | str | None, known: FileCache | None = None) -> Scene:
    """Load a scene. None loads the built-in street, as does "street" unless a scene of that name exists.

    "street:overcast" is the same street under clouds, "street:night" by night, "street:dusk" at dusk behind a truck;
    "street:long" is one of 1.2 km with about 5 million Gaussians. Installed packages may add scenes.

    Records in `known` which Gaussians the files of a scene folder hold. Raises `SceneFormatError` for unreadable files.
    """
    return load_built_in(name or DEFAULT_SCENE) if is_built_in(name) else read_scene(Path(str(name)), known)


def load_sorted_scene(name: Path | str | None, known: FileCache | None = None) -> Scene:
    """Load a scene as `load_scene` does, and sort the Gaussians of each layer into LOD order."""
    scene = load_scene(name, known)
    if is_built_in(name):  # a cached one is already in that order
        return scene
    folder = folder_to_read(Path(str(name)))
    if folder is not None and is_in_drawing_order(folder):
        return scene
    if folder is not None and known is not None:
        known.forget(folder)
    return _put_into_order(scene)


def load_drawable_scene(name: Path | str | None, known: FileCache | None = None) -> Scene:
    """Load a scene as `load_sorted_scene` does; a large one gets a level-of-detail tree, unless its folder has one."""
    scene = load_sorted_scene(name, known)
    return with_lod_trees(scene) if scene.gaussian_count >= MIN_GAUSSIANS else scene


def sorted_with_trees(scene: Scene) -> Scene:
    """Sort newly loaded Gaussians into LOD order and build their trees; unchanged if they have trees."""
    if any(each.tree is not None and each.tree.fits(each.gaussians) for each in scene.members):
        return with_lod_trees(scene)
    return with_lod_trees(_put_into_order(scene))


def scene_folder_of(path: Path) -> Path | None:
    """Scene folder that a path names, directly or by its `scene.json`; None for anything else."""
    folder = path.parent if path.name == SCENE_FILE else path
    return folder.resolve() if (folder / SCENE_FILE).is_file() else None


def folder_to_read(path: Path) -> Path | None:
    """Scene folder to read for a path: the named one, or `scene` in the output of `gsrain street`.

    None for anything else.
    """
    return scene_folder_of(path) or scene_folder_of(path / INNER_SCENE)


def load_built_in(name: Path | str = DEFAULT_SCENE) -> Scene:
    """Load a built-in scene, which is built once and then read from the cache folder.

    Raises `SceneFormatError` if there is none of this name, or its package can't be used.
    """
    cache = Path(platformdirs.user_cache_dir("gsrain", appauthor=False))
    folder = cache / f"{str(name).replace(':', '-')}-{_built_in_hash(str(name))}"
    if folder.is_dir():
        try:
            return read_scene(folder)
        except SceneFormatError as error:
            logger.warning("The cached scene is damaged and is built again: %s", error)
            shutil.rmtree(folder, ignore_errors=True)
    scene = _put_into_order(_built_in(str(name)).build())
    if scene.gaussian_count >= MIN_GAUSSIANS:
        scene = with_lod_trees(scene)
    try:
        write_scene(scene, folder, in_drawing_order=True)
    except (SceneFormatError, OSError) as error:
        logger.warning("The scene can't be kept for the next start: %s", error)
        return scene
    return read_scene(folder)  # read back, so that the first run uses exactly the numbers of every later one


def is_built_in(name: Path | str | None) -> bool:
    """Return whether a name selects a built-in scene; None selects the default one.

    A folder of that name that is no scene, such as the output of `gsrain street street`, does not override it.
    """
    if name is None or str(name) not in built_in_names():
        return name is None
    path = Path(name)
    return not (path.is_file() or scene_folder_of(path) is not None or is_foreign_scene_folder(path))


def _put_into_order(scene: Scene) -> Scene:
    """Sort newly created arrays into LOD order, together with their flags and wet colors."""
    in_selections = {key for masks in scene.selections.values() for key in masks}
    orders: dict[str, Int64[np.ndarray, " n"]] = {}
    for member in scene.members:
        if member.marks is UNMARKED and member.key not in in_selections and member.wet_sh is None:
            sort_into_lod_order(member.gaussians)
        else:
            order = orders[member.key] = lod_order.lod_order(member.gaussians).astype(np.int64)
            flags = member.marks
            masks = (mask and mask.take(order) for mask in (flags.selected, flags.hidden, flags.deleted))
            gaussians, wet_sh = take_gaussians(member, order)
            marks = SelectionFlags(*masks)
            scene = scene.with_member(member.key, gaussians=gaussians, wet_sh=wet_sh, marks=marks, tree=None)
    selections = {
        name: {key: mask.take(orders[key]) for key, mask in masks.items()} for name, masks in scene.selections.items()
    }
    return replace(scene, selections=selections)


def with_lod_trees(scene: Scene) -> Scene:
    """Scene with a level-of-detail tree for each member of more than a few thousand Gaussians without marks.

    Trees that fit are not built again; 5 million Gaussians take a few seconds.
    """
    for member in scene.members:
        is_large = len(member.gaussians) >= _MIN_FOR_TREE and member.visible and not member.marks.left_out
        if is_large and (member.tree is None or not member.tree.fits(member.gaussians)):
            scene = scene.with_member(member.key, tree=build_lod_tree(member.gaussians))
    return scene


def _built_in(name: str) -> BuiltInScene:
    """Return a built-in scene. Raises `SceneFormatError` if there is none, or its package can't be used."""
    try:
        found = built_in_scene(name)
    except ExtensionError as error:
        raise SceneFormatError(name, str(error)) from error
    if found is None:
        raise SceneFormatError(name, "no built-in scene has this name here: name a file or a folder")
    return found


def _built_in_hash(name: str) -> str:
    """Hash of all that a built-in scene in drawing order depends on."""
    digest = hashlib.sha256(_built_in(name).fingerprint().encode())
    for module in (lod_order, lod_tree):
        digest.update(getsource(module).encode())
    return digest.hexdigest()[:_HASH_DIGITS]


# Content hashes
# Independent of a scene's path and name.

_HASH_DIGITS = 16


def scene_hash(name: str | None) -> str:
    """Hash (16 hex digits) of a scene by the name that `load_scene` takes.

    It covers the bytes of its files, or the source of a built-in scene. Raises `SceneFormatError` if it does not
    exist.
    """
    if is_built_in(name):
        return _built_in_hash(name or DEFAULT_SCENE)
    path = Path(str(name))
    if (folder := folder_to_read(path)) is not None:
        files = scene_folder_files(folder)
    elif path.is_file():
        return file_hash(path)
    elif is_foreign_scene_folder(path):
        folder, files = path, foreign_scene_files(path)
    else:
        raise SceneFormatError(path, "no such scene")
    found = hashlib.sha256()
    for file in files:
        found.update(f"{file.relative_to(folder).as_posix()}\0{file_hash(file)}\n".encode())
    return found.hexdigest()[:_HASH_DIGITS]


def file_hash(path: Path) -> str:
    """Hash (SHA-256, 16 hex digits) of a file's bytes; raises OSError if it can't be read."""
    return file_sha256(path)[:_HASH_DIGITS]


# Random scenes for benchmarks

_NAME = re.compile(r"random-([1-9]\d*)(k|m|)")
_MAX_GAUSSIANS = 20_000_000
_FOV_DEG = 60.0
_UP = (0.0, -1.0, 0.0)


def is_random_scene(name: str) -> bool:
    return name.startswith("random-")


def random_scene(name: str) -> Scene:
    """Make "random-200k", "random-3m": that number of Gaussians, of SH degree 0 for "k" and 3 for "m".

    For a camera at the origin that looks along +z with y down: x within 8 m, y within 5 m, z 4 to 24 m; log-normal
    scales with median 0.03 m, any rotation, opacity 0.05 to 1. The name determines the scene, which is in LOD order.

    Raises `SceneFormatError` for any other name.
    """
    match = _NAME.fullmatch(name)
    count = int(match[1]) * {"": 1, "k": 1000, "m": 1_000_000}[match[2]] if match else 0
    if match is None or count > _MAX_GAUSSIANS:
        raise SceneFormatError(name, "random scenes are named by their size, at most 20m: random-200k, random-3m")
    gaussians = _random_gaussians(count, 3 if match[2] == "m" else 0)
    sort_into_lod_order(gaussians)
    return Scene(name, (Layer(name, gaussians),), up=_UP)


def random_scene_camera(scene: Scene, width: int, height: int) -> Camera:
    """Camera in front of a random scene, 60 degrees high. World frame, meters."""
    return Camera.from_fov(width, height, _FOV_DEG, np.eye(4)).moved(scene.scene_to_world)


def _random_gaussians(count: int, sh_degree: int) -> Gaussians:
    r, f = np.random.default_rng(7), np.float32
    means = np.stack([r.uniform(-8, 8, count), r.uniform(-5, 5, count), r.uniform(4, 24, count)], axis=1).astype(f)
    scales = np.exp(r.normal(np.log(0.03), 0.5, (count, 3))).astype(f)
    quaternions = r.normal(size=(count, 4)).astype(f)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    opacities = r.uniform(0.05, 1, count).astype(f)
    sh = r.standard_normal((count, COEFFICIENTS_OF_DEGREE[sh_degree], 3), f)
    sh[:, 0] *= f(0.5)
    sh[:, 1:] *= f(0.1)
    return Gaussians(means, scales, quaternions, opacities, sh)

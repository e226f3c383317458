"""Table of single-file scene formats, with those of installed packages.

A new format is one file with a reader and one row here, or an installed package.
"""

import difflib
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...optional_packages import MissingPackageError, require_package
from ...plugins import SCENE_FORMATS, Extension, ExtensionError, find_extensions
from ...safe_io.errors import SceneFormatError
from ...safe_io.file_kinds import kind_of_file
from ...safe_io.files import whole_file
from ..flags import UNMARKED
from ..gaussians import Gaussians
from ..scene import Actor, Layer, PoseTrack, Scene
from ..transforms import flatten_scene, lost_far_out, lost_when_flattened
from ._common import Format, check_finite, checked_gaussians
from .compressed_ply import write_compressed
from .gltf import read_gltf, read_gltf_scene, write_glb, write_glb_scene
from .ksplat import read_ksplat, read_splat, write_splat
from .ply import read_ply, read_ply_scene, write_ply, write_ply_scene
from .sog import read_sog
from .sog_writer import write_sog
from .spz import read_spz, write_spz

_Contents = TypeVar("_Contents")
_Member = TypeVar("_Member", Layer, Actor)

FORMATS = (
    Format(
        ".compressed.ply",
        read_ply,
        write_compressed,
        "SuperSplat's: 16 bytes per Gaussian plus its harmonics, in Morton order",
        read_scene=read_ply_scene,
    ),
    Format(
        ".ply",
        read_ply,
        write_ply,
        "3D Gaussian Splatting, lossless, SH degree 0 to 3; ignores other properties. "
        "A comment marks antialiased Gaussians: `SplatRenderMode: mip` (Brush) or `antialiased 1` (Postshot)",
        read_scene=read_ply_scene,
        write_scene=write_ply_scene,
        lost=lost_far_out,
    ),
    Format(".splat", read_splat, write_splat, "32 bytes per Gaussian, no view-dependent color", 0),
    Format(".spz", read_spz, write_spz, "Niantic's, versions 1 to 4; version 4 is written"),
    Format(".ksplat", read_ksplat, None, "GaussianSplats3D's, levels 0 to 2, SH degree 0 to 2", 2),
    Format(".sog", read_sog, write_sog, "PlayCanvas' images in a zip file; version 2 is written"),
    Format(
        ".glb",
        read_gltf,
        write_glb,
        "binary glTF with `KHR_gaussian_splatting`, lossless; reads `KHR_gaussian_splatting_compression_spz_2`, too",
        read_scene=read_gltf_scene,
        write_scene=write_glb_scene,
        lost=lost_far_out,
    ),
    Format(
        ".gltf", read_gltf, None, "the same as text, with its buffers in it or next to it", read_scene=read_gltf_scene
    ),
    Format(
        "lod-meta.json", read_sog, None, "PlayCanvas' streamed scenes in folders: the finest level, and environment"
    ),
    Format("meta.json", read_sog, None, "PlayCanvas' images in a folder"),
)
"""Built-in formats; `scene_suffixes` includes those of installed packages.

The table in docs/formats.md and the desktop's file types derive from this one; help texts have the suffixes of
`choices`, which a test compares.
"""


def format_of(path: Path) -> Format | None:
    """Format of a file by its name: a row of the table, else a format of an installed package; None if there is none.

    Raises `SceneFormatError` if that package can't be used.
    """
    ours = next((row for row in FORMATS if path.name.lower().endswith(row.suffix)), None)
    return ours or installed_format(path)


def scene_suffixes() -> tuple[str, ...]:
    """Suffixes of all scene files, those of installed packages last."""
    return (*(row.suffix for row in FORMATS), *installed_suffixes())


def writable_suffixes() -> tuple[str, ...]:
    """Suffixes of all writable formats, those of installed packages that work last."""
    ours = [row.suffix for row in FORMATS if row.write is not None]
    return (*ours, *(suffix for suffix in installed_suffixes() if _is_written(suffix)))


def unknown_format(path: Path) -> str:
    """Error text for the name of a file of no known format, without that name."""
    return f"no known scene format: the name must end in {_listed(scene_suffixes())}{_instead(path) or _slip(path)}"


def read_gaussians(path: Path) -> Gaussians:
    """Read a single file of any known format.

    Raises `SceneFormatError` if the name or the contents belong to no known format, or the file is damaged, and
    `OSError` if the file is missing or can't be read.
    """
    return _read_by(path, lambda row: row.read(path))


def read_scene_file(path: Path) -> Gaussians | Scene:
    """Read a single file of any known format as `read_gaussians` does, or as a scene if its format holds scenes."""
    return _read_by(path, lambda row: row.read(path) if row.read_scene is None else row.read_scene(path))


def _read_by(path: Path, read: Callable[[Format], _Contents]) -> _Contents:
    row = format_of(path)
    if row is None:
        raise SceneFormatError(path, unknown_format(path))
    if path.exists() and not path.is_file():
        raise SceneFormatError(path, "not a file")
    _check_packages(path, row)
    try:
        return read(row)
    except SceneFormatError as error:
        actual_kind = _instead(path) if error.path == path else ""
        if not actual_kind:
            raise
        raise SceneFormatError(path, f"{error.problem}{actual_kind}") from None


def write_gaussians(gaussians: Gaussians, path: Path) -> None:
    """Write a single file atomically, in the format of its suffix.

    Raises `SceneFormatError` if the suffix belongs to no writable format, or the format can't hold the values, as none
    can if they are not finite, and `OSError` if the file can't be written.
    """
    write = check_written_format(path)
    check_writable(path, gaussians)
    _write_by(path, partial(write, gaussians))


def write_scene_file(scene: Scene, path: Path) -> None:
    """Write a single file as `write_gaussians` does: the flattened scene, or all that its format keeps of a scene."""
    row = format_of(path)
    if row is None or row.write_scene is None:
        write_gaussians(flatten_scene(scene), path)
        return
    _check_packages(path, row)
    for member in scene.members:
        check_writable(path, member.gaussians, f" of {member.name!r}")
    _write_by(path, partial(row.write_scene, scene))


def lost_in_file(scene: Scene, path: Path) -> list[str]:
    """Phrases for what `write_scene_file` omits from a scene; empty if the file holds all of it.

    Raises `SceneFormatError` if the package of its format can't be used.
    """
    row, lost = format_of(path), lost_when_flattened(scene)
    if row is None:
        return lost
    highest = max((each.gaussians.sh_degree for each in scene.members if each.visible), default=0)
    if highest > row.sh_degree == 0:
        lost.append(f"how colors depend on the direction of view ({row.suffix} has no place for it)")
    elif highest > row.sh_degree:
        lost.append(f"harmonics above degree {row.sh_degree} ({row.suffix} has no place for them)")
    try:
        return lost if row.lost is None else row.lost(lost)
    except ExtensionError as error:
        raise SceneFormatError(path, str(error)) from error


def _write_by(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file atomically."""
    if path.is_dir():
        raise SceneFormatError(path, "can't be written: a folder of that name is in the way")
    with whole_file(path) as beside:
        try:
            write(beside)
        except ValueError as error:
            raise SceneFormatError(path, str(error)) from None


def check_written_format(path: Path) -> Callable[[Gaussians, Path], None]:
    """Return the writer for a file name.

    Raises `SceneFormatError` if the name belongs to no writable format, or a package that the format needs is missing.
    """
    row = format_of(path)
    if row is None or row.write is None:
        writable = _listed(writable_suffixes())
        reason = "can't be written" if row is None else f"{row.suffix} is read but not written"
        raise SceneFormatError(path, f"{reason}: the name must end in {writable}{_slip(path)}")
    _check_packages(path, row)
    return row.write


def _check_packages(path: Path, row: Format) -> None:
    try:
        for package in row.packages:
            require_package(package, f"a {row.suffix} file")
    except MissingPackageError as error:
        raise SceneFormatError(path, str(error)) from None


def check_writable(path: Path, gaussians: Gaussians, of: str = "") -> None:
    """Reject values that could not be read again; `of` names the owner of the Gaussians in errors.

    Raises `SceneFormatError` for NaN or infinity.
    """
    names = "mean", "scale", "quaternion", "opacity", "color"
    check_finite(path, {f"{name}{of}": array for name, array in zip(names, gaussians.arrays, strict=True)})


def close_match(name: str, known: Sequence[str]) -> str:
    """Return a "did you mean" question for the end of an error, if `name` resembles a known one."""
    close = difflib.get_close_matches(name.lower(), known, 1)
    return f" (did you mean {close[0]}?)" if close else ""


def _slip(path: Path) -> str:
    """Suggest the suffix that a name of no known format may have been meant to have."""
    letters = set(path.suffix.lower())  # a slip swaps, drops or repeats letters: .log is no slip for .sog
    able = [
        each for each in scene_suffixes() if each.startswith(".") and (letters <= set(each) or letters >= set(each))
    ]
    return close_match(path.suffix, able) if format_of(path) is None else ""


def _instead(path: Path) -> str:
    """Describe a file's actual kind for the end of an error, if its first bytes contradict its suffix."""
    kind = kind_of_file(path, named_rightly=format_of(path) is not None) if path.is_file() else None
    return "" if kind is None else f"; it is {kind}"


def _is_written(suffix: str) -> bool:
    try:
        row = installed_format(Path(f"scene{suffix}"))
    except SceneFormatError:
        return False
    return row is not None and row.write is not None


def _listed(suffixes: Sequence[str]) -> str:
    *first, last = suffixes
    return f"{', '.join(first)} or {last}"


# Formats of installed packages


def installed_suffixes() -> tuple[str, ...]:
    """Suffixes, with their dots, that installed packages read."""
    return tuple(f".{each.name.lower()}" for each in find_extensions(SCENE_FORMATS))


def installed_format(path: Path) -> Format | None:
    """Format of another package for a file's name; None if there is none.

    Raises `SceneFormatError` if the package can't be used.
    """
    for each, suffix in zip(find_extensions(SCENE_FORMATS), installed_suffixes(), strict=True):
        if path.name.lower().endswith(suffix):
            try:
                return _guarded(each, each.load(Format), suffix)
            except ExtensionError as error:
                raise SceneFormatError(path, str(error)) from error
    return None


def _guarded(extension: Extension, row: Format, suffix: str) -> Format:
    """Wrap third-party functions: errors become one sentence, contents are checked as those of built-in readers."""
    if row.suffix != suffix:
        raise extension.unfit(f"its suffix is {row.suffix!r}, its name asks for {suffix!r}")

    def read(path: Path) -> Gaussians:
        with _as_format_error(extension, path):
            found = extension.expect(row.read(path), Gaussians, "reads")
        return _checked_gaussians(path, found)

    read_scene = None if row.read_scene is None else partial(_scene_read, extension, row.read_scene)
    write = None if row.write is None else partial(_written, extension, row.write)
    write_scene = None if row.write_scene is None else partial(_written, extension, row.write_scene)
    lost = None if row.lost is None else partial(_lost, extension, row.lost)
    return row._replace(read=read, write=write, read_scene=read_scene, write_scene=write_scene, lost=lost)


def _scene_read(extension: Extension, read: Callable[[Path], Scene], path: Path) -> Scene:
    with _as_format_error(extension, path):
        found = extension.expect(read(path), Scene, "reads")
    _check_placement(path, found)
    layers = tuple(_checked_member(path, each) for each in found.layers)
    return replace(found, layers=layers, actors=tuple(_checked_member(path, each) for each in found.actors))


def _written(extension: Extension, write: Callable[[_Contents, Path], None], contents: _Contents, path: Path) -> None:
    with _as_format_error(extension, path):
        write(contents, path)


def _lost(extension: Extension, lost: Callable[[list[str]], list[str]], phrases: list[str]) -> list[str]:
    try:
        return [str(each) for each in lost(phrases)]
    except Exception as error:  # third-party code may raise anything
        raise extension.unfit(error) from error


def _checked_gaussians(path: Path, found: Gaussians) -> Gaussians:
    arrays = (np.require(each, np.float32, ["C", "W"]) for each in found.arrays)  # large scenes have no room for copies
    return replace(checked_gaussians(path, *arrays), antialiased=found.antialiased)


def _checked_member(path: Path, member: _Member) -> _Member:
    gaussians = _checked_gaussians(path, member.gaussians)
    if len(gaussians) == len(member.gaussians):
        return replace(member, gaussians=gaussians)
    return replace(member, gaussians=gaussians, wet_sh=None, marks=UNMARKED, tree=None)  # which no longer fit


def _check_placement(path: Path, scene: Scene) -> None:
    """Raise `SceneFormatError` unless unit, transforms and tracks can be used."""
    if not 0 < scene.metres_per_unit < np.inf:
        raise SceneFormatError(path, f"its unit must be longer than 0 m, not {scene.metres_per_unit:g}")
    for layer in scene.layers:
        if not np.isfinite(layer.to_scene).all():
            raise SceneFormatError(path, f"{layer.name}: its transform must consist of finite numbers")
    tracks: list[tuple[str, PoseTrack]] = [(actor.id, actor.track) for actor in scene.actors]
    tracks += [] if scene.ego is None else [("ego", scene.ego)]
    for name, track in tracks:
        arrays = track.times, track.positions, track.quaternions_wxyz
        if not all(np.isfinite(each).all() for each in arrays) or not (np.diff(track.times) > 0).all():
            raise SceneFormatError(path, f"{name}: its track must consist of finite numbers, at increasing times")


@contextmanager
def _as_format_error(extension: Extension, path: Path) -> Generator[None]:
    """Convert any third-party exception to a `SceneFormatError` in one sentence."""
    try:
        yield
    except (SceneFormatError, OSError, MemoryError):
        raise
    except ExtensionError as error:
        raise SceneFormatError(path, str(error)) from error
    except Exception as error:
        raise SceneFormatError(path, str(extension.unfit(error))) from error

"""Opening of captures of any dataset by the first format that recognizes the path."""

import difflib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ..plugins import CAPTURE_FORMATS, Extension, load_extensions, warn_once
from ..safe_io.file_kinds import find_file_kind, kind_of_file
from ..safe_io.file_names import visible_siblings
from ..scene.formats.registry import format_of
from ..scene.progress import Progress
from .argoverse2 import read_argoverse2, recognizes_argoverse2
from .bags.containers import recognizes_bag
from .bags.reader import read_bag
from .bdd100k import read_bdd100k, recognizes_bdd100k
from .capture import Capture, CaptureError, OutsideError, abbreviated_names, outside_allowed
from .capture_folder import read_capture_folder, read_image_folder, recognizes_capture_folder, recognizes_image_folder
from .colmap import read_colmap, recognizes_colmap
from .dgp import read_dgp, recognizes_dgp
from .io.arrays import WRONG_VALUES, what_is_wrong
from .kitti import read_kitti_odometry, read_kitti_raw, recognizes_kitti_odometry, recognizes_kitti_raw
from .kitti360 import read_kitti360, recognizes_kitti360
from .kitti_objects import read_kitti_objects, recognizes_kitti_objects
from .layout_hints import foreign_poses, nearest_layout
from .mmdetection3d import read_infos, recognizes_infos
from .nerfstudio import read_nerfstudio, recognizes_nerfstudio
from .nuscenes import read_nuscenes, recognizes_nuscenes
from .rainsense import read_rainsense, recognizes_rainsense
from .waymo import read_waymo_records, read_waymo_tables, recognizes_waymo_records, recognizes_waymo_tables

_LOOKED_AT = 50  # maximum number of subfolders that are searched for captures


@dataclass(frozen=True, slots=True)
class CaptureFormat:
    """One kind of capture on disk."""

    name: str
    """Display name: COLMAP, KITTI raw."""
    recognizes: Callable[[Path], bool]
    """Fast check of a path by the names in it, without exceptions."""
    read: Callable[[Path], Capture]
    """Reader; raises `CaptureError`. Images are read later, one by one."""
    names_inside: bool = False
    """True if one of several drives in tables is given like a file inside: NUSCENES/scene-0061."""
    write: Callable[..., Iterator[Progress]] | None = None
    """Writer of rainy copies, a `WriteRecording`; None copies the folder file by file, with other image files."""


FORMATS: tuple[CaptureFormat, ...] = (
    # The first match wins: formats with a calibration precede plain images.
    CaptureFormat("capture folder", recognizes_capture_folder, read_capture_folder),
    CaptureFormat("DGP", recognizes_dgp, read_dgp),
    CaptureFormat("nuScenes", recognizes_nuscenes, read_nuscenes, names_inside=True),
    CaptureFormat("MMDetection3D", recognizes_infos, read_infos, names_inside=True),
    CaptureFormat("Waymo Perception v1", recognizes_waymo_records, read_waymo_records),
    CaptureFormat("Waymo Perception v2", recognizes_waymo_tables, read_waymo_tables, names_inside=True),
    CaptureFormat("KITTI raw", recognizes_kitti_raw, read_kitti_raw),
    CaptureFormat("KITTI odometry", recognizes_kitti_odometry, read_kitti_odometry),
    CaptureFormat("KITTI object detection", recognizes_kitti_objects, read_kitti_objects, names_inside=True),
    CaptureFormat("Argoverse 2", recognizes_argoverse2, read_argoverse2),
    CaptureFormat("KITTI-360", recognizes_kitti360, read_kitti360, names_inside=True),
    CaptureFormat("ROS 2 bag (MCAP, SQLite)", recognizes_bag, read_bag),
    CaptureFormat("nerfstudio", recognizes_nerfstudio, read_nerfstudio),
    CaptureFormat("COLMAP", recognizes_colmap, read_colmap),
    CaptureFormat("RainSense", recognizes_rainsense, read_rainsense),
    CaptureFormat("BDD-100K", recognizes_bdd100k, read_bdd100k),
    CaptureFormat("image folder", recognizes_image_folder, read_image_folder),
)


def open_capture(path: Path | str, *, allow_outside: bool | None = None) -> Capture:
    """Read the capture at a path. Raises `CaptureError`, which names the faulty file.

    Files named in the capture, but outside its folder, are only read with `allow_outside`; None uses the context's
    setting (`outside_allowed`), False by default.
    """
    path = Path(path)
    found = capture_format(path)
    if found is None:
        raise CaptureError(f"{path}: {_why_not(path)}")
    try:
        with outside_allowed(allow_outside):
            return found.read(path)
    except OutsideError:
        raise
    except CaptureError as error:
        if path.name in str(error):
            raise
        raise CaptureError(f"{path}: {error}") from None
    except (*WRONG_VALUES, OSError, MemoryError, RecursionError) as error:
        raise CaptureError(f"{path}: can't be read as {found.name}: {what_is_wrong(error)}") from error


def capture_format(path: Path | str) -> CaptureFormat | None:
    """Format of the capture at a path; None if unknown."""
    path = Path(path)
    if path.is_file() and (kind := find_file_kind(path)) is not None and kind.is_stand_in:
        return None
    able = _formats() if path.exists() else tuple(each for each in _formats() if each.names_inside)
    try:
        return next((each for each in able if each.recognizes(path)), None)
    except OSError:
        return None  # a folder without read permission


def _why_not(path: Path) -> str:
    if path == Path("street") and not path.exists():
        return "no such file or folder; gsrain street DIR writes pictures of the built-in street, and DIR is a capture"
    if not path.exists():
        close = difflib.get_close_matches(path.name, visible_siblings(path), n=1)
        return "no such file or folder" + (f"; did you mean {close[0]}?" if close else "")
    kind = kind_of_file(path) if path.is_file() else None
    if path.is_file() and format_of(path) is not None:
        kind = "a file of a scene, or of points"
    if kind is not None:
        return f"not a capture; it is {kind}"
    known = ", ".join(each.name for each in _formats())
    return f"not a capture that is known{capture_hint(path)}; expected one of {known}"


def capture_hint(path: Path) -> str:
    """Hint on an unknown folder, for a message: captures below it, most similar kind, or image folders below it."""
    posed, pictures = _captures_below(path)
    near = None if posed else nearest_layout(path)
    if near is not None:
        return f"; nearest is {near}"
    poses = None if posed or not path.is_dir() else foreign_poses(path)
    below = abbreviated_names([f"{name} ({kind})" for name, kind in posed or pictures])
    return (f"; {poses}" if poses else "") + (f"; give a folder in it: {below}" if below else "")


def _captures_below(path: Path) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Relative paths and kinds of captures one or two levels below an unrecognized folder.

    First those with more than images, of the first level that has any; then folders of images alone.
    """
    folders, pictures = [path], list[tuple[str, str]]()
    for _ in range(2):
        folders = [each for folder in folders for each in _folders_in(folder)][:_LOOKED_AT]
        found = [(each.relative_to(path).as_posix(), kind.name) for each in folders if (kind := capture_format(each))]
        posed = [each for each in found if each[1] != FORMATS[-1].name]
        if posed:
            return posed, []
        pictures += found
    return [], pictures


def _folders_in(folder: Path) -> list[Path]:
    try:
        return sorted(each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
    except OSError:
        return []


def _formats() -> tuple[CaptureFormat, ...]:
    """Built-in formats and those of installed packages, which precede plain image folders."""
    *ours, pictures = FORMATS
    return (*ours, *(_guarded(*each) for each in load_extensions(CAPTURE_FORMATS, CaptureFormat)), pictures)


def _guarded(extension: Extension, row: CaptureFormat) -> CaptureFormat:
    """Ignore an extension's format if its check fails, because every path is passed to it."""

    def recognizes(path: Path) -> bool:
        try:
            return row.recognizes(path)
        except OSError:
            raise
        except Exception as error:  # extensions may raise anything
            warn_once(str(extension.unfit(error)))
            return False

    return replace(row, recognizes=recognizes)

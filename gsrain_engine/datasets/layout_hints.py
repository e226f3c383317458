"""Hints on unrecognized folders: the most similar kind of capture and its missing parts."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..scene.formats.scene_files import scene_files_in
from .capture import abbreviated_names
from .io.images import CONVERT, images_in, unread_images_in

_LOOKED_AT = 200  # maximum number of entries of a folder that a pattern is matched with


@dataclass(frozen=True, slots=True)
class _CapturePart:
    """Part of a kind of capture: a display name, and patterns of paths, one of which must match."""

    name: str
    patterns: tuple[str, ...]
    is_clue: bool = True
    """True if the part identifies the kind; images alone don't."""


@dataclass(frozen=True, slots=True)
class _CaptureKind:
    name: str
    parts: tuple[_CapturePart, ...]
    advice: str = ""


def _images(*folders: str) -> _CapturePart:
    return _CapturePart(
        "pictures", tuple(f"{folder}*.{ending}" for folder in folders for ending in ("png", "jpg", "jpeg")), False
    )


_MODELS = ("", "0/", "sparse/", "sparse/*/", "colmap/sparse/*/")
_DRIVES = ("", "*_drive_*/", "*/*_drive_*/")

_KINDS = (
    _CaptureKind(
        "KITTI raw",
        (
            _CapturePart("image_02", tuple(f"{d}image_0[0-3]/data" for d in _DRIVES)),
            _CapturePart("oxts", tuple(f"{d}oxts/data" for d in _DRIVES)),
            _CapturePart(
                "calib_cam_to_cam.txt", ("calib_cam_to_cam.txt", "*/calib_cam_to_cam.txt", "../calib_cam_to_cam.txt")
            ),
        ),
    ),
    _CaptureKind(
        "KITTI object detection",
        (
            _CapturePart("image_2", ("image_2", "training/image_2")),
            _CapturePart("calib", ("calib/[0-9]*.txt", "training/calib/[0-9]*.txt")),
            _CapturePart("label_2", ("label_2", "training/label_2")),
            _CapturePart("poses", ("poses.txt",)),
        ),
        "it has single pictures and no drives; give its folder image_2",
    ),
    _CaptureKind(
        "KITTI odometry",
        (
            _CapturePart("calib.txt", ("calib.txt", "sequences/*/calib.txt")),
            _CapturePart("times.txt", ("times.txt", "sequences/*/times.txt")),
            _CapturePart("image_2", ("image_[0-3]", "sequences/*/image_[0-3]")),
            _CapturePart("poses", ("poses.txt", "poses/*.txt", "../../poses/*.txt")),
        ),
    ),
    _CaptureKind(
        "nuScenes",
        (
            _CapturePart("v1.0-*/sample_data.json", ("v1.0-*/sample_data.json", "sample_data.json")),
            _CapturePart("v1.0-*/ego_pose.json", ("v1.0-*/ego_pose.json", "ego_pose.json")),
            _CapturePart("samples", ("samples", "../samples")),
        ),
        "MMDetection3D's info file (.pkl) in the same folder would do, too",
    ),
    _CaptureKind(
        "DGP",
        (
            _CapturePart("scene_*.json", ("scene_*.json", "*/scene_*.json")),
            _CapturePart("calibration", ("calibration", "*/calibration")),
        ),
    ),
    _CaptureKind(
        "Waymo Perception v2",
        (
            _CapturePart("camera_image", ("camera_image", "*/camera_image")),
            _CapturePart("camera_calibration", ("camera_calibration", "*/camera_calibration")),
            _CapturePart("vehicle_pose", ("vehicle_pose", "*/vehicle_pose")),
        ),
    ),
    _CaptureKind(
        "RainSense",
        (
            _CapturePart(
                "context/rainfall_intensity.txt", ("context/rainfall_intensity.txt", "*/context/rainfall_intensity.txt")
            ),
            _CapturePart("context", ("context", "*/context")),
        ),
    ),
    _CaptureKind(
        "nerfstudio",
        (
            _CapturePart("transforms.json", ("transforms.json", "transforms_train.json")),
            _CapturePart("other transforms", ("transforms*.json", "*/transforms*.json")),
        ),
    ),
    _CaptureKind(
        "COLMAP",
        (
            _CapturePart("cameras.bin", tuple(f"{m}cameras.{e}" for m in _MODELS for e in ("bin", "txt"))),
            _CapturePart("images.bin", tuple(f"{m}images.{e}" for m in _MODELS for e in ("bin", "txt"))),
            _CapturePart("points3D.bin", tuple(f"{m}points3D.{e}" for m in _MODELS for e in ("bin", "txt"))),
            _CapturePart("sparse", ("sparse/*", "colmap/sparse/*", "*/sparse/*")),
            _CapturePart("database.db", ("database.db", "*/database.db")),
        ),
        "COLMAP's mapper writes sparse/0 with cameras.bin and images.bin",
    ),
    _CaptureKind(
        "3D Gaussian Splatting",
        (
            _CapturePart("point_cloud/iteration_*/point_cloud.ply", ("point_cloud/iteration_*/point_cloud.ply",)),
            _CapturePart("cfg_args", ("cfg_args",)),
        ),
        "that is a trained scene: give point_cloud/iteration_*/point_cloud.ply, and its cameras.json as a camera path",
    ),
    _CaptureKind(
        "capture folder",
        (_CapturePart("cameras.json", ("cameras.json", "images/cameras.json")), _images("", "images/")),
    ),
    _CaptureKind(
        "SOG", (_CapturePart("meta.json", ("meta.json",)), _CapturePart("its pictures (*.webp)", ("*.webp",), False))
    ),
)

_OPTIONAL = frozenset({"points3D.bin", "sparse", "database.db", "other transforms", "label_2", "cfg_args", "context"})
"""Parts that identify a kind, but are not required."""


def nearest_layout(path: Path) -> str | None:
    """Return the kind most similar to a folder, and its missing parts ("KITTI raw without oxts"); None without a clue.

    Returns None for a file, whose name already identifies its kind.
    """
    if not path.is_dir():
        return None
    scenes = scene_files_in(path)
    if scenes and not scenes[0].endswith(".ply"):  # a .ply may be the point cloud of a capture
        return f"a folder of scenes (give one of the files in it: {', '.join(scenes)})"
    best: tuple[float, _CaptureKind, list[str]] | None = None
    for kind in _KINDS:
        there = [part for part in kind.parts if any(_is_there(path, pattern) for pattern in part.patterns)]
        if not any(part.is_clue for part in there):
            continue
        share = sum(1.0 if part.is_clue else 0.5 for part in there) / len(kind.parts)
        missing = [part.name for part in kind.parts if part not in there and part.name not in _OPTIONAL]
        if best is None or share > best[0]:
            best = share, kind, missing
    if best is None and scenes:
        return f"a folder of scenes (give one of the files in it: {', '.join(scenes)})"
    if best is None:
        unread = [] if images_in(path) else unread_images_in(path) or unread_images_in(path / "images")
        return (
            f"a folder of pictures {CONVERT}: {abbreviated_names([file.name for file in unread])}" if unread else None
        )
    _, kind, missing = best
    lacks = f" without {_and(missing)}" if missing else ""
    return f"{kind.name}{lacks}" + (f" ({kind.advice})" if kind.advice else "")


def _is_there(folder: Path, pattern: str) -> bool:
    try:
        return any(True for _ in islice(_matches(folder, pattern), 1))
    except OSError:
        return False


def _matches(folder: Path, pattern: str) -> Iterator[Path]:
    """Paths below a folder that match a pattern with wildcards; ".." leads to parent folders."""
    places = [folder.resolve()]
    for step in pattern.split("/"):
        if step == "..":
            places = [place.parent for place in places]
        elif any(sign in step for sign in "*?["):
            places = [found for place in places if place.is_dir() for found in islice(place.glob(step), _LOOKED_AT)]
        else:
            places = [place / step for place in places if (place / step).exists()]
    yield from places


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

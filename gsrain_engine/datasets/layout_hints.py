"""Hints on unrecognized folders: the most similar kind of capture and its missing parts."""

from itertools import islice
from pathlib import Path

from ..safe_io.file_kinds import find_file_kind
from ..scene.formats.scene_files import scene_files_in
from .bags.containers import MCAP, METADATA, SQLITE
from .capture import abbreviated_names
from .io.images import CONVERT, images_in, unread_images_in

_LOOKED_AT = 200  # maximum number of entries of a folder that a pattern is matched with

_MODEL = "{0} 0/{0} sparse/{0} sparse/*/{0} colmap/sparse/*/{0}"
_DRIVE = "{0} *_drive_*/{0} */*_drive_*/{0}"

_KINDS = {
    "KITTI raw": {
        "image_02": _DRIVE.format("image_0[0-3]/data"),
        "oxts": _DRIVE.format("oxts/data"),
        "calib_cam_to_cam.txt": "calib_cam_to_cam.txt */calib_cam_to_cam.txt ../calib_cam_to_cam.txt",
    },
    "KITTI object detection": {
        "image_2": "image_2 training/image_2",
        "calib": "calib/[0-9]*.txt training/calib/[0-9]*.txt",
        "label_2": "label_2 training/label_2",
    },
    "KITTI odometry": {
        "calib.txt": "calib.txt sequences/*/calib.txt",
        "times.txt": "times.txt sequences/*/times.txt",
        "image_2": "image_[0-3] sequences/*/image_[0-3]",
        "poses": "poses.txt poses/*.txt ../../poses/*.txt",
    },
    "nuScenes": {
        "v1.0-*/sample_data.json": "v1.0-*/sample_data.json sample_data.json",
        "v1.0-*/ego_pose.json": "v1.0-*/ego_pose.json ego_pose.json",
        "samples": "samples ../samples",
    },
    "KITTI-360": {
        "data_2d_raw": "data_2d_raw image_0[0-3]/data_rect */image_0[0-3]/data_rect",
        "calibration": "calibration/perspective.txt ../calibration/perspective.txt ../../calibration/perspective.txt",
        "data_poses": "data_poses ../data_poses ../../data_poses",
    },
    "Argoverse 2": {
        "city_SE3_egovehicle.feather": "city_SE3_egovehicle.feather */city_SE3_egovehicle.feather",
        "calibration/intrinsics.feather": "calibration/intrinsics.feather */calibration/intrinsics.feather",
        "sensors/cameras": "sensors/cameras */sensors/cameras",
    },
    "PandaSet": {
        "camera/*/poses.json": "camera/*/poses.json */camera/*/poses.json",
        "camera/*/intrinsics.json": "camera/*/intrinsics.json */camera/*/intrinsics.json",
    },
    "Zenseact Open Dataset": {
        "ego_motion.json": "ego_motion.json */ego_motion.json sequences/*/ego_motion.json",
        "calibration.json": "calibration.json */calibration.json sequences/*/calibration.json",
        "camera_front_blur": "camera_front_* */camera_front_* sequences/*/camera_front_*",
    },
    "EuRoC": {"cam0/data": "cam0/data mav0/cam0/data", "cam0/sensor.yaml": "cam0/sensor.yaml mav0/cam0/sensor.yaml"},
    "TUM RGB-D": {"rgb.txt": "rgb.txt", "groundtruth.txt": "groundtruth.txt", "rgb": "rgb"},
    "DGP": {"scene_*.json": "scene_*.json */scene_*.json", "calibration": "calibration */calibration"},
    "Waymo Perception v2": {
        name: f"{name} */{name}" for name in ("camera_image", "camera_calibration", "vehicle_pose")
    },
    "RainSense": {
        "context/rainfall_intensity.txt": "context/rainfall_intensity.txt */context/rainfall_intensity.txt",
        "context": "context */context",
    },
    "nerfstudio": {
        "transforms.json": "transforms.json transforms_train.json",
        "other transforms": "transforms*.json */transforms*.json",
    },
    "COLMAP": {
        **{
            f"{name}.bin": f"{_MODEL.format(f'{name}.bin')} {_MODEL.format(f'{name}.txt')}"
            for name in ("cameras", "images", "points3D")
        },
        "sparse": "sparse/* colmap/sparse/* */sparse/*",
        "database.db": "database.db */database.db",
    },
    "3D Gaussian Splatting": {
        "point_cloud/iteration_*/point_cloud.ply": "point_cloud/iteration_*/point_cloud.ply",
        "cfg_args": "cfg_args",
    },
    "capture folder": {
        "cameras.json": "cameras.json images/cameras.json",
        "pictures": "*.png *.jpg *.jpeg images/*.png images/*.jpg images/*.jpeg",
    },
    "SOG": {"meta.json": "meta.json", "its pictures (*.webp)": "*.webp"},
}
"""Kinds of captures with their parts, each with patterns of paths, one of which must match."""

_NO_CLUES = frozenset({"pictures", "its pictures (*.webp)"})
"""Parts that don't identify a kind."""

_OPTIONAL = frozenset({"points3D.bin", "sparse", "database.db", "other transforms", "label_2", "cfg_args", "context"})
"""Parts that identify a kind, but are not required."""

_UNREAD = "it is not read: give a folder of its pictures, or write its poses as those of COLMAP or nerfstudio"

_ADVICE = {
    **dict.fromkeys(("PandaSet", "Zenseact Open Dataset", "EuRoC", "TUM RGB-D"), _UNREAD),
    "KITTI-360": "give the folder that has data_2d_raw, calibration and data_poses in it, or THAT_FOLDER/DRIVE",
    "nuScenes": "MMDetection3D's info file (.pkl) in the same folder would do, too",
    "COLMAP": "COLMAP's mapper writes sparse/0 with cameras.bin and images.bin",
    "3D Gaussian Splatting": (
        "that is a trained scene: give point_cloud/iteration_*/point_cloud.ply, and its cameras.json as a camera path"
    ),
}


_LISTED_FILES = 20  # first files of a pattern that are looked into
_POSE_FILES = (
    "*.csv *.xmp *.xml corrected_cameras/*.json cameras/*.json keyframes/corrected_cameras/*.json "
    "keyframes/cameras/*.json metadata reconstruction.json opensfm/reconstruction.json sfm_data.json *.sfm *.mvs "
    "bundle.out *.nvm *.pkl"
)
"""Patterns of files that may have poses of other programs."""


def foreign_poses(path: Path) -> str | None:
    """Files with poses of other programs in a folder, or next to the folder of pictures that it is."""
    for folder in (path, path.resolve().parent) if path.name.lower() in _PICTURE_FOLDERS else (path,):
        for pattern in _POSE_FILES.split():
            for file in islice(sorted(folder.glob(pattern)), _LISTED_FILES):
                kind = find_file_kind(file)
                if kind is not None and kind.has_poses:
                    return f"{file.relative_to(folder).as_posix()} has {kind.words}"
    return None


_PICTURE_FOLDERS = ("images", "image", "input", "corrected_images", "rgb", "photos")


def nearest_layout(path: Path) -> str | None:
    """Return the kind most similar to a folder, and its missing parts ("KITTI raw without oxts"); None without a clue.

    Returns None for a file, whose name already identifies its kind.
    """
    if not path.is_dir():
        return None
    scenes = scene_files_in(path)
    a_scene = f"a folder of scenes (give one of the files in it: {', '.join(scenes)})" if scenes else None
    if scenes and not scenes[0].endswith(".ply"):  # a .ply may be the point cloud of a capture
        return a_scene
    if any(_is_there(path, f"*{suffix}") for suffix in (MCAP, SQLITE)):
        return f"a ROS 2 bag without {METADATA} (give the {MCAP} or {SQLITE} in it, or ros2 bag reindex)"
    best: tuple[float, str, list[str]] | None = None
    for kind, parts in _KINDS.items():
        there = {name for name, patterns in parts.items() if any(_is_there(path, each) for each in patterns.split())}
        share = sum(0.5 if name in _NO_CLUES else 1.0 for name in there) / len(parts)
        if there - _NO_CLUES and (best is None or share > best[0]):
            best = share, kind, [name for name in parts if name not in there | _OPTIONAL]
    if best is None and a_scene is None:
        unread = [] if images_in(path) else unread_images_in(path) or unread_images_in(path / "images")
        names = abbreviated_names([file.name for file in unread])
        return f"a folder of pictures {CONVERT}: {names}" if unread else None
    if best is None:
        return a_scene
    _, kind, missing = best
    lacks = f" without {_and(missing)}" if missing else ""
    return f"{kind}{lacks}" + (f" ({_ADVICE[kind]})" if kind in _ADVICE else "")


def _is_there(folder: Path, pattern: str) -> bool:
    """Return whether a path below a folder matches a pattern with wildcards; ".." leads to parent folders."""
    places = [folder.resolve()]
    try:
        for step in pattern.split("/"):
            if step == "..":
                places = [place.parent for place in places]
            elif any(sign in step for sign in "*?["):
                places = [found for place in places if place.is_dir() for found in islice(place.glob(step), _LOOKED_AT)]
            else:
                places = [place / step for place in places if (place / step).exists()]
    except OSError:
        return False
    return bool(places)


def _and(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

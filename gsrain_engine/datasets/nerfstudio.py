"""transforms.json of nerfstudio, instant-ngp and Blender, with poses converted from OpenGL's axes to OpenCV's."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..scene.camera import Camera
from ..scene.lens import Lens
from .capture import Capture, CaptureError, CaptureFrame, check_inside, omissions, sensor_names, view_names
from .colmap import PANORAMA_ADVICE
from .geometry import (
    Pose,
    camera_of_image,
    checked_camera,
    estimate_up_direction,
    invert_pose,
    radial_lens,
    rigid_from_numbers,
)
from .io.arrays import read_floats, read_json_object, what_is_wrong
from .io.images import image_size, name_on_disk, oriented_size, read_color, read_mask, read_stored
from .io.records import read_point_ply

TRANSFORMS = ("transforms.json", "transforms_train.json")
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

_PERSPECTIVE_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FISHEYE_MODELS = ("OPENCV_FISHEYE", "FISHEYE")
_DEPTH_UNIT_M = 1e-3
_DEPTH_PATHS = ("depth_file_path", "depth_path")
_WRONG = (KeyError, TypeError, ValueError, AttributeError, ArithmeticError)


def recognizes_nerfstudio(path: Path) -> bool:
    """Return whether a folder holds transforms.json, or a path is such a file."""
    return _file(path) is not None


def read_nerfstudio(path: Path) -> Capture:
    """Read the frames of transforms.json, with intrinsics shared or in each frame.

    Depth files hold thousandths of the world's unit, as in nerfstudio, unless depth_unit_scale_factor (or
    integer_depth_scale) differs; with depth, the unit is assumed to be the meter. Masks exclude black pixels. Unusable
    frames are listed as problems. The world is that of the frames: applied_transform is not undone.
    """
    file = _file(path) or path
    shared = read_json_object(file)
    frames = shared.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise CaptureError(f"{file}: frames must be a list of objects, one a picture")
    common = {key: value for key, value in shared.items() if key != "frames"}
    merged: list[dict[str, Any]] = sorted(({**common, **frame} for frame in frames), key=_file_path)
    pictures = [_file_path(frame) for frame in merged]
    check_inside(file.parent, _named_files(file, merged), file)
    views: list[CaptureFrame] = []
    problems: list[str] = []
    for frame, name, sensor in zip(merged, view_names(pictures), sensor_names(pictures), strict=True):
        try:
            views.append(_view(file, frame, name, sensor))
        except CaptureError as error:
            problems.append(str(error))
        except _WRONG as error:
            problems.append(f"{file}, frame {name}: {what_is_wrong(error)}")
    if not views:
        raise CaptureError(f"{file}: none of its {len(frames)} frames can be used ({problems[0]})")
    problems = omissions(problems, f"{len(problems)} of {len(frames)} frames")
    points, colors = _points(file, shared, problems)
    return Capture(
        file.resolve().parent.name,
        tuple(views),
        points_m=points,
        point_colors=colors,
        is_metric=any(view.depth_source is not None for view in views),
        up=estimate_up_direction([view.camera for view in views]),
        problems=tuple(problems),
    )


def _named_files(file: Path, frames: list[dict[str, Any]]) -> Iterator[str]:
    """Names on disk of all files in the frames."""
    for frame in frames:
        names = [str(frame[key]) for key in ("mask_path", *_DEPTH_PATHS, "ply_file_path") if frame.get(key)]
        yield from (name_on_disk(file.parent, name) for name in (_file_path(frame), *names))


def _view(file: Path, frame: dict[str, Any], name: str, sensor: str) -> CaptureFrame:
    picture = _named(file, frame["file_path"])
    size, upright = _size(frame, picture)
    pose = invert_pose(rigid_from_numbers(frame["transform_matrix"]) @ _OPENCV_FROM_OPENGL)
    camera = checked_camera(_camera(frame, size, pose), f"{file}, frame {name}")
    mask, depth = frame.get("mask_path"), frame.get("depth_file_path", frame.get("depth_path"))
    unit = float(frame.get("depth_unit_scale_factor", frame.get("integer_depth_scale", _DEPTH_UNIT_M)))
    return CaptureFrame(
        name,
        camera_of_image(camera, size, str(picture)),
        partial(read_color, picture, upright),
        sensor=sensor,
        lens=_lens(frame, camera),
        depth_source=partial(_depth, _named(file, depth), unit) if depth else None,
        mask_source=partial(read_mask, _named(file, mask)) if mask else None,
    )


def _file_path(frame: dict[str, Any]) -> str:
    return str(frame.get("file_path", "unnamed"))


def _named(file: Path, name: Any) -> Path:
    return file.parent / name_on_disk(file.parent, str(name))


def _size(frame: dict[str, Any], picture: Path) -> tuple[tuple[int, int], bool]:
    """Size of a frame's image, and whether it is the one after its EXIF orientation was applied."""
    if "w" not in frame or "h" not in frame:
        return image_size(picture), False
    return oriented_size(picture, (int(frame["w"]), int(frame["h"])))


def _camera(frame: dict[str, Any], size: tuple[int, int], pose: Pose) -> Camera:
    width, height = int(frame.get("w", size[0])), int(frame.get("h", size[1]))
    if "fl_x" in frame or "fl_y" in frame:
        fx = float(frame.get("fl_x", frame.get("fl_y", 0)))
        fy = float(frame.get("fl_y", fx))
    elif "camera_angle_x" in frame:
        fx = width / 2 / np.tan(float(frame["camera_angle_x"]) / 2)
        fy = height / 2 / np.tan(float(frame["camera_angle_y"]) / 2) if "camera_angle_y" in frame else fx
    else:
        raise KeyError("fl_x")
    cx, cy = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    return Camera(width, height, float(fx), float(fy), cx, cy, pose)


def _lens(frame: dict[str, Any], camera: Camera) -> Lens | None:
    name, usable = str(frame.get("camera_model", "")), (*_PERSPECTIVE_MODELS, *_FISHEYE_MODELS)
    if name not in ("", *usable):
        advice = f"; {PANORAMA_ADVICE}" if name == "EQUIRECTANGULAR" else ""
        raise ValueError(
            f"has the camera_model {name}, which OpenCV doesn't have; usable are {', '.join(usable)}{advice}"
        )
    k1, k2, k3, k4, p1, p2 = (float(frame.get(key, 0.0)) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if not np.isfinite([k1, k2, k3, k4, p1, p2]).all():
        raise ValueError("has distortion that is not finite")
    if frame.get("is_fisheye") or name in _FISHEYE_MODELS:
        return Lens("fisheye", (k1, k2, k3, k4))
    if k4:
        return radial_lens((k1, k2, k3, k4), (p1, p2), camera)
    return Lens("opencv", (k1, k2, p1, p2, k3)) if any((k1, k2, p1, p2, k3)) else None


def _depth(file: Path, unit: float) -> Float32[np.ndarray, "h w"]:
    stored = read_floats(file) if file.suffix == ".npy" else read_stored(file).astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (stored[..., 0] if stored.ndim == 3 else stored) * np.float32(unit)
    if depth.ndim != 2:
        raise CaptureError(f"{file}: depth has the shape {stored.shape}, expected rows and columns")
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


def _points(
    file: Path, shared: dict[str, Any], problems: list[str]
) -> tuple[Float64[np.ndarray, "p 3"] | None, UInt8[np.ndarray, "p 3"] | None]:
    if not shared.get("ply_file_path"):
        return None, None
    try:
        points, colors = read_point_ply(_named(file, shared["ply_file_path"]))
    except CaptureError as error:
        problems.append(f"The points are left out: {error}.")
        return None, None
    return (points, colors) if len(points) else (None, None)


def _file(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix == ".json" and path.name.startswith("transforms") else None
    return next((path / name for name in TRANSFORMS if (path / name).is_file()), None)

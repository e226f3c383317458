"""Camera path files: GSRAIN's JSON, paths and `transforms.json` of nerfstudio, `cameras.json` of 3DGS, glTF cameras."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Float64

from ..safe_io.errors import SceneFormatError
from ..safe_io.files import read_json, whole_file
from .camera import Camera
from .camera_path import CameraPath, Interpolation
from .camera_path_edit import WALKING_M_S, keyframe_camera, with_constant_speed
from .easing import KEY_EASINGS, Easing
from .formats.gltf import GLTF, read_gltf_camera_path
from .geometry import normalized, quaternions_from_matrices
from .scene import Scene
from .transforms import world_to_file

VERSION = 3
"""Version 2 added interpolation, easing and loop, version 3 the easing of keyframes."""

_NUMBERS = re.compile(r"([0-9]+)")


def read_camera_path(path: Path | str, scene: Scene | None = None) -> CameraPath:
    """Read a camera path of any format, in the scene's own units and axes.

    Those of JSON files are these; of other programs, relative to the origin of the coordinates that the scene came
    from. A camera of a `.glb` or `.gltf` is placed as in the `.glb` that the scene is written to, in meters and y up.
    Without a scene, it is one of a file of Gaussians (1 m, -y up).
    """
    if Path(path).suffix.lower() in GLTF:
        try:
            found = read_gltf_camera_path(Path(path))
        except OSError as error:
            raise SceneFormatError(path, f"can't be read: {error.strerror}") from None
        if scene is None:
            return found
        to_scene = np.linalg.inv(world_to_file() @ scene.scene_to_world)
        to_scene[:3, 3] -= scene.origin
        return found.moved(to_scene)
    values = read_json(path)
    try:
        with np.errstate(all="ignore"):  # the path's own checks report overflow and division by 0
            reader = _reader(values, path)
            found = reader(values)
    except SceneFormatError:
        raise
    except KeyError as error:
        raise SceneFormatError(path, f"a keyframe has no field {error.args[0]!r}") from None
    except (TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        raise SceneFormatError(path, f"not a camera path: {error}") from None
    if scene is None or not any(scene.origin) or reader is camera_path_of_plain:
        return found
    return replace(found, positions=found.positions - np.array(scene.origin))


def write_camera_path(path: Path | str, camera_path: CameraPath) -> None:
    _write(path, plain_camera_path(camera_path))


def plain_camera_path(camera_path: CameraPath) -> dict[str, Any]:
    """Plain values of a camera path, as in GSRAIN's JSON."""
    p = camera_path
    columns = (column.tolist() for column in (p.times_s, p.positions, p.quaternions_wxyz, p.vertical_fov_deg))
    names = "time_s", "position", "quaternion_wxyz", "vertical_fov_deg"
    keyframes = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    between = {"interpolation": camera_path.interpolation, "easing": camera_path.easing, "loop": camera_path.loop}
    for key, easing in zip(keyframes, p.key_easings, strict=False):  # without easings, there are none
        key |= {"easing": easing} if easing is not None else {}
    return {"version": VERSION, **between, "keyframes": keyframes}


def _reader(values: Any, path: Path | str) -> Callable[[Any], CameraPath]:
    if isinstance(values, dict) and ("camera_path" in values or _is_nerfstudio_keyframe(values)):
        return _nerfstudio  # its files have keyframes too
    if isinstance(values, dict) and "keyframes" in values:
        if values.get("version", VERSION) > VERSION:
            raise SceneFormatError(path, f"version {values['version']} is newer than {VERSION}, which this reads")
        return camera_path_of_plain
    if isinstance(values, dict) and "frames" in values:
        return _transforms
    if isinstance(values, list) and values:
        return _training_cameras
    told = "expected keyframes, a nerfstudio camera_path, frames of a transforms.json, or a 3DGS list of cameras"
    raise SceneFormatError(path, f"{told} (or a .glb)")


def _is_nerfstudio_keyframe(values: dict[str, Any]) -> bool:
    keys = values.get("keyframes")
    return isinstance(keys, list) and bool(keys) and isinstance(keys[0], dict) and "matrix" in keys[0]


def camera_path_of_plain(values: dict[str, Any]) -> CameraPath:
    """Camera path of plain values as in GSRAIN's JSON; checked by `read_camera_path`, not here.

    Raises `KeyError`, `TypeError` or `ValueError` for other values.
    """
    keys = values["keyframes"]
    interpolation, easing = values.get("interpolation", "spline"), values.get("easing", "none")
    if interpolation not in get_args(Interpolation):
        raise ValueError(f"interpolation {interpolation!r} must be one of {', '.join(get_args(Interpolation))}")
    if easing not in get_args(Easing):
        raise ValueError(f"easing {easing!r} must be one of {', '.join(get_args(Easing))}")
    easings = tuple(key.get("easing") for key in keys)
    for each in easings:
        if each not in (None, *KEY_EASINGS):
            raise ValueError(f"the easing {each!r} of a keyframe must be one of {', '.join(KEY_EASINGS)}")
    return CameraPath(
        np.array([key["time_s"] for key in keys], np.float64),
        np.array([key["position"] for key in keys], np.float64).reshape(-1, 3),
        normalized(np.array([key["quaternion_wxyz"] for key in keys], np.float64).reshape(-1, 4)),
        np.array([key["vertical_fov_deg"] for key in keys], np.float64),
        interpolation=interpolation,
        easing=easing,
        loop=bool(values.get("loop")),
        key_easings=easings if any(easings) else (),
    )


def _nerfstudio(values: dict[str, Any]) -> CameraPath:
    """nerfstudio: 4x4 camera-to-world with OpenGL axes (y up, z backward), row-major; fov is vertical, degrees.

    A file without the rendered `camera_path` has the keyframes of its viewer: their transitions last
    `override_transition_sec` or `default_transition_sec`. Those of the older viewer are text, column-major.
    """
    _check_perspective("camera_type", values.get("camera_type", "perspective"))
    seconds, keys = values.get("seconds"), values.get("camera_path") or []
    if keys:
        poses = np.array([key["camera_to_world"] for key in keys], np.float64).reshape(-1, 4, 4)
        times = None if seconds is None else np.linspace(0, float(seconds), len(keys)) if len(keys) > 1 else np.zeros(1)
    else:
        keys = values.get("keyframes") or []
        if not keys:
            raise ValueError("it has neither frames in camera_path nor keyframes")
        poses = np.array([_keyframe_matrix(key["matrix"]) for key in keys], np.float64).reshape(-1, 4, 4)
        default = values.get("default_transition_sec")
        if default is None and seconds is not None and len(keys) > 1:
            default = float(seconds) / (len(keys) - 1)
        # The last transition leads back to the first keyframe, in a cycle.
        gaps = [_or_default(key.get("override_transition_sec"), default) for key in keys[:-1]]
        times = None if any(gap is None for gap in gaps) else np.cumsum([0.0, *map(float, gaps)])
    fov = np.array([_or_default(key.get("fov"), values.get("default_fov")) for key in keys], np.float64)
    path = _from_poses(times, poses[:, :3, :3] @ np.diag([1.0, -1.0, -1.0]), poses[:, :3, 3], fov)
    return replace(path, loop=bool(values.get("is_cycle"))) if not values.get("camera_path") else path


def _or_default(value: Any, default: Any) -> Any:
    return default if value is None else value


def _keyframe_matrix(matrix: Any) -> Float64[np.ndarray, "4 4"]:
    is_text = isinstance(matrix, str)
    found = np.array(json.loads(matrix) if is_text else matrix, np.float64).reshape(4, 4)
    return found.T if is_text else found


_PERSPECTIVE = ("perspective", "pinhole", "simple_pinhole", "opencv", "radial", "simple_radial", "full_opencv")


def _check_perspective(name: str, kind: Any) -> None:
    if str(kind).lower() not in _PERSPECTIVE:
        raise ValueError(f"{name} {kind!r} can't be flown, a perspective camera can")


def _transforms(values: dict[str, Any]) -> CameraPath:
    """`transforms.json` of nerfstudio and instant-ngp: camera-to-world with OpenGL axes; photos without times.

    Intrinsics are those of a frame, else of the file; a file with only `camera_angle_x` has square pictures, as
    those of NeRF's synthetic scenes. Sorted by name if all names differ.
    """
    frames: list[dict[str, Any]] = values["frames"]
    if len({_in_order(frame, "file_path") for frame in frames} - {()}) == len(frames):
        frames = sorted(frames, key=lambda frame: _in_order(frame, "file_path"))
    for each in (values, *frames):
        _check_perspective("camera_model", each.get("camera_model", "OPENCV"))
    poses = np.array([frame["transform_matrix"] for frame in frames], np.float64)
    if poses.shape[1:] not in ((4, 4), (3, 4)):
        raise ValueError(f"a transform_matrix has 4 rows of 4 numbers, not {' x '.join(map(str, poses.shape[1:]))}")
    fov = np.array([_vertical_fov_deg({**values, **frame}) for frame in frames], np.float64)
    return _from_poses(None, poses[:, :3, :3] @ np.diag([1.0, -1.0, -1.0]), poses[:, :3, 3], fov)


def _vertical_fov_deg(camera: dict[str, Any]) -> float:
    if "fl_y" in camera or "fl_x" in camera:
        focal = camera["fl_y"] if "fl_y" in camera else camera["fl_x"]
        return float(np.degrees(2 * np.arctan(0.5 * camera["h"] / focal)))
    if "camera_angle_y" in camera:
        return float(np.degrees(camera["camera_angle_y"]))
    aspect = camera["h"] / camera["w"] if "h" in camera and "w" in camera else 1.0
    return float(np.degrees(2 * np.arctan(aspect * np.tan(0.5 * camera["camera_angle_x"]))))


def _training_cameras(values: list[dict[str, Any]]) -> CameraPath:
    """3DGS: camera-to-world rotation with OpenCV axes, focal lengths in pixels; photos without times.

    Sorted by name if all names differ, frame_2 before frame_10: the file may list the test cameras first.
    """
    if len({_in_order(key, "img_name") for key in values} - {()}) == len(values):
        values = sorted(values, key=lambda key: _in_order(key, "img_name"))
    rotations = np.array([key["rotation"] for key in values], np.float64).reshape(-1, 3, 3)
    positions = np.array([key["position"] for key in values], np.float64).reshape(-1, 3)
    fov = [np.degrees(2 * np.arctan(0.5 * key["height"] / key["fy"])) for key in values]
    return _from_poses(None, rotations, positions, np.array(fov))


def _in_order(camera: dict[str, Any], field: str) -> tuple[tuple[bool, int, str], ...]:
    """Sort key of a training camera: its name with numbers as integers; empty without a name."""
    parts = _NUMBERS.split(str(camera.get(field, "")))
    return tuple((part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts if part)


_NOT_ORTHONORMAL = 0.05  # largest error of products of axes; more is no matter of rounding


def _from_poses(
    times: Float64[np.ndarray, " k"] | None,
    rotations: Float64[np.ndarray, "k 3 3"],
    positions: Float64[np.ndarray, "k 3"],
    fov: Float64[np.ndarray, " k"],
) -> CameraPath:
    """Path through poses at times, or, without times, at walking pace, with a unit taken for a meter."""
    turned = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) > _NOT_ORTHONORMAL
    bad = np.flatnonzero(turned | (np.linalg.det(rotations) < 0))
    if len(bad):
        raise ValueError(f"the matrix of keyframe {bad[0]} is no rotation: its axes must be orthonormal, right-handed")
    moments = np.arange(len(positions), dtype=np.float64) if times is None else times
    path = CameraPath(moments, positions, normalized(quaternions_from_matrices(rotations)), fov)
    return path if times is not None else with_constant_speed(path, WALKING_M_S)


# Export to nerfstudio and 3DGS

_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def frame_times(camera_path: CameraPath, fps: float) -> Float64[np.ndarray, " n"]:
    """Times of a path's frames; a loop omits the last one, which equals the first."""
    count = max(1, round(camera_path.duration_s * fps) + (0 if camera_path.loop else 1))
    return camera_path.start_s + np.arange(count) / fps


def write_nerfstudio_path(
    path: Path | str, camera_path: CameraPath, fps: float, width: int = 1920, height: int = 1080
) -> None:
    """Write a path for nerfstudio: every frame for `ns-render camera-path`, and the keyframes for its viewer."""
    times = frame_times(camera_path, fps)
    keys = [keyframe_camera(camera_path, key, width, height) for key in range(len(camera_path.times_s))]
    gaps = np.diff(camera_path.times_s, append=camera_path.end_s).tolist()
    values = {
        "camera_type": "perspective",
        "render_height": height,
        "render_width": width,
        "fps": fps,
        "seconds": float(times[-1] - times[0]),
        "is_cycle": camera_path.loop,
        "default_fov": float(camera_path.vertical_fov_deg[0]),
        "default_transition_sec": float(np.mean(gaps)),
        "keyframes": [
            {
                "matrix": _opengl_pose(key),
                "fov": key.vertical_fov_deg,
                "aspect": width / height,
                "override_transition_enabled": True,
                "override_transition_sec": gap,
            }
            for key, gap in zip(keys, gaps, strict=True)
        ],
        "camera_path": [
            {"camera_to_world": _opengl_pose(camera), "fov": camera.vertical_fov_deg, "aspect": width / height}
            for camera in (camera_path.camera(t, width, height) for t in times.tolist())
        ],
    }
    _write(path, values)


def write_training_cameras(
    path: Path | str, camera_path: CameraPath, fps: float, width: int = 1920, height: int = 1080
) -> None:
    """Write every frame of a path as a camera of 3DGS (`cameras.json`), a format without times."""
    values: list[dict[str, Any]] = []
    for number, t in enumerate(frame_times(camera_path, fps).tolist()):
        camera = camera_path.camera(t, width, height)
        pose = camera.camera_to_world
        values.append(
            {
                "id": number,
                "img_name": f"{number:05d}",
                "width": width,
                "height": height,
                "position": pose[:3, 3].tolist(),
                "rotation": pose[:3, :3].tolist(),
                "fy": camera.fy,
                "fx": camera.fx,
            }
        )
    _write(path, values)


def _opengl_pose(camera: Camera) -> list[float]:
    """Camera to world, row-major, for a camera with y up and z backward."""
    return (camera.camera_to_world @ _TO_OPENGL).ravel().tolist()


def _write(path: Path | str, values: Any) -> None:
    with whole_file(Path(path)) as part:
        part.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")

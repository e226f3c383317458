"""HUGSIM's released scenes (Zhou et al. 2024): Gaussians with a road, tracked vehicles, and 3DRealCar models.

Source: `capture` and `export_scene.py` in https://github.com/hyzhou404/HUGSIM. A folder holds

* `scene.pth`: a tuple of the Gaussians, with the road's own at its end, and the iteration;
* `dynamic_ID.pth` and `unicycle_ID.pth`: Gaussians and motion of each tracked vehicle;
* `meta_data.json`: cameras, times, poses and boxes of the recording;
* `cfg.yaml` and `ground_param.pkl`, which are not needed here.

A 3DRealCar folder holds `gs.pth` and `wlh.json`. Axes are those of the first front camera: x right, y down, z forward,
in meters. The network that adapts a view's colors to each camera's exposure is not applied.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Bool, Float64, Int64
from msgspec import Meta

from ...safe_io.errors import SceneFormatError, convert_checked
from ...safe_io.limits import read_file
from ...safe_io.text_files import json_values
from ..camera import DEFAULT_EXPOSURE_S
from ..gaussians import Gaussians
from ..scene import Actor, Layer, PoseTrack, RigCamera, Scene
from ..transforms import FILE_UP
from .boxed_actor import boxed_actor, track_of
from .tensors import MISFITS, SplatTensors, activated_rows, array_of, load_tensors, misfit

_SCENE, _VEHICLE = "scene.pth", "gs.pth"
_CONFIG, _RECORDING, _SIZE, _ROAD = "cfg.yaml", "meta_data.json", "wlh.json", "ground.pth"
_FRONT_CAMERAS = "CAM_FRONT", "front_camera", "cam_1", "cam_0"
"""Folders of the front camera's images: nuScenes, PandaSet, Waymo, KITTI-360."""

_SKY_CLASS = 10  # of Cityscapes, which the semantic features follow
_ROAD_THICKNESS_M = 0.001
_MOVING_M = 0.5  # shortest path that tells where a vehicle's front is
_MARGIN = 0.01  # fraction of a vehicle's Gaussians outside of its box on each side, where no file has the box
_RIG = "recorded"
_MODEL_VALUES = 9  # values of a model's state before the road's
_CAMERA_TO_EGO = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_Matrix = list[list[float]]
_Size = tuple[float, float, float]


class _Frame(msgspec.Struct, frozen=True):
    """An image of the recording."""

    rgb_path: str
    camtoworld: _Matrix
    intrinsics: list[list[float]]
    width: Annotated[int, Meta(ge=1)]
    height: Annotated[int, Meta(ge=1)]
    timestamp: float = 0.0
    dynamics: dict[str, _Matrix] = {}
    """Poses of vehicles' boxes by id."""

    def __post_init__(self) -> None:
        for name, matrix in {"camtoworld": self.camtoworld, **self.dynamics}.items():
            if [len(row) for row in matrix] != [4] * 4:
                raise ValueError(f"{name} is no 4x4 matrix")
        if [len(row) for row in self.intrinsics[:2]] not in ([3, 3], [4, 4]):
            raise ValueError("intrinsics are neither a 3x3 nor a 4x4 matrix")

    @property
    def camera(self) -> str:
        return PurePosixPath(self.rgb_path).parent.name

    @property
    def camera_to_scene(self) -> Float64[np.ndarray, "4 4"]:
        return np.array(self.camtoworld)


class _Recording(msgspec.Struct, frozen=True):
    frames: list[_Frame] = []
    verts: dict[str, list[tuple[float, float, float]]] = {}
    """Corners of each vehicle's box in its own frame."""


def is_hugsim_folder(folder: Path) -> bool:
    """Return whether a folder holds a scene of HUGSIM or a 3DRealCar vehicle, judged by the names of its files."""
    is_scene = (folder / _SCENE).is_file() and (folder / _CONFIG).is_file()
    return is_scene or ((folder / _VEHICLE).is_file() and (folder / _SIZE).is_file())


def is_vehicle_folder(folder: Path | str) -> bool:
    """Return whether a folder holds a 3DRealCar vehicle and no scene, judged by the names of its files."""
    found = [os.path.isfile(os.path.join(folder, name)) for name in (_VEHICLE, _SIZE, _SCENE)]  # noqa: PTH113, PTH118  those of Path raise where a name is too long
    return found == [True, True, False]


def hugsim_files(folder: Path) -> list[Path]:
    """Return the files of a folder that `read_hugsim` reads, by name."""
    named = [folder / name for name in (_SCENE, _VEHICLE, _ROAD, _RECORDING, _SIZE)]
    tracked = [*folder.glob("dynamic_*.pth"), *folder.glob("unicycle_*.pth")]
    return sorted(file for file in (*named, *tracked) if file.is_file())


def read_hugsim(folder: Path) -> Scene:
    """Read a released scene: background, road and sky as layers, vehicles with tracks, cameras and the ego track.

    A 3DRealCar folder becomes a scene with one vehicle. Checkpoints are read as tensors only: no code in them runs.

    Raises `SceneFormatError` for files that are missing, damaged, or hold anything but tensors.
    """
    name = folder.resolve().name
    if not (folder / _SCENE).is_file():
        return Scene(name, actors=(_vehicle(folder, name),))
    recording: _Recording = _json(folder / _RECORDING, _Recording) if (folder / _RECORDING).is_file() else _Recording()
    layers = _layers(folder)
    tracked = tuple(_tracked(file, recording) for file in sorted(folder.glob("dynamic_*.pth")))
    try:
        ego, cameras = _cameras(recording.frames)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise SceneFormatError(folder / _RECORDING, f"its cameras can't be used: {error}") from None
    road = [layer.gaussians.means[:, 1] for layer in layers if layer.name == "road"]
    ground_m = -float(np.median(road[0])) if road and len(road[0]) else None
    return Scene(name, layers, tracked, up=FILE_UP, ground_m=ground_m, ego=ego, rigs=cameras)


def _json(path: Path, kind: Any) -> Any:
    try:
        return convert_checked(json_values(read_file(path)), kind)
    except ValueError as error:
        raise SceneFormatError(path, str(error)) from None


def _layers(folder: Path) -> tuple[Layer, ...]:
    path = folder / _SCENE
    state = _checkpoint(path)
    model = _read_model(path, state)
    is_sky = model.classes == _SKY_CLASS
    layers = [Layer("background", model.gaussians.take(np.flatnonzero(~is_sky)))]
    if (folder / _ROAD).is_file():
        layers.append(Layer("road", _read_model(folder / _ROAD, _checkpoint(folder / _ROAD)).gaussians))
    elif road := [each for each in state[_MODEL_VALUES:] if isinstance(each, tuple | list)]:
        layers.append(Layer("road", _read_model(path, road[-1]).gaussians))
    if is_sky.any():
        layers.append(Layer("sky", model.gaussians.take(np.flatnonzero(is_sky)), kind="sky"))
    return tuple(layers)


def _cameras(frames: Sequence[_Frame]) -> tuple[PoseTrack | None, dict[str, tuple[RigCamera, ...]]]:
    """Ego track, which follows the front camera, and the cameras of the rig; without times there is none of them."""
    names = {frame.camera for frame in frames}
    front = next((name for name in _FRONT_CAMERAS if name in names), None)
    poses = {frame.timestamp: frame.camera_to_scene for frame in frames if frame.camera == front}
    if len(poses) < 2:
        return None, {}
    times, cameras, valid = _samples(poses, is_endless=True)
    ego = track_of(times, cameras @ np.linalg.inv(_CAMERA_TO_EGO), valid)
    rig: dict[str, RigCamera] = {}
    for frame in frames:
        if frame.camera not in rig and (pose := ego.pose(frame.timestamp)) is not None:
            (fx, _, cx), (_, fy, cy) = np.array(frame.intrinsics, np.float64)[:2, :3].tolist()
            mounted = np.linalg.inv(pose) @ frame.camera_to_scene
            rig[frame.camera] = RigCamera(
                frame.camera, frame.width, frame.height, fx, fy, cx, cy, mounted, DEFAULT_EXPOSURE_S
            )
    return ego, {_RIG: tuple(rig.values())}


def _samples(
    poses: Mapping[float, Float64[np.ndarray, "4 4"]], *, is_endless: bool
) -> tuple[Float64[np.ndarray, " t"], Float64[np.ndarray, "t 4 4"], Bool[np.ndarray, " t"]]:
    """Times, poses and validity of a track; one that is not endless is absent after its last sample."""
    times = sorted(poses)
    valid = np.ones(len(times), np.bool_)
    valid[-1] = is_endless
    return np.array(times), np.stack([poses[time_s] for time_s in times]), valid


# Vehicles


def _tracked(path: Path, recording: _Recording) -> Actor:
    """Vehicle of the recording; its motion is the fitted one where there is one, else the annotated one."""
    name = path.stem.removeprefix("dynamic_")
    gaussians = _read_model(path, _checkpoint(path)).gaussians
    fitted = path.with_name(f"unicycle_{name}.pth")
    annotated = {
        frame.timestamp: np.array(frame.dynamics[name]) for frame in recording.frames if name in frame.dynamics
    }
    poses = _unicycle_poses(fitted) if fitted.is_file() else annotated
    if not poses:
        raise SceneFormatError(path, f"neither {fitted.name} nor {_RECORDING} tells how the vehicle moves")
    corners = np.array(recording.verts[name]) if recording.verts.get(name) else _bounds(gaussians)
    matrices = np.stack([poses[time_s] for time_s in sorted(poses)])
    up = _signed_axis(np.mean(matrices[:, :3, :3].transpose(0, 2, 1) @ np.array(FILE_UP), axis=0))
    steps = np.diff(matrices[:, :3, 3], axis=0)
    travel = np.einsum("tji,tj->i", matrices[:-1, :3, :3], steps) * (1 - np.abs(up))
    front = travel if np.linalg.norm(travel) > _MOVING_M else np.ptp(corners, axis=0) * (1 - np.abs(up))
    last_s = max((frame.timestamp for frame in recording.frames), default=max(poses))
    return _actor(name, gaussians, _signed_axis(front), up, corners, poses, is_endless=max(poses) >= last_s)


def _vehicle(folder: Path, name: str) -> Actor:
    """3DRealCar vehicle, at rest: x forward, y down, z left. Its box is centered at the origin, as HUGSIM's is."""
    path = folder / _VEHICLE
    gaussians = _read_model(path, _checkpoint(path)).gaussians
    width, length, height = _json(folder / _SIZE, _Size)
    reach = np.array([length, height, width]) / 2
    middle = np.array([0.0, _bounds(gaussians)[1, 1] - reach[1], 0.0])  # it stands on its wheels
    corners = np.stack([middle - reach, middle + reach])
    front, up = np.array([1.0, 0, 0]), np.array(FILE_UP)
    to_scene = np.eye(4)
    to_scene[:3, :3] = np.stack([front, np.cross(up, front), up])
    return _actor(name, gaussians, front, up, corners, {0.0: to_scene}, is_endless=True)


def _actor(
    name: str,
    gaussians: Gaussians,
    front: Float64[np.ndarray, "3"],
    up: Float64[np.ndarray, "3"],
    corners: Float64[np.ndarray, "c 3"],
    poses: Mapping[float, Float64[np.ndarray, "4 4"]],
    *,
    is_endless: bool,
) -> Actor:
    return boxed_actor(name, "car", gaussians, front, up, corners, *_samples(poses, is_endless=is_endless))


def _unicycle_poses(path: Path) -> dict[float, Float64[np.ndarray, "4 4"]]:
    """Poses by time from (x, z, speed, pitch and roll, yaw, y, times, steps), angles counted from a quarter turn."""
    from scipy.spatial.transform import Rotation  # loads slowly, and few scenes need it

    try:
        x, z, _, pitch_roll, yaw, y, times = (array_of(each).astype(np.float64) for each in _checkpoint(path)[:7])
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, 3] = np.stack([x, y, z], axis=1)
        angles = np.pi / 2 - np.column_stack([pitch_roll, yaw])
        poses[:, :3, :3] = Rotation.from_euler("xzy", angles).as_matrix()
        if not (np.isfinite(poses).all() and np.isfinite(times).all()):
            raise ValueError("a pose or a time is not finite")
        return dict(zip(times.tolist(), poses, strict=True))
    except MISFITS as error:
        raise misfit(path, error) from None


def _bounds(gaussians: Gaussians) -> Float64[np.ndarray, "2 3"]:
    """Low and high corner of nearly all Gaussians, in their own axes."""
    if not len(gaussians):
        return np.zeros((2, 3))
    return np.quantile(gaussians.means.astype(np.float64), [_MARGIN, 1 - _MARGIN], axis=0)


def _signed_axis(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """Coordinate axis nearest to a direction, or its opposite."""
    axis = np.zeros(3)
    largest = int(np.abs(direction).argmax())
    axis[largest] = -1.0 if direction[largest] < 0 else 1.0
    return axis


# Checkpoints


def _checkpoint(path: Path) -> Sequence[Any]:
    """State of a model: the first of the two values of a checkpoint."""
    found = load_tensors(path)
    state = found[0] if isinstance(found, tuple | list) and len(found) == 2 else found
    if not isinstance(state, tuple | list):
        raise SceneFormatError(path, f"holds {type(found).__name__}, not the tensors of a model")
    return state


class _Model(NamedTuple):
    gaussians: Gaussians
    classes: Int64[np.ndarray, " n"]


def _read_model(path: Path, state: Sequence[Any]) -> _Model:
    """Gaussians and their most likely classes.

    `state` is (SH degree, means, SH of degree 0, other SH, features of classes, log scales, quaternions wxyz,
    opacities before the sigmoid, ...). The road's Gaussians are flat and have two scales.
    """
    try:
        means, constant, others, features, scales, quaternions, logits = state[1:8]
        trained = SplatTensors(means, scales, quaternions, logits, constant, others, thickness=_ROAD_THICKNESS_M)
        gaussians, fit = activated_rows(path, trained, max_degree=int(state[0]))
        return _Model(gaussians, array_of(features).reshape(len(fit), -1)[fit].argmax(axis=1))
    except SceneFormatError:
        raise
    except MISFITS as error:
        raise misfit(path, error) from None

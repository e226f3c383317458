"""Rows of the table: files of scenes, camera paths and cameras."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera import Camera, read_camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import plain_camera_path, read_camera_path
from gsrain_engine.scene.formats.registry import read_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import PoseTrack
from tests.scene.formats.sample_files import SMALL_FILES, assert_valid, write_small, write_sog_folder
from tests.scene.formats.test_scene_folder import sample_scene
from tests.scene.test_camera_path import write_gltf_camera

from .mutations import Damage, damaged_bytes, damaged_glb, damaged_header, damaged_json, inside_gzip, inside_zip
from .reader import Reader, one_file

_PLY = damaged_header(b"end_header\n")
_DAMAGE: dict[str, Damage] = {
    ".ply": _PLY,
    ".spz": inside_gzip(),
    ".glb": damaged_glb,
    ".usdz": inside_zip(lambda name: damaged_bytes),
    ".zip": inside_zip(lambda name: damaged_bytes),
    ".sog": inside_zip(lambda name: damaged_json if name == "meta.json" else damaged_bytes),
}


def assert_track(track: PoseTrack) -> None:
    """Assert that a track has a pose at any time."""
    for values in (track.times, track.positions, track.quaternions_wxyz):
        assert np.isfinite(values).all(), "holds a track that is not finite"
    assert (np.diff(track.times) > 0).all(), "holds a track whose times don't rise"
    assert np.allclose(np.linalg.norm(track.quaternions_wxyz, axis=1), 1, atol=1e-4), "holds a turn that is none"
    for time in (-1e9, *track.times[:3].tolist(), 1e9):
        pose = track.pose(time)
        assert pose is None or np.isfinite(pose).all(), "holds a track whose poses are not finite"


def assert_camera(camera: Camera) -> None:
    """Assert that a camera can be drawn with."""
    assert 1 <= camera.width <= 16384 and 1 <= camera.height <= 16384, "has a camera of no size, or a huge one"
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, camera.exposure_s, *camera.world_to_camera.ravel()]
    assert np.isfinite(numbers).all(), "has a camera that is not finite"
    assert camera.fx > 0 and camera.fy > 0 and camera.exposure_s > 0, "has a camera without focal length or exposure"
    turn = camera.world_to_camera[:3, :3]
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-2), "has a camera whose pose is not rigid"


def assert_path(path: CameraPath) -> None:
    """Assert that a camera path can be flown."""
    assert np.isfinite([path.start_s, path.end_s, path.duration_s]).all(), "has a path that does not end"
    for time in np.linspace(path.start_s, path.end_s, 4).tolist():
        assert_camera(path.camera(time, 64, 48))
        assert np.isfinite(path.velocity(time)).all(), "has a path with an endless speed"


def _read_scene(path: Path) -> None:
    scene = read_scene(path)
    assert scene.metres_per_unit > 0 and np.isfinite(scene.metres_per_unit), "has no unit"
    assert np.isfinite(scene.scene_to_world).all(), "stands nowhere"
    for member in scene.members:
        assert_valid(member.gaussians)
        assert 0 <= member.opacity <= 1
    for track in (scene.ego, *(actor.track for actor in scene.actors)):
        if track is not None:
            assert_track(track)
    for each in scene.rigs.values():
        assert all(np.isfinite(camera.camera_to_ego).all() and np.isfinite(camera.fx) for camera in each)
    for part in scene.parts(0.5):
        assert_valid(part.gaussians)
    if scene.path is not None:
        assert_path(scene.path)


def _scene_folder(folder: Path) -> Path:
    write_scene(sample_scene(), folder / "scene")
    return folder / "scene"


def _own_path() -> Any:
    turns = np.linspace(0, 1, 4)
    quaternions = np.stack([np.cos(turns), 0 * turns, np.sin(turns), 0 * turns], axis=1)
    places = np.stack([turns, turns**2, 1 - turns], axis=1)
    path = CameraPath(turns * 5, places, quaternions, 40 + 10 * turns, easing="in and out", loop=True)
    return plain_camera_path(path)


def _nerfstudio_path() -> Any:
    keys = []
    for k in range(3):
        pose = np.eye(4)
        pose[:3, 3] = [k, 1.0, 2.0]
        keys.append({"camera_to_world": pose.ravel().tolist(), "fov": 50 + k, "aspect": 1.5})
    return {"camera_path": keys, "seconds": 4.0, "fps": 24, "keyframes": []}


def _training_cameras() -> Any:
    rest = {"width": 64, "height": 48, "fy": 50.0, "fx": 51.0, "rotation": np.eye(3).tolist()}
    return [{"id": k, "img_name": f"{k}", "position": [k, 0.5, 2.0], **rest} for k in range(3)]


def _camera() -> Any:
    return {**Camera.from_fov(64, 48, 50.0, np.eye(4)).to_json(), "exposure_s": 0.002}


def _row(name: str, write: Callable[[Path], Path], read: Callable[[Path], None], *damage: tuple[str, Damage]) -> Reader:
    tries = 3 if name == ".usdz" else 40  # each of a .usdz is read in a process of its own
    return Reader(name, write, read, SceneFormatError, damage, tries=tries)


def _json(name: str, file: str, values: Callable[[], Any], read: Callable[[Path], None]) -> Reader:
    write = one_file(file, lambda path: path.write_text(json.dumps(values())))
    return _row(name, write, read, ("*", damaged_json))


SCENE_READERS = (
    *(
        _row(
            name,
            partial(write_small, name),
            lambda path: assert_valid(read_gaussians(path)),
            ("*", damaged_bytes if name == "spz-4" else _DAMAGE.get(Path(file).suffix, damaged_bytes)),
        )
        for name, (file, _) in SMALL_FILES.items()
    ),
    _row("sog-folder", write_sog_folder, _read_scene, ("meta.json", damaged_json), ("*.webp", damaged_bytes)),
    _row("scene-json", _scene_folder, _read_scene, ("scene.json", damaged_json)),
    _row("scene-files", _scene_folder, _read_scene, ("*.ply", _PLY), ("*.npy", damaged_bytes)),
    _json("camera-path", "path.json", _own_path, lambda path: assert_path(read_camera_path(path))),
    _json("nerfstudio-path", "path.json", _nerfstudio_path, lambda path: assert_path(read_camera_path(path))),
    _json("3dgs-cameras", "cameras.json", _training_cameras, lambda path: assert_path(read_camera_path(path))),
    _row(
        "gltf-camera",
        one_file("path.gltf", partial(write_gltf_camera, uri="data:,{}")),
        lambda path: assert_path(read_camera_path(path)),
        ("*.gltf", damaged_json),
    ),
    _json("camera", "camera.json", _camera, lambda path: assert_camera(read_camera(path))),
)
"""Scenes, and what looks at them."""

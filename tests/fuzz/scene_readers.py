"""Rows of the table: files of scenes, camera paths and cameras."""

import gzip
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.scene.camera import Camera, read_camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import plain_camera_path, read_camera_path
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.registry import read_gaussians, write_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.spz import encode_spz
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import PoseTrack, Scene
from tests.scene.formats.sample_gaussians import sample_gaussians
from tests.scene.formats.test_compressed_ply import BOUNDS, compressed
from tests.scene.formats.test_ksplat import encode, some_gaussians
from tests.scene.formats.test_scene_folder import sample_scene
from tests.scene.formats.test_sog import scene as sog_scene
from tests.scene.formats.test_sog import zipped
from tests.scene.formats.test_spz import version_4

from .containers import inside_gzip, inside_zip
from .json_mutations import damaged_json
from .mutations import damaged_bytes, damaged_header
from .reader import Reader

_SMALL = sample_gaussians(7, 1)
_PLY = damaged_header(b"end_header\n")


def assert_gaussians(found: Gaussians) -> None:
    """Assert that Gaussians are what their class says."""
    for values in (found.means, found.scales, found.quaternions, found.opacities, found.sh):
        assert values.dtype == np.float32, f"holds {values.dtype}"
        assert np.isfinite(values).all(), "holds numbers that are not finite"
    assert (found.scales >= 0).all(), "holds a scale below 0"
    assert ((found.opacities >= 0) & (found.opacities <= 1)).all(), "holds an opacity outside 0..1"
    assert np.allclose(np.linalg.norm(found.quaternions, axis=1), 1, atol=1e-4), "holds a quaternion that is not unit"


def assert_track(track: PoseTrack) -> None:
    """Assert that a track can be asked where it is."""
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


def _read_gaussians(path: Path) -> None:
    assert_gaussians(read_gaussians(path))


def _read_scene(path: Path) -> None:
    scene = read_scene(path)
    assert scene.metres_per_unit > 0 and np.isfinite(scene.metres_per_unit), "has no unit"
    assert np.isfinite(scene.scene_to_world).all(), "stands nowhere"
    for member in scene.members:
        assert_gaussians(member.gaussians)
        assert 0 <= member.opacity <= 1
    for track in (scene.ego, *(actor.track for actor in scene.actors)):
        if track is not None:
            assert_track(track)
    for each in scene.rigs.values():
        assert all(np.isfinite(camera.camera_to_ego).all() and np.isfinite(camera.fx) for camera in each)
    for part in scene.parts(0.5):
        assert_gaussians(part.gaussians)
    if scene.path is not None:
        assert_path(scene.path)


def assert_path(path: CameraPath) -> None:
    """Assert that a camera path can be flown."""
    assert np.isfinite([path.start_s, path.end_s, path.duration_s]).all(), "has a path that does not end"
    for time in np.linspace(path.start_s, path.end_s, 4).tolist():
        camera = path.camera(time, 64, 48)
        assert_camera(camera)
        assert np.isfinite(path.velocity(time)).all(), "has a path with an endless speed"


def _read_path(path: Path) -> None:
    assert_path(read_camera_path(path))


def _read_camera(path: Path) -> None:
    assert_camera(read_camera(path))


def _file(name: str, content: Callable[[], bytes]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content())
        return folder / name

    return write


def _gaussians(name: str, gaussians: Gaussians) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        write_gaussians(gaussians, folder / name)
        return folder / name

    return write


def _spz(version: int) -> bytes:
    """Versions 1 and 2, which nobody writes any more: of version 3, with other means and quaternions."""
    data = gzip.decompress(encode_spz(sample_gaussians(6, 2)))
    n, rest = 6, data[16 + 9 * 6 :]
    means = np.linspace(-2, 2, 3 * n).astype("<f2").tobytes() if version == 1 else data[16 : 16 + 9 * n]
    rest = rest[: 7 * n] + bytes(range(100, 100 + 3 * n)) + rest[11 * n :]
    return gzip.compress(data[:4] + struct.pack("<I", version) + data[8:16] + means + rest, mtime=0)


def _sog(version: int) -> bytes:
    meta, files, _ = sog_scene(2)
    if version == 1:
        ranges = {"mins": [-9, -8, -7], "maxs": [1, 0, 2]}
        meta = {
            "means": {**meta["means"], "shape": [37, 3], "dtype": "float32"},
            "scales": {**ranges, "files": ["scales.webp"]},
            "quats": meta["quats"],
            "sh0": {"mins": [-1, -2, -3, -6], "maxs": [1, 2, 3, 4], "files": ["sh0.webp"]},
            "shN": {"mins": -0.5, "maxs": 1.5, "files": meta["shN"]["files"]},
        }
    return zipped(meta, files)


def _sog_folder(folder: Path) -> Path:
    meta, files, _ = sog_scene(3)
    (folder / "meta.json").write_text(json.dumps(meta))
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def _scene_folder(folder: Path) -> Path:
    scene: Scene = sample_scene()
    road, sky = (replace(layer, visible=True) for layer in scene.layers)
    marks = SelectionFlags(hidden=BitMask.of(np.arange(50) % 3 == 0), deleted=BitMask.of(np.arange(50) == 7))
    road = replace(road, marks=marks, wet_sh=road.gaussians.sh * np.float32(0.5), opacity=0.5)
    chosen = {"set": {"layers/road & kerb": BitMask.of(np.arange(50) < 9)}}
    weather = {"keys": [{"time_s": 0.0, "intensity_mm_h": 2.0}]}
    scene = replace(scene, layers=(road, sky), path=_path(), selections=chosen, weather=weather, view={"time_s": 1.0})
    write_scene(scene, folder / "scene")
    return folder / "scene"


def _path(**fields: Any) -> CameraPath:
    turns = np.linspace(0, 1, 4)
    quaternions = np.stack([np.cos(turns), 0 * turns, np.sin(turns), 0 * turns], axis=1)
    places = np.stack([turns, turns**2, 1 - turns], axis=1)
    return CameraPath(turns * 5, places, quaternions, 40 + 10 * turns, **fields)


def _own_path() -> bytes:
    return json.dumps(plain_camera_path(_path(easing="in and out", loop=True))).encode()


def _nerfstudio_path() -> bytes:
    keys = []
    for k in range(3):
        pose = np.eye(4)
        pose[:3, 3] = [k, 1.0, 2.0]
        keys.append({"camera_to_world": pose.ravel().tolist(), "fov": 50 + k, "aspect": 1.5})
    return json.dumps({"camera_path": keys, "seconds": 4.0, "fps": 24, "keyframes": []}).encode()


def _training_cameras() -> bytes:
    rows = [
        {"id": k, "img_name": f"{k}", "width": 64, "height": 48, "position": [k, 0.5, 2.0], "fy": 50.0, "fx": 51.0,
         "rotation": np.eye(3).tolist()}
        for k in range(3)
    ]  # fmt: skip
    return json.dumps(rows).encode()


def _camera() -> bytes:
    return json.dumps({**Camera.from_fov(64, 48, 50.0, np.eye(4)).to_json(), "exposure_s": 0.002}).encode()


def _row(
    name: str, write: Callable[[Path], Path], *damage: Any, read: Callable[[Path], None] = _read_gaussians
) -> Reader:
    return Reader(name, write, read, SceneFormatError, tuple(damage) or (("*", damaged_bytes),))


SCENE_READERS = (
    _row("ply", _gaussians("a.ply", _SMALL), ("*", _PLY)),
    _row("ply-sh3", _gaussians("a.ply", sample_gaussians(3, 3)), ("*", _PLY)),
    _row("compressed-ply", _file("a.compressed.ply", lambda: compressed(7, 1, BOUNDS, sh_rows=7)), ("*", _PLY)),
    _row("splat", _gaussians("a.splat", _SMALL)),
    *(
        _row(f"spz-{version}", _file("a.spz", lambda version=version: _spz(version)), ("*", inside_gzip()))
        for version in (1, 2)
    ),
    _row("spz-3", _gaussians("a.spz", _SMALL), ("*", inside_gzip())),
    _row("spz-4", _file("a.spz", lambda: version_4(_SMALL))),
    *(
        _row(
            f"ksplat-{level}",
            _file("a.ksplat", lambda level=level: encode([some_gaussians(40, 1), some_gaussians(9, 2, 1)], level)[1]),
        )
        for level in (0, 1, 2)
    ),
    *(
        _row(
            f"sog-{version}",
            _file("a.sog", lambda version=version: _sog(version)),
            ("*", inside_zip(lambda name: damaged_json if name == "meta.json" else damaged_bytes)),
        )
        for version in (1, 2)
    ),
    _row("sog-folder", _sog_folder, ("meta.json", damaged_json), ("*.webp", damaged_bytes), read=_read_scene),
    _row("scene-json", _scene_folder, ("scene.json", damaged_json), read=_read_scene),
    _row("scene-files", _scene_folder, ("*.ply", _PLY), ("*.npy", damaged_bytes), read=_read_scene),
    _row("camera-path", _file("path.json", _own_path), ("*", damaged_json), read=_read_path),
    _row("nerfstudio-path", _file("path.json", _nerfstudio_path), ("*", damaged_json), read=_read_path),
    _row("3dgs-cameras", _file("cameras.json", _training_cameras), ("*", damaged_json), read=_read_path),
    _row("camera", _file("camera.json", _camera), ("*", damaged_json), read=_read_camera),
)
"""Scenes, and what looks at them."""

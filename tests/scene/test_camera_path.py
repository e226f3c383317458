"""Camera paths: through their keyframes, by splines or lines, in loops, eased; and their files, ours and others'."""

import base64
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath, circle_path, orbit_path
from gsrain_engine.scene.camera_path_edit import WALKING_M_S
from gsrain_engine.scene.camera_path_io import (
    frame_times,
    read_camera_path,
    write_camera_path,
    write_nerfstudio_path,
    write_training_cameras,
)
from gsrain_engine.scene.easing import apply_easing
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.rig import rig_camera_path
from gsrain_engine.scene.scene import PoseTrack, RigCamera, Scene
from small_scene import AHEAD, small_scene

EASINGS = ["none", "in and out", "at each key"]
KNOTS = np.array([0.0, 1.0, 2.5, 3.0])


def path_of(keys: int = 6, seed: int = 2, **fields: Any) -> CameraPath:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(keys, random_state=seed).as_quat()[:, [3, 0, 1, 2]]
    times = np.cumsum(rng.uniform(0.5, 2, keys))
    return CameraPath(times, rng.normal(0, 5, (keys, 3)), turns, rng.uniform(30, 60, keys), **fields)


# Between keyframes


def test_a_spline_goes_through_its_keys_and_is_scipys() -> None:
    path = path_of()
    positions = CubicSpline(path.times_s, path.positions, bc_type="natural")
    rotations = RotationSpline(path.times_s, Rotation.from_quat(path.quaternions_wxyz[:, [1, 2, 3, 0]]))
    fov = PchipInterpolator(path.times_s, path.vertical_fov_deg)
    for t in np.linspace(path.times_s[0], path.times_s[-1], 23).tolist():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotations(t).as_matrix(), positions(t)
        camera = path.camera(t, 90, 60)
        np.testing.assert_allclose(camera.world_to_camera, np.linalg.inv(pose), atol=1e-12)
        assert camera.fy == 0.5 * 60 / np.tan(np.radians(float(fov(t))) / 2)
        assert path.velocity(t).tobytes() == positions(t, 1).tobytes()
    for t, key in ((path.start_s - 1, 0), (path.end_s + 9, -1)):  # the camera rests before the path and after it
        assert path.camera(t, 9, 6).position == pytest.approx(path.positions[key])
        assert path.velocity(t) == pytest.approx([0, 0, 0])


@pytest.mark.parametrize("interpolation", ["spline", "linear"])
def test_turns_at_single_times_are_those_at_many(interpolation: str) -> None:
    steps = np.array([[0, 0, 0], [0.1, 0.2, 0], [0, 3.0, 0], [0, 3.0, 0.5], [0, 0, 3.1]])  # spline: over half a turn
    turns = Rotation.from_rotvec(steps) * Rotation.from_rotvec(np.cumsum(0.5 * steps, axis=0))
    path = CameraPath(
        np.array([0.0, 0.4, 2.0, 2.1, 5.0]), np.zeros((5, 3)), turns.as_quat()[:, [3, 0, 1, 2]], np.full(5, 40.0),
        interpolation=interpolation,
    )  # fmt: skip
    times = np.linspace(0, 5, 101)
    single = [path.camera(time, 9, 6).camera_to_world[:3, :3] for time in times.tolist()]
    np.testing.assert_allclose(single, path.turns(times), atol=1e-9)


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
def test_a_segment_ends_at_its_key_however_its_length_is_rounded(interpolation: str) -> None:
    start_s, end_s = 2.4, 7.2
    assert start_s + (end_s - start_s) > end_s
    path = replace(path_of(2, interpolation=interpolation), times_s=np.array([start_s, end_s]))
    last = path.camera(end_s, 9, 6).camera_to_world[:3, :3]
    np.testing.assert_allclose(last, path.turns(path.times_s)[-1], atol=1e-9)


def test_keys_for_which_scipy_finds_no_spline_are_turned_between_evenly() -> None:
    turns = [
        [-0.5, 0.323, -0.789, 0.150],
        [0.442, 0.012, 0.264, 0.857],
        [0.678, -0.210, 0.677, -0.194],
        [-0.304, 0.185, 0.432, 0.829],
    ]
    keys = {"times_s": np.array([0.0, 0.1, 1.9, 9.3]), "quaternions_wxyz": np.array(turns)}
    path = replace(path_of(4), **keys)
    assert np.isfinite(path.turns(np.linspace(0.0, 9.3, 40))).all()
    found = Rotation.from_matrix(path.turns(np.linspace(1.9, 9.3, 40)))
    assert (found[1:] * found[:-1].inv()).magnitude().max() < 0.2


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
def test_single_turns_of_a_gentle_path_need_no_scipy(interpolation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = path_of(interpolation=interpolation)
    expected = path.turns(path.times_s)
    monkeypatch.setattr(Rotation, "as_matrix", lambda _: pytest.fail("the slow way"))
    single = [path.camera(time, 9, 6).camera_to_world[:3, :3] for time in path.times_s.tolist()]
    np.testing.assert_allclose(single, expected, atol=1e-9)


def test_lines_are_straight_and_so_is_the_last_stretch_of_their_loop() -> None:
    path = path_of(interpolation="linear")
    times = np.linspace(path.start_s, path.end_s, 23)
    for column, expected in zip(path.places(times).T, path.positions.T, strict=True):
        np.testing.assert_allclose(column, np.interp(times, path.times_s, expected), atol=1e-12)
    fov = [path.camera(t, 90, 60).vertical_fov_deg for t in times.tolist()]
    np.testing.assert_allclose(fov, np.interp(times, path.times_s, path.vertical_fov_deg))
    middles = 0.5 * (path.times_s[1:] + path.times_s[:-1])
    steps = np.diff(path.positions, axis=0) / np.diff(path.times_s)[:, None]
    np.testing.assert_allclose(path.velocities(middles), steps)
    a, b = (Rotation.from_quat(q[[1, 2, 3, 0]]) for q in path.quaternions_wxyz[:2])
    half = a * Rotation.from_rotvec(0.5 * (a.inv() * b).as_rotvec())
    np.testing.assert_allclose(path.turns(middles)[0], half.as_matrix(), atol=1e-9)
    loop = replace(path, loop=True)
    camera = loop.camera(float(0.75 * loop.times_s[-1] + 0.25 * loop.end_s), 9, 6)
    assert camera.position == pytest.approx(0.75 * loop.positions[-1] + 0.25 * loop.positions[0])


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 6), st.integers(0, 50), st.sampled_from(EASINGS))
def test_a_loop_closes_in_place_and_speed(keys: int, seed: int, easing: str) -> None:
    path = path_of(keys, seed, loop=True, easing=easing)
    assert path.duration_s == pytest.approx((path.times_s[-1] - path.times_s[0]) * keys / (keys - 1))
    h = 1e-6
    for seam in (path.start_s, path.end_s, path.start_s + 3 * path.duration_s):
        before, after = path.camera(seam - h, 9, 6), path.camera(seam + h, 9, 6)
        assert np.allclose(before.camera_to_world, after.camera_to_world, atol=1e-3)
        assert path.velocity(seam - h) == pytest.approx(path.velocity(seam + h), abs=1e-3)
        turns = path.turns(np.array([seam - 2 * h, seam - h, seam + h, seam + 2 * h]))
        rates = [(turns[i].T @ turns[i + 1] - np.eye(3)) / h for i in (0, 2)]
        assert np.allclose(rates[0], rates[1], atol=1e-2)
    later = path.camera(path.start_s + 0.3 + 2 * path.duration_s, 9, 6)
    assert np.allclose(later.world_to_camera, path.camera(path.start_s + 0.3, 9, 6).world_to_camera, atol=1e-9)
    for k, t in enumerate(path.times_s):
        assert path.camera(float(t), 9, 6).position == pytest.approx(path.positions[k], abs=1e-9)


@pytest.mark.parametrize("easing", EASINGS)
def test_easing_is_monotone_and_rests_where_it_should(easing: Any) -> None:
    t = np.linspace(0, 3, 3001)
    times, rates = apply_easing(easing, KNOTS, t)
    assert np.all(np.diff(times) >= 0) and np.all(rates >= 0)
    middle = (times[2:] - times[:-2]) / (t[2:] - t[:-2])
    assert middle == pytest.approx(rates[1:-1], abs=6e-3)
    assert np.abs(np.diff(rates)).max() < 0.02  # no jumps, at keys neither
    at_keys = apply_easing(easing, KNOTS, KNOTS)
    assert at_keys.times_s == pytest.approx(KNOTS)
    rests = {"none": [], "in and out": [0, 3], "at each key": [0, 1, 2, 3]}[easing]
    assert [k for k in range(4) if at_keys.rates[k] < 1e-9] == rests


@settings(max_examples=25)
@given(st.integers(1, 6), st.booleans(), st.sampled_from(EASINGS), st.floats(0.05, 0.95))
def test_velocities_are_derivatives_and_many_moments_at_once_are_one_by_one(
    keys: int, loop: bool, easing: str, share: float
) -> None:
    path, h = path_of(keys, loop=loop and keys > 1, easing=easing), 1e-6
    t = path.start_s + share * max(path.duration_s, 1e-3)
    if keys > 1:
        change = (path.camera(t + h, 9, 6).position - path.camera(t - h, 9, 6).position) / (2 * h)
        assert path.velocity(t) == pytest.approx(change, rel=1e-3, abs=1e-3)
    times = np.linspace(path.start_s - 1, path.end_s + 1, 9)
    for k, time in enumerate(times.tolist()):
        camera = path.camera(time, 9, 6)
        assert path.places(times)[k] == pytest.approx(camera.position, abs=1e-9)
        assert np.allclose(path.turns(times)[k], camera.camera_to_world[:3, :3], atol=1e-9)
        assert np.array_equal(path.velocities(times)[k], path.velocity(time))


# Made of cameras, of drives and around things


def test_a_path_flies_through_cameras() -> None:
    up = np.array([0.0, 0, 1])
    eyes = np.array([[0.0, 0, 2], [5, 1, 3], [9, -2, 8]])
    cameras = [
        Camera.from_fov(90, 60, fov, look_at(eye, np.array([30.0, 0, 0]), up))
        for eye, fov in zip(eyes, (30, 40, 50), strict=True)
    ]
    path = CameraPath.through([1.0, 2.5, 3.0], [replace(cameras[0], exposure_s=0.02), *cameras[1:]])
    assert (path.start_s, path.end_s, path.exposure_s) == (1.0, 3.0, 0.02)
    for t, camera in zip((1.0, 2.5, 3.0), cameras, strict=True):
        found = path.camera(t, 90, 60)
        assert np.allclose(found.world_to_camera, camera.world_to_camera, atol=1e-9)
        assert found.fy == pytest.approx(camera.fy)
    for times, count, reason in (([], 0, "at least one"), ([0.0], 2, "1 for 2"), ([1.0, 1.0], 2, "rising")):
        with pytest.raises(ValueError, match=reason):
            CameraPath.through(times, cameras[:count])


def test_a_moved_path_has_moved_cameras_and_what_lies_between_its_keys() -> None:
    similarity = np.array([[0, 0, 2.0, 5], [-2.0, 0, 0, 6], [0, -2.0, 0, 7], [0, 0, 0, 1]])
    path = path_of(loop=True, easing="at each key", interpolation="linear", exposure_s=0.002)
    moved = path.moved(similarity)
    there = path.camera(1.3, 96, 64).moved(similarity).world_to_camera
    assert np.allclose(moved.camera(1.3, 96, 64).world_to_camera, there, atol=1e-9)
    assert (moved.loop, moved.easing, moved.interpolation, moved.exposure_s) == (True, "at each key", "linear", 0.002)


def test_the_path_of_a_rig_camera_rides_with_the_ego() -> None:
    times = np.arange(3.0)
    places = np.stack([5 * times, np.zeros(3), np.full(3, 1.5)], axis=1)
    ego = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (3, 1)), np.ones(3, bool))
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = AHEAD, [1.0, 0, 0.5]
    front = RigCamera("FRONT", 1920, 1280, 2060.0, 2060.0, 960.0, 640.0, mount, 0.003)
    path = rig_camera_path(Scene("s", ego=ego, rigs={"r": (front,)}), front, 960, 640)
    camera = path.camera(1.0, 960, 640)
    assert camera.position == pytest.approx([6, 0, 2.0])
    assert (camera.fx, camera.exposure_s) == (pytest.approx(1030), 0.003)
    assert path.velocity(1.0) == pytest.approx([5, 0, 0])
    with pytest.raises(ValueError, match="no ego track"):
        rig_camera_path(Scene("s"), front, 960, 640)


@pytest.mark.parametrize("is_circle", [True, False])
def test_orbits_and_circles_keep_their_distance_and_their_sight(is_circle: bool) -> None:
    start = Camera.from_fov(96, 64, 50.0, look_at(np.array([10.0, 0, 2]), np.zeros(3), np.array([0.0, 0, 1])))
    path = circle_path(np.zeros(3), start, 8.0) if is_circle else orbit_path(np.zeros(3), start, 8.0, 60.0)
    at_start = path.camera(0.0 if is_circle else 4.0, 96, 64)
    assert path.duration_s == 8 and np.allclose(at_start.world_to_camera, start.world_to_camera, atol=1e-9)
    for t in np.linspace(0, 16 if is_circle else 8, 33).tolist():
        camera = path.camera(t, 96, 64)
        assert np.linalg.norm(camera.position[:2]) == pytest.approx(10, rel=1e-3)
        assert camera.world_to_camera[:2, 3] == pytest.approx([0, 0], abs=0.02)
        if is_circle:
            assert np.linalg.norm(path.velocity(t)) == pytest.approx(2 * np.pi * 10 / 8, rel=0.01)
    if is_circle:
        assert path.camera(4.0, 96, 64).position == pytest.approx([-10, 0, 2], abs=1e-9)


# Files


def same_view(a: Camera, b: Camera) -> None:
    assert np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-9)
    assert a.fy == pytest.approx(b.fy)


@pytest.mark.parametrize("changes", [{}, {"interpolation": "linear", "easing": "at each key", "loop": True}])
def test_our_own_file_comes_back(changes: dict[str, Any], tmp_path: Path) -> None:
    file, path = tmp_path / "path.json", path_of(4, **changes)
    write_camera_path(file, path)
    assert json.loads(file.read_text())["version"] == 3
    found = read_camera_path(file)
    assert (found.interpolation, found.easing, found.loop) == (path.interpolation, path.easing, path.loop)
    for t in np.linspace(path.start_s, path.end_s, 5).tolist():
        same_view(found.camera(t, 96, 64), path.camera(t, 96, 64))


def test_files_of_nerfstudio_and_3dgs_come_back_frame_by_frame(tmp_path: Path) -> None:
    file, path = tmp_path / "path.json", replace(path_of(4), times_s=np.array([0.0, 1, 2, 4]))
    write_nerfstudio_path(file, path, 10.0, 1920, 1080)
    values = json.loads(file.read_text())
    assert (values["render_width"], values["fps"], values["seconds"]) == (1920, 10, 4)
    assert [key["override_transition_sec"] for key in values["keyframes"]] == [1, 1, 2, 0]
    found = read_camera_path(file)
    assert found.times_s == pytest.approx(np.arange(41) / 10) and found.is_timed
    for t in (0.0, 0.3, 2.0, 3.9, 4.0):
        same_view(found.camera(t, 96, 64), path.camera(t, 96, 64))
    write_training_cameras(file, path, 2.0, 600, 400)
    names = {"id", "img_name", "width", "height", "position", "rotation", "fx", "fy"}
    assert set(json.loads(file.read_text())[0]) == names
    found = read_camera_path(file)
    assert len(found.times_s) == 9 and not found.is_timed
    for number, t in enumerate(found.times_s.tolist()):
        same_view(found.camera(t, 600, 400), path.camera(number / 2, 600, 400))
    assert frame_times(path, 2.0).tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4]
    loop = replace(path, loop=True)
    assert len(frame_times(loop, 3.0)) == round(3 * loop.duration_s)  # without its start a second time


def training_cameras(names: list[str | None]) -> list[Any]:
    """Rows of the file that 3DGS writes; 7 units apart along x."""
    rest = {"width": 600, "height": 400, "rotation": AHEAD.tolist(), "fx": 400.0, "fy": 400.0}
    return [
        {"position": [7.0 * k, 0, 0], **rest, **({} if name is None else {"img_name": name})}
        for k, name in enumerate(names)
    ]


def test_axes_of_nerfstudio_are_those_of_opengl(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = AHEAD, [1, 2, 3]
    key = {"camera_to_world": (pose @ np.diag([1.0, -1, -1, 1])).ravel().tolist(), "fov": 50.0, "aspect": 1.5}
    for values in ({"seconds": 4}, {}):
        (tmp_path / "a.json").write_text(json.dumps({**values, "camera_path": [key] * 2}))
        found = read_camera_path(tmp_path / "a.json")
        assert found.is_timed == bool(values)
        same_view(found.camera(0.0, 600, 400), Camera.from_fov(600, 400, 50.0, np.linalg.inv(pose)))


OPENGL = np.diag([1.0, -1, -1, 1])


def viewer_keys(count: int = 3, **more: Any) -> tuple[list[Camera], list[dict[str, Any]]]:
    """Cameras, and the keyframes that nerfstudio's viewer saves for them."""
    path = path_of(count)
    cameras = [path.camera(t, 600, 400) for t in path.times_s.tolist()]
    matrices = [(camera.camera_to_world @ OPENGL).ravel().tolist() for camera in cameras]
    return cameras, [
        {"matrix": matrix, "fov": camera.vertical_fov_deg, "aspect": 1.5, **more}
        for camera, matrix in zip(cameras, matrices, strict=True)
    ]


def test_keyframes_of_nerfstudios_viewer_are_a_path(tmp_path: Path) -> None:
    cameras, keys = viewer_keys(override_transition_sec=None)
    keys[1]["override_transition_sec"] = 5.0
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"keyframes": keys, "camera_path": [], "default_transition_sec": 2.0}))
    path = read_camera_path(file)
    assert path.times_s.tolist() == [0, 2, 7] and path.is_timed
    for time_s, camera in zip(path.times_s.tolist(), cameras, strict=True):
        same_view(path.camera(time_s, 600, 400), camera)
    for key in keys:  # as text, column by column, in files of 2022
        key["matrix"] = json.dumps(np.array(key["matrix"]).reshape(4, 4).T.ravel().tolist())
        del key["override_transition_sec"]
    file.write_text(json.dumps({"keyframes": keys, "seconds": 6, "is_cycle": True}))
    path = read_camera_path(file)
    assert path.times_s.tolist() == [0, 3, 6] and path.loop
    for time_s, camera in zip(path.times_s.tolist(), cameras, strict=True):
        same_view(path.camera(time_s, 600, 400), camera)


@pytest.mark.parametrize("form", ["focal length", "of each frame", "angles", "one angle"])
def test_the_frames_of_a_transforms_json_are_a_path(form: str, tmp_path: Path) -> None:
    path = path_of(3)
    size = (400, 400) if form == "one angle" else (600, 400)
    cameras = [replace(path, vertical_fov_deg=np.full(3, 50.0)).camera(t, *size) for t in path.times_s.tolist()]
    names = ["images/frame_2.png", "images/frame_10.png", "images/frame_1.png"]
    frames = [
        {"file_path": name, "transform_matrix": (camera.camera_to_world @ OPENGL).tolist()}
        for name, camera in zip(names, cameras, strict=True)
    ]
    camera = cameras[0]
    inner: dict[str, Any] = {"fl_x": camera.fx, "fl_y": camera.fy, "w": 600, "h": 400, "camera_model": "OPENCV"}
    values: dict[str, Any] = {
        "focal length": inner,
        "of each frame": {"fl_y": 1.0},
        "angles": {"camera_angle_x": 2 * np.arctan(300 / camera.fx), "w": 600, "h": 400},
        "one angle": {"camera_angle_x": np.radians(50.0)},
    }[form]
    if form == "of each frame":
        frames = [frame | inner for frame in frames]
    text = json.dumps({**values, "frames": frames})
    (tmp_path / "transforms.json").write_text("\ufeff" + text, encoding="utf-8")  # with a byte-order mark
    found = read_camera_path(tmp_path / "transforms.json")
    assert not found.is_timed
    for time_s, number in zip(found.times_s.tolist(), [2, 0, 1], strict=True):
        same_view(found.camera(time_s, *size), cameras[number])


@pytest.mark.parametrize("name", ["camera_type", "camera_model"])
@pytest.mark.parametrize("kind", ["equirectangular", "EQUIRECTANGULAR", "fisheye", "OPENCV_FISHEYE", "omnidirectional"])
def test_paths_of_cameras_without_perspective_are_refused(name: str, kind: str, tmp_path: Path) -> None:
    keys = viewer_keys()[1]
    rows = {
        "camera_type": {"camera_path": [{"camera_to_world": key["matrix"], "fov": 50.0} for key in keys], "seconds": 2},
        "camera_model": {"frames": [{"transform_matrix": np.eye(4).tolist()}], "camera_angle_x": 1.0},
    }[name]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    assert read_camera_path(tmp_path / "a.json")
    (tmp_path / "a.json").write_text(json.dumps({name: kind, **rows}))
    with pytest.raises(SceneFormatError, match=rf"a\.json: .*{name} '{kind}'"):
        read_camera_path(tmp_path / "a.json")


def test_cameras_of_others_are_relative_to_the_origin_of_the_scene(tmp_path: Path) -> None:
    scene = replace(small_scene(), origin=(447_613.0, 5_411_938.0, 212.0))
    path, origin = path_of(3), np.array(scene.origin)
    far = replace(path, positions=path.positions + origin)
    write_nerfstudio_path(tmp_path / "a.json", far, 1.0)
    write_training_cameras(tmp_path / "b.json", far, 1.0)
    write_camera_path(tmp_path / "own.json", path)
    for file in ("a.json", "b.json", "own.json"):
        found = read_camera_path(tmp_path / file, scene)
        np.testing.assert_allclose(found.positions[0], path.positions[0], atol=1e-6, err_msg=file)


def write_gltf_camera(path: Path, interpolation: str = "LINEAR", uri: str = "") -> tuple[np.ndarray, Rotation]:
    """A camera that turns on a node that moves, at three moments; returns its places and rotations there."""
    places = np.array([[0, 1, 5], [1, 2, 4], [4, 2, 4]], "<f4")
    turns = Rotation.from_euler("YX", [[0, -20], [30, 0], [50, 10]], degrees=True)
    columns = np.array([0, 0.5, 2], "<f4"), places, turns.as_quat().astype("<f4")
    ends = np.cumsum([0, *(column.nbytes for column in columns)]).tolist()
    document = {
        "nodes": [{"children": [1], "translation": [9, 9, 9]}, {"camera": 0}, {"camera": 0}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "animations": [{
            "channels": [{"sampler": k, "target": {"node": k, "path": ("translation", "rotation")[k]}} for k in (0, 1)],
            "samplers": [{"input": 0, "output": k + 1, "interpolation": interpolation} for k in (0, 1)],
        }],
        "accessors": [
            {"bufferView": k, "componentType": 5126, "count": 3, "type": kind}
            for k, kind in enumerate(("SCALAR", "VEC3", "VEC4"))
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": ends[k], "byteLength": column.nbytes} for k, column in enumerate(columns)
        ],
        "buffers": [{"byteLength": ends[-1]}],
    }  # fmt: skip
    binary = b"".join(column.tobytes() for column in columns)
    if uri:
        (path.parent / "of it.bin").write_bytes(binary)
        document["buffers"][0]["uri"] = uri.format(base64.b64encode(binary).decode())
        path.write_text(json.dumps(document))
        return places, turns
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return places, turns


def test_a_camera_of_gltf_is_where_the_glb_of_its_scene_has_it(tmp_path: Path) -> None:
    places, turns = write_gltf_camera(tmp_path / "a.glb")
    scene = replace(small_scene(), up=(1.0, 0.0, 0.0), metres_per_unit=2.5)
    write_scene(scene, tmp_path / "scene.glb")
    (layer,) = read_scene(tmp_path / "scene.glb").layers
    parts = [part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in scene.parts()]
    in_world = read_camera_path(tmp_path / "a.glb", scene).moved(scene.scene_to_world)
    in_file = read_camera_path(tmp_path / "a.glb")
    for row, time_s in enumerate((0.0, 0.5, 2.0)):
        local = turns[row].inv().apply(layer.gaussians.means * [-1, -1, 1] - places[row])  # glTF: y up, z back
        for path, points in ((in_world, np.concatenate(parts)), (in_file, layer.gaussians.means)):
            camera = path.camera(time_s, 480, 320)
            found = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            np.testing.assert_allclose(found, local * [1, -1, -1], atol=2e-4)
            np.testing.assert_allclose(np.radians(camera.vertical_fov_deg), 0.7)
    for uri in ("of%20it.bin", "data:application/octet-stream;base64,{}"):
        write_gltf_camera(tmp_path / "a.gltf", uri=uri)
        np.testing.assert_array_equal(read_camera_path(tmp_path / "a.gltf").positions, in_file.positions)
    write_gltf_camera(tmp_path / "b.glb", "CUBICSPLINE")
    for name, uri in (("c", "../of%20it.bin"), ("e", "none.bin"), ("f", "data:,{}!"), ("g", "a%00b"), ("h", "a\0/b"),
                      ("i", "data:,雨")):  # fmt: skip
        write_gltf_camera(tmp_path / f"{name}.gltf", uri=uri)
    problems = {"b.glb": "CUBICSPLINE", "scene.glb": "no camera", "d.glb": "No such file", "c.gltf": "next to it",
                "e.gltf": "can't be read: No such file", "f.gltf": "no base64", "g.gltf": "next to it",
                "h.gltf": "next to it", "i.gltf": "no base64"}  # fmt: skip
    for file, problem in problems.items():
        with pytest.raises(SceneFormatError, match=problem):
            read_camera_path(tmp_path / file)


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["frame_9", "frame_1", "frame_10", "frame_2"], [1, 3, 0, 2]),  # those for testing stand first
        (["b", "a", "b", "c"], [0, 1, 2, 3]),
        ([None, "a", "b", "c"], [0, 1, 2, 3]),
    ],
)
def test_training_cameras_are_flown_in_the_order_of_their_names(
    tmp_path: Path, names: list[str | None], order: list[int]
) -> None:
    (tmp_path / "cameras.json").write_text(json.dumps(training_cameras(names)))
    path = read_camera_path(tmp_path / "cameras.json")
    assert (path.positions[:, 0] / 7).tolist() == order
    assert np.diff(path.times_s) == pytest.approx(7 * np.abs(np.diff(order)) / WALKING_M_S)


KEY = {"time_s": 0, "position": [0, 0, 0], "quaternion_wxyz": [1, 0, 0, 0], "vertical_fov_deg": 40}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("nothing", "JSON"),
        ([], "keyframes"),
        ({}, "keyframes"),
        ({"version": 4, "keyframes": []}, "newer than 3"),
        ({"keyframes": []}, "keyframe"),
        ({"keyframes": [{"time_s": 0}]}, "'position'"),
        ({"keyframes": [KEY | {"vertical_fov_deg": 180}]}, "field of view"),
        ({"keyframes": [KEY | {"quaternion_wxyz": [0, 0, 0, 0]}]}, "quaternion"),
        ({"keyframes": [KEY], "interpolation": "cubic"}, "interpolation 'cubic'"),
        ({"keyframes": [KEY], "easing": "bounce"}, "easing 'bounce'"),
        ({"keyframes": [], "camera_path": []}, "keyframe"),
        ({"frames": [{"file_path": "a.png"}]}, "'transform_matrix'"),
        ({"frames": [{"transform_matrix": np.diag([1, 1, -1, 1]).tolist()}], "camera_angle_x": 1}, "keyframe 0"),
        ({"camera_path": [{"camera_to_world": [*[0] * 15, 1], "fov": 50}]}, "keyframe 0"),
        ({"frames": [{"transform_matrix": [[1, 0], [0, 1]]}], "camera_angle_x": 1}, "transform_matrix"),
        ({"frames": [{"transform_matrix": np.eye(4).tolist()}]}, "'camera_angle_x'"),
    ],
)
def test_bad_paths_are_named(tmp_path: Path, text: Any, field: str) -> None:
    file = tmp_path / "path.json"
    file.write_text(text if isinstance(text, str) else json.dumps(text))
    with pytest.raises(SceneFormatError, match=rf"path\.json: .*{field}"):
        read_camera_path(file)
    with pytest.raises(SceneFormatError, match="No such file"):
        read_camera_path(tmp_path / "nowhere.json")

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath, circle_path, orbit_path
from gsrain_engine.scene.camera_path_io import read_camera_path, write_camera_path
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.rig import rig_camera_path
from gsrain_engine.scene.scene import PoseTrack, RigCamera, Scene

LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # a camera that looks along +x, z up


def straight(speed=10.0, keys=5):
    times = np.arange(keys, dtype=float)
    quaternion = Rotation.from_matrix(LEVEL).as_quat()[[3, 0, 1, 2]]
    positions = np.stack([speed * times, np.zeros(keys), np.full(keys, 1.5)], axis=1)
    return CameraPath(times, positions, np.tile(quaternion, (keys, 1)), np.full(keys, 40.0))


def test_straight_keys_give_constant_speed():
    path = straight()
    for t in (0.0, 0.3, 2.5, 4.0):
        camera = path.camera(t, 96, 64)
        assert camera.position == pytest.approx([10 * t, 0, 1.5])
        assert camera.world_to_camera[2, :3] == pytest.approx([1, 0, 0])
        assert camera.vertical_fov_deg == pytest.approx(40)
        assert path.velocity(t) == pytest.approx([10, 0, 0])
    assert path.velocity(4.5) == pytest.approx([0, 0, 0])
    assert path.camera(9.0, 96, 64).position == pytest.approx([40, 0, 1.5])


def test_path_goes_through_its_keys():
    rng = np.random.default_rng(2)
    turns = Rotation.random(6, random_state=4)
    path = CameraPath(
        np.cumsum(rng.uniform(0.5, 2, 6)), rng.normal(0, 5, (6, 3)), turns.as_quat()[:, [3, 0, 1, 2]],
        rng.uniform(30, 60, 6),
    )  # fmt: skip
    for k, t in enumerate(path.times_s):
        camera = path.camera(t, 90, 60)
        assert camera.position == pytest.approx(path.positions[k], abs=1e-9)
        assert np.allclose(camera.camera_to_world[:3, :3], turns[k].as_matrix(), atol=1e-9)
        assert camera.vertical_fov_deg == pytest.approx(path.vertical_fov_deg[k])


def test_a_path_flies_through_cameras():
    up = np.array([0.0, 0, 1])
    eyes = np.array([[0.0, 0, 2], [5, 1, 3], [9, -2, 8]])
    cameras = [Camera.from_fov(90, 60, fov, look_at(eye, np.array([30.0, 0, 0]), up))
               for eye, fov in zip(eyes, (30, 40, 50), strict=True)]  # fmt: skip
    path = CameraPath.through([1.0, 2.5, 3.0], [replace(cameras[0], exposure_s=0.02), *cameras[1:]])
    assert (path.start_s, path.end_s, path.exposure_s) == (1.0, 3.0, 0.02)
    for t, camera in zip((1.0, 2.5, 3.0), cameras, strict=True):
        found = path.camera(t, 90, 60)
        assert np.allclose(found.world_to_camera, camera.world_to_camera, atol=1e-9)
        assert found.fy == pytest.approx(camera.fy)


@pytest.mark.parametrize(("times", "cameras", "reason"),
                         [([], 0, "at least one"), ([0.0], 2, "1 for 2"), ([1.0, 1.0], 2, "rising")])  # fmt: skip
def test_cameras_without_rising_moments_are_refused(times, cameras, reason):
    with pytest.raises(ValueError, match=reason):
        CameraPath.through(times, [Camera.from_fov(90, 60, 40.0, np.eye(4))] * cameras)


def test_velocity_is_the_derivative_of_the_position():
    path = straight()
    bent = CameraPath(
        path.times_s, path.positions + np.sin(path.times_s)[:, None], path.quaternions_wxyz, path.vertical_fov_deg
    )
    h = 1e-6
    difference = (bent.camera(1.7 + h, 9, 6).position - bent.camera(1.7 - h, 9, 6).position) / (2 * h)
    assert bent.velocity(1.7) == pytest.approx(difference, rel=1e-5)


def test_own_file_comes_back(tmp_path):
    file = tmp_path / "path.json"
    write_camera_path(file, straight())
    again = read_camera_path(file)
    assert np.array_equal(again.positions, straight().positions)
    assert np.allclose(again.quaternions_wxyz, straight().quaternions_wxyz, atol=1e-15)


def test_nerfstudio_and_3dgs_files_show_the_same_flight(tmp_path):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = LEVEL, [1, 2, 3]
    gl = pose.copy()
    gl[:3, :3] = pose[:3, :3] @ np.diag([1, -1, -1])
    nerfstudio = tmp_path / "camera_path.json"
    nerfstudio.write_text(json.dumps({"seconds": 4, "camera_path": [
        {"camera_to_world": gl.ravel().tolist(), "fov": 50.0, "aspect": 1.5}] * 2}))  # fmt: skip
    fy = 0.5 * 400 / np.tan(np.radians(25))
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps([{"id": 0, "img_name": "a", "width": 600, "height": 400, "position": [1, 2, 3],
                                    "rotation": LEVEL.tolist(), "fx": fy, "fy": fy}]))  # fmt: skip
    for file in (nerfstudio, cameras):
        camera = read_camera_path(file).camera(0.0, 600, 400)
        assert np.allclose(camera.camera_to_world, pose, atol=1e-12)
        assert camera.vertical_fov_deg == pytest.approx(50)
    assert read_camera_path(nerfstudio).duration_s == 4


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["frame_9", "frame_1", "frame_10", "frame_2"], [1, 3, 0, 2]),  # those for testing stand first
        (["b", "a", "b", "c"], [0, 1, 2, 3]),
        ([None, "a", "b", "c"], [0, 1, 2, 3]),
    ],
)
def test_training_cameras_are_flown_in_the_order_of_their_names(tmp_path, names, order):
    values = [{"width": 600, "height": 400, "position": [k, 0, 0], "rotation": LEVEL.tolist(), "fx": 400, "fy": 400}
              | ({} if name is None else {"img_name": name}) for k, name in enumerate(names)]  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps(values))
    assert read_camera_path(tmp_path / "cameras.json").positions[:, 0].tolist() == order


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "expected keyframes"),
        ("{}", "expected keyframes"),
        ("nothing", "not a JSON file"),
        ('{"version": 3, "keyframes": []}', "newer than 2"),
        ('{"keyframes": []}', "at least one keyframe"),
        ('{"keyframes": [{"time_s": 0}]}', "no field 'position'"),
        ('{"keyframes": [{"time_s": 0, "position": [0, 0, 0], "quaternion_wxyz": [1, 0, 0, 0], '
         '"vertical_fov_deg": 180}]}', "below 180"),
        ('{"keyframes": [{"time_s": 0, "position": [0, 0, 0], "quaternion_wxyz": [0, 0, 0, 0], '
         '"vertical_fov_deg": 40}]}', "its quaternion must be finite and not 0"),
    ],
)  # fmt: skip
def test_bad_paths_say_what_is_wrong(tmp_path, text, words):
    file = tmp_path / "path.json"
    file.write_text(text)
    with pytest.raises(SceneFormatError) as error:
        read_camera_path(file)
    assert words in str(error.value)


def test_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(SceneFormatError, match="No such file"):
        read_camera_path(tmp_path / "nowhere.json")


def test_moving_a_path_moves_its_cameras():
    similarity = np.array([[0, 0, 2.0, 5], [-2.0, 0, 0, 6], [0, -2.0, 0, 7], [0, 0, 0, 1]])
    path = straight()
    there = path.moved(similarity).camera(1.3, 96, 64)
    assert np.allclose(there.world_to_camera, path.camera(1.3, 96, 64).moved(similarity).world_to_camera, atol=1e-12)


def test_drive_path_rides_with_the_ego():
    times = np.arange(3.0)
    ego = PoseTrack(times, np.stack([5 * times, np.zeros(3), np.full(3, 1.5)], axis=1), np.tile([1.0, 0, 0, 0], (3, 1)),
                np.ones(3, bool))  # fmt: skip
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = LEVEL, [1.0, 0, 0.5]
    front = RigCamera("FRONT", 1920, 1280, 2060.0, 2060.0, 960.0, 640.0, mount, 0.003)
    path = rig_camera_path(Scene("s", ego=ego, rigs={"r": (front,)}), front, 960, 640)
    camera = path.camera(1.0, 960, 640)
    assert camera.position == pytest.approx([6, 0, 2.0])
    assert camera.fx == pytest.approx(1030)
    assert camera.exposure_s == 0.003
    assert path.velocity(1.0) == pytest.approx([5, 0, 0])
    with pytest.raises(ValueError, match="no ego track"):
        rig_camera_path(Scene("s"), front, 960, 640)


def test_orbit_keeps_its_distance_and_its_sight():
    start = Camera.from_fov(96, 64, 50.0, look_at(np.array([10.0, 0, 2]), np.zeros(3), np.array([0.0, 0, 1])))
    path = orbit_path(np.zeros(3), start, 4.0, 60.0)
    middle = path.camera(2.0, 96, 64)
    assert np.allclose(middle.world_to_camera, start.world_to_camera, atol=1e-9)
    for t in (0.0, 1.0, 3.7):
        camera = path.camera(t, 96, 64)
        assert np.linalg.norm(camera.position) == pytest.approx(np.hypot(10, 2), rel=1e-3)
        assert camera.world_to_camera[:3, 3][:2] == pytest.approx([0, 0], abs=0.02)


def test_a_circle_closes_and_keeps_its_distance():
    start = Camera.from_fov(96, 64, 50.0, look_at(np.array([10.0, 0, 2]), np.zeros(3), np.array([0.0, 0, 1])))
    path = circle_path(np.zeros(3), start, 8.0)
    assert path.duration_s == 8
    assert np.allclose(path.camera(0.0, 96, 64).world_to_camera, start.world_to_camera, atol=1e-9)
    opposite = path.camera(4.0, 96, 64)
    assert opposite.position == pytest.approx([-10, 0, 2], abs=1e-9)
    for t in np.linspace(0, 16, 33).tolist():
        camera = path.camera(t, 96, 64)
        assert np.linalg.norm(camera.position[:2]) == pytest.approx(10, rel=1e-3)
        assert camera.world_to_camera[:2, 3] == pytest.approx([0, 0], abs=0.02)
        assert np.linalg.norm(path.velocity(t)) == pytest.approx(2 * np.pi * 10 / 8, rel=0.01)

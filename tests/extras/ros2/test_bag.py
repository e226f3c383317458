"""Roll-outs as bags of ROS 2: read by rosbags, and as a capture by our own reader."""

import sys
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, LidarSweep
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.lidar.scan import RainyScan, ReturnOutcome, capture_turns, scan_in_rain, scene_turns
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import load_scene
from gsrain_engine.simulation.lidar_turns import LidarTurnInRain, rollout_lidar_turns
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.rollout import CameraImage
from gsrain_extras.ros2.bag import write_rollout_bag
from small_rollout import approach, ego, rollout
from small_rollout import step as small_step

rosbags = pytest.importorskip("rosbags.highlevel")


def pictures(run):
    for step in run.steps:
        to_camera = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.4], [1, 0, 0, -step.ego.x_m - 1.5], [0, 0, 0, 1]])
        image = np.full((40, 60, 3), 10 * step.step, np.uint8)
        yield CameraImage(step.step, "FRONT", image, Camera(60, 40, 50.0, 50.0, 30.0, 20.0, to_camera))


def turns(run):
    for step in run.steps:
        pose = np.eye(4)
        pose[:3, 3] = (step.ego.x_m, 0.0, 1.9)
        x, y = np.meshgrid(np.linspace(-9, 9, 25), np.linspace(-3, 3, 17))
        points = np.stack([x.ravel() + step.ego.x_m, y.ravel(), 0 * x.ravel()], axis=1).astype(np.float32)
        count = len(points)
        sweep = LidarSweep(step.time_s, points, pose[:3, 3], np.full(count, 0.2, np.float32))
        scan = RainyScan(sweep, np.arange(count), np.zeros(count, bool), np.ones(count, np.int8), np.full(count, 100.0))
        yield LidarTurnInRain(step.step, scan, pose)


def messages(folder):
    found = {}
    with rosbags.AnyReader([folder]) as reader:
        for connection, time, data in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return found


def test_rosbags_reads_poses_images_lidar_and_labels(tmp_path):
    run = approach(moments=6, lead_x=60.0)
    write_rollout_bag(tmp_path / "run.ros2", run, pictures(run), turns(run))
    found = messages(tmp_path / "run.ros2")
    assert set(found) == {"/tf", "/tf_static", "/odom", "/labels", "/labels/markers", "/lidar/points",
                          "/camera/FRONT/image/compressed", "/camera/FRONT/camera_info"}  # fmt: skip
    assert [time for time, _ in found["/odom"]] == [250_000_000 * k for k in range(6)]
    odometry = found["/odom"][4][1]
    assert odometry.pose.pose.position.x == 10.0 and odometry.twist.twist.linear.x == 10.0
    (label,) = found["/labels"][0][1].detections
    assert (label.id, label.results[0].hypothesis.class_id, label.bbox.center.position.x) == ("lead", "car", 60.0)
    assert (label.bbox.size.x, label.bbox.center.position.z) == (4.0, 0.75)
    assert [each.action for each in found["/labels/markers"][0][1].markers] == [3, 0]
    points = np.frombuffer(found["/lidar/points"][2][1].data.tobytes(), np.float32).reshape(-1, 4)
    np.testing.assert_allclose(points[0], [-9, -3, -1.9, 0.2], atol=1e-5)  # of the sensor, and a reflectance


def test_a_bag_opens_as_a_capture_and_has_the_same_bytes_again(tmp_path):
    run = approach(moments=4, lead_x=60.0)
    for name in ("a", "b", "a"):  # the second time over the first
        write_rollout_bag(tmp_path / name / "run.ros2", run, pictures(run), turns(run))
    first, second = ({each.name: each.read_bytes() for each in (tmp_path / n / "run.ros2").iterdir()} for n in "ab")
    assert first == second
    capture = open_capture(tmp_path / "a" / "run.ros2")
    assert not capture.problems and capture.sensors == ("camera_FRONT",) and len(capture) == len(capture.sweeps) == 4
    np.testing.assert_allclose(capture.ego.positions[:, 0], [0, 2.5, 5, 7.5], atol=1e-6)
    np.testing.assert_allclose(capture[2].camera.position - capture[0].camera.position, [5, 0, 0], atol=1e-6)
    np.testing.assert_allclose([capture[0].camera.cx, capture[0].camera.cy], [30, 20])
    assert abs(int(capture[3].image.mean()) - 30) < 2
    assert abs(np.median(capture.sweeps[0].points_m[:, 2]) + 1.5) < 1e-3  # the road, below the ego
    (box,) = capture.boxes
    assert (box.id, box.class_name, box.size_lwh) == ("lead", "car", (4.0, 2.0, 1.5))
    np.testing.assert_allclose(box.track.pose(capture[3].time_s)[:3, 3], [60.0, 0.0, -1.5], atol=1e-6)


class Standing(RolloutPlayback):
    """Playback in which a scene stays as it is, with its rig at one place."""

    def __init__(self, run, scene, rig):
        self.rollout, self.base, self.rig_pose = run, scene, rig
        self.scenario = SimpleNamespace(rain=RainSettings(intensity_mm_h=0.0))

    def scene(self, time_s):
        return self.base

    def rig_to_world(self, time_s):
        return self.rig_pose

    def scene_time_s(self, time_s):
        return time_s


@pytest.mark.street
def test_the_lidar_of_the_street_and_of_its_bag_lose_the_same_returns_in_rain(tmp_path):
    scene, sensor, bins = load_scene("street"), SENSORS["64"], [2, 5, 10, 20, 30, 50, 80, 120]
    dry, rain = (RainSimulation.start(RainSettings(intensity_mm_h=each)) for each in (0.0, 12.0))
    rig = scene.ego_to_world(0.0)
    own = msgspec.structs.replace(ego(rig[0, 3], rig[1, 3]), z_m=float(rig[2, 3]) - EGO_HEIGHT_M)
    played = Standing(rollout([small_step(0, own)]), scene, rig)
    image = CameraImage(0, "FRONT", np.zeros((40, 60, 3), np.uint8), Camera(60, 40, 50.0, 50.0, 30.0, 20.0, np.eye(4)))
    write_rollout_bag(tmp_path / "run.ros2", played.rollout, [image], rollout_lidar_turns(played, sensor))
    capture = open_capture(tmp_path / "run.ros2")
    assert 0 < capture.sweeps[0].intensities.min() < capture.sweeps[0].intensities.max() <= 0.2
    counts = []
    for turn in (*scene_turns(scene, sensor, [0.0]), *capture_turns(capture, sensor)):
        assert len(scan_in_rain(turn.beams, turn.sensor, dry, turn.anchor_to_world).false_ranges_m) == 0
        fates = scan_in_rain(turn.beams, turn.sensor, rain, turn.anchor_to_world).fates
        ranges, is_kept = turn.beams.ranges_m, fates == ReturnOutcome.KEPT
        counts.append([np.histogram(ranges[mask], bins)[0] for mask in (turn.beams.is_echo, is_kept)])
    (clear, kept), (clear_again, kept_again) = counts
    np.testing.assert_array_equal(clear_again, clear)
    assert clear.min() > 60 and 0.85 < kept[-2] / clear[-2] < 0.95
    share = kept / clear
    assert (np.abs(kept_again - kept) <= 1 + np.sqrt(clear * share * (1 - share))).all(), (kept, kept_again)


def test_a_picture_without_a_step_is_refused_and_nothing_is_left(tmp_path):
    run = approach(moments=3, lead_x=60.0)
    lost = next(pictures(run))._replace(step=99)
    with pytest.raises(ValueError, match="picture of step 99: expected one of 0..2"):
        write_rollout_bag(tmp_path / "run.ros2", run, [lost])
    assert not (tmp_path / "run.ros2").exists()


def test_without_its_package_nothing_is_driven(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert run(["drive", "--export", "ros2", "-o", str(tmp_path / "out")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gsrain: --export ros2 needs rosbags, which is not installed: ")
    assert line.endswith("'gsrain[recordings]'") and not list(tmp_path.iterdir())

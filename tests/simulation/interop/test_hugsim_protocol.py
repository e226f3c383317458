"""HUGSIM's protocol: its frames, messages and rig by hand and by its simulator's formulas, and the two named pipes."""

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.rigs import driving_rigs
from gsrain_engine.simulation.agents.base import Observation, Rig
from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.interop import hugsim_protocol as protocol
from gsrain_engine.simulation.interop.hugsim_agent import to_vehicle_frame
from gsrain_engine.simulation.traffic.base import RoadUser
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE, Vehicle, VehicleState
from simulation.small_drive import longer_scene, scenario

angles, meters = st.floats(-3, 3), st.floats(-50, 50)
ROUTE = Route(np.array([[0.0, 0.0], [100.0, 0.0]]))
NUSCENES = driving_rigs()["nuscenes"]
HUGSIM_RIG = Rig(HUGSIM_VEHICLE, protocol.hugsim_rig(NUSCENES), 1.5)
OWN_RIG = Rig(Vehicle(), NUSCENES, 1.5)
SIX = protocol.six_hugsim_cameras(HUGSIM_RIG.cameras)


def at(x=0.0, y=0.0, yaw=0.0, height=0.0, command="straight", users=()):
    state = VehicleState(x, y, yaw, 7.0, 0.1)
    return Observation(3, 0.75, state, -1.5, 0.3, height, command, {}, ROUTE, tuple(users))


# World


def test_boxes_have_hugsims_order_and_reference_points():
    world = protocol.HugsimWorld.from_observation(HUGSIM_RIG, at())
    np.testing.assert_allclose(world.ego_box(HUGSIM_RIG, at(6, 2, 0.25)), (6, 2, 0, 1.6, 3.0, 1.5, 0.25), atol=1e-12)
    lead = RoadUser("lead", "car", (4.6, 1.8, 1.4), 20.0, 1.0, 0.3, 0.0, 0.0)
    np.testing.assert_allclose(world.object_box(lead), (20, 1, -1.51, 1.8, 4.6, 1.4, 0.3), atol=1e-9)
    own = protocol.HugsimWorld.from_observation(OWN_RIG, at())
    # The camera was at x 1.70, y 0.02; the body's middle is 1.3 m ahead of the axle.
    expected = (6 + 1.3 - 1.7, -0.02, 0, 1.85, 4.6, 1.5, 0)
    np.testing.assert_allclose(own.ego_box(OWN_RIG, at(6, 0)), expected, atol=1e-9)
    np.testing.assert_allclose(own.ego_place(OWN_RIG, at(6, 0)), (0, 0, 6), atol=1e-12)


@given(x=meters, y=meters, yaw=angles, turn=angles, far=meters, aside=meters)
def test_a_box_lies_where_the_ego_box_sees_it(x, y, yaw, turn, far, aside):
    """Whatever the world's axes are: difference of two boxes, turned by the ego's yaw, is what our own frame says."""
    observation = at(x, y, yaw)
    place = observation.state.to_world(np.array([[far, aside]]))[0]
    world = protocol.HugsimWorld.from_observation(HUGSIM_RIG, at(3.0, -2.0, 1.0))
    ego = world.ego_box(HUGSIM_RIG, observation)
    box = world.object_box(RoadUser("a", "car", (4, 2, 1), float(place[0]), float(place[1]), yaw + turn))
    away, cosine, sine = np.array(box[:2]) - ego[:2], np.cos(ego[6]), np.sin(ego[6])
    local = cosine * away[0] + sine * away[1], cosine * away[1] - sine * away[0]
    np.testing.assert_allclose(local, (far, aside), atol=1e-9)
    assert protocol.wrap_to_pi(box[6] - ego[6] - turn) == pytest.approx(0, abs=1e-9)
    assert -1.5 * np.pi - 1e-9 <= box[6] <= 0.5 * np.pi + 1e-9  # from the models' yaw


# Messages


def test_info_has_hugsims_names_and_signs():
    user = RoadUser("a", "car", (4.0, 2.0, 1.5), 20.0, 0.0, 0.0)
    for number, command in enumerate(("right", "left", "straight")):
        observation = at(4.0, 0.5, -0.2, command=command, users=[user])
        world = protocol.HugsimWorld(0.0, 0.0, 1.51, 0.0)
        info = protocol.hugsim_info(observation, HUGSIM_RIG, world, {})
        assert info.pop("command") == number  # as stacks were trained
    np.testing.assert_allclose(info.pop("ego_pos"), (-0.5, 0, 4), atol=1e-12)  # 0.5 m left is -0.5 to the right
    np.testing.assert_allclose(info.pop("ego_rot"), (0, 0.2, 0))  # right positive
    assert [len(box) for box in (info.pop("ego_box"), *info.pop("obj_boxes"))] == [7, 7]
    assert info.pop("rc") == pytest.approx(4 / 90)
    assert info == {"ego_velo": 7.0, "ego_steer": -0.1, "accelerate": -1.5, "steer_rate": -0.3, "timestamp": 0.75,
                    "cam_params": {}, "collision": False}  # fmt: skip


def test_camera_parameters_are_nuscenes():
    params = protocol.camera_params(SIX, HUGSIM_RIG)
    for name, camera in SIX.items():
        inner = params[name]["intrinsic"]
        assert list(inner) == ["H", "W", "cx", "cy", "fovx", "fovy"] and (inner["H"], inner["W"]) == (450, 800)
        focal = 800 / (2 * np.tan(inner["fovx"] / 2)), 450 / (2 * np.tan(inner["fovy"] / 2))
        assert focal == pytest.approx((camera.fx, camera.fy)) and 0 < inner["fovy"] < inner["fovx"] < np.pi
    front = params["CAM_FRONT"]
    # 10 m ahead of the lidar at its height: 0.33 m above the camera, 10 - 0.76 m before it.
    np.testing.assert_allclose(front["l2c"] @ (0, 10, 0, 1), (0.02, -0.33, 9.24, 1), atol=1e-9)
    np.testing.assert_allclose(front["l2c"] @ (2, 0, 0, 1), (2.02, -0.33, -0.76, 1), atol=1e-9)
    np.testing.assert_allclose(front["v2c"] @ (10, 3, 0, 1), (-3, 1.51, 10, 1), atol=1e-9)
    assert (params["CAM_BACK"]["l2c"] @ (0, -10, 0, 1))[2] > 8


# Rig


def test_nuscenes_rig_is_halved_and_moved_back_and_missing_cameras_are_known():
    rig = HUGSIM_RIG.cameras
    assert tuple(each.name for each in rig) == protocol.CAMERA_NAMES
    assert {(each.width, each.height) for each in rig} == {(800, 450)}
    before = {each.name: each for each in NUSCENES}
    six = protocol.six_hugsim_cameras(tuple(each for each in rig if each.name in ("CAM_FRONT", "CAM_BACK")))
    for each in rig:
        was = before[each.name]
        assert (each.fx, each.cx, each.cy) == (was.fx / 2, was.cx / 2, was.cy / 2)
        np.testing.assert_allclose((each.camera_to_ego - was.camera_to_ego)[:3, 3], (-1.7, -0.02, 0))
        np.testing.assert_allclose(six[each.name].camera_to_ego, each.camera_to_ego, atol=1e-12)


def test_the_rig_is_the_named_one_or_has_the_largest_share_of_the_six_cameras():
    scene = replace(longer_scene(), rigs={name: driving_rigs()[name] for name in ("waymo_front3", "nuscenes")})
    for name, count in ((None, 6), ("waymo_front3", 3)):
        changed, given = protocol.with_hugsim_rig(scenario(rig=name), scene)
        assert (changed.vehicle, changed.rig, changed.picture_width_px) == (HUGSIM_VEHICLE, "hugsim", 800)
        assert len(given.rigs["hugsim"]) == count and set(given.rigs) == {*scene.rigs, "hugsim"}
    for name, rigs, word in (("other", scene.rigs, "'other'"), (None, {}, "CAM_FRONT")):
        with pytest.raises(ValueError, match=word):
            protocol.with_hugsim_rig(scenario(rig=name), replace(scene, rigs=rigs))
    for cameras, word in ((NUSCENES, "1600 x 900"), (HUGSIM_RIG.cameras[1:], "CAM_FRONT")):
        with pytest.raises(ValueError, match=word):
            protocol.six_hugsim_cameras(cameras)


# Plans


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-1, 8)), min_size=1, max_size=8))
def test_the_front_always_stays_as_far_ahead(steps):
    """The axle moves along its heading: the tractrix of the front."""
    front = np.cumsum(np.array(steps), axis=0)
    np.testing.assert_allclose(to_vehicle_frame(front, (0.0, 0.0)), front[:, ::-1] * (1, -1))  # right, forward
    arms = np.array([1.7, 0.3]) + front[:, ::-1] * (1, -1) - to_vehicle_frame(front, (1.7, 0.3))
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), np.hypot(1.7, 0.3), rtol=1e-9)


# Pipes


def test_pipes_are_waited_for_only_so_long_and_other_files_are_not_used(tmp_path):
    os.mkfifo(tmp_path / "plan_pipe")  # the client came first
    pipes = protocol.Pipes(tmp_path)
    calls = {
        "obs_pipe": lambda *timeouts: pipes.send(b"", protocol.Timeouts(*timeouts)),
        "plan_pipe": lambda *timeouts: pipes.receive(protocol.Timeouts(*timeouts), 100),
    }
    for name, call in calls.items():
        with pytest.raises(ClientError, match=r"within 0\.05 s"):
            call(0.05, lambda: None)
        with pytest.raises(ClientError, match="ended with exit code 3 before"):
            call(600, lambda: "ended with exit code 3")
        place = tmp_path / name
        place.unlink()
        with pytest.raises(ClientError, match=name):
            call(600, lambda: None)
        for write in (lambda place: place.symlink_to("gone"), lambda place: place.write_text("my notes")):
            place.unlink(missing_ok=True)
            write(place)
            with pytest.raises(ClientError, match=name):
                call(600, lambda: None)
            with pytest.raises(ClientError, match=name):
                protocol.Pipes(tmp_path)
        assert place.read_text() == "my notes"
        place.unlink()

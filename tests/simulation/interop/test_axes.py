"""HUGSIM's frames: computed by hand, and by the formulas of its simulator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.street.build import street_rigs
from gsrain_engine.simulation.agents.base import Observation, Rig
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.interop.hugsim_protocol import HugsimWorld, hugsim_rig, wrap_to_pi
from gsrain_engine.simulation.traffic.base import RoadUser
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE, Vehicle, VehicleState

angles = st.floats(-3, 3)
metres = st.floats(-50, 50)
ROUTE = Route(np.array([[0.0, 0.0], [100.0, 0.0]]))
HUGSIM_RIG = Rig(HUGSIM_VEHICLE, hugsim_rig(street_rigs()["nuscenes"]), 1.5)
OWN_RIG = Rig(Vehicle(), street_rigs()["nuscenes"], 1.5)


def seen(x=0.0, y=0.0, yaw=0.0, height=0.0, users=()):
    return Observation(0, 0.0, VehicleState(x, y, yaw, 5.0, 0.1), 0.0, 0.0, height, "straight", {}, ROUTE, tuple(users))


def test_world_begins_in_the_front_camera():
    world = HugsimWorld.from_observation(HUGSIM_RIG, seen(7, -3, 0.4, 2.0))
    assert (world.x_m, world.y_m, world.yaw_rad) == (pytest.approx(7), pytest.approx(-3), 0.4)
    assert world.z_m == pytest.approx(2.0 + 1.51)  # the camera stands 1.51 m above the road


def test_front_camera_of_another_rig_is_ahead_of_the_axle():
    world = HugsimWorld.from_observation(OWN_RIG, seen(0, 0, np.pi / 2))
    assert (world.x_m, world.y_m) == (pytest.approx(-0.02), pytest.approx(1.70))


def test_x_is_right_y_is_down_z_is_forward():
    north = HugsimWorld(10.0, 20.0, 1.5, np.pi / 2)
    np.testing.assert_allclose(north.place(10, 25, 1.5), (0, 0, 5), atol=1e-12)  # 5 m ahead
    np.testing.assert_allclose(north.place(13, 20, 1.5), (3, 0, 0), atol=1e-12)  # 3 m to the right
    np.testing.assert_allclose(north.place(10, 20, 0.0), (0, 1.5, 0), atol=1e-12)  # on the road
    assert north.yaw(np.pi / 2 - 0.3) == pytest.approx(0.3)  # turned right


def test_ego_box_is_around_the_camera_in_hugsims_setting():
    world = HugsimWorld.from_observation(HUGSIM_RIG, seen())
    box = world.ego_box(HUGSIM_RIG, seen(6, 2, 0.25))
    np.testing.assert_allclose(box, (6, 2, 0, 1.6, 3.0, 1.5, 0.25), atol=1e-12)


def test_ego_box_of_an_own_vehicle_is_around_its_body():
    world = HugsimWorld.from_observation(OWN_RIG, seen())
    box = world.ego_box(OWN_RIG, seen(6, 0))
    # The camera was at x 1.70, y 0.02; the body's middle is 1.3 m ahead of the axle.
    np.testing.assert_allclose(box, (6 + 1.3 - 1.7, -0.02, 0, 1.85, 4.6, 1.5, 0), atol=1e-9)
    np.testing.assert_allclose(world.ego_place(OWN_RIG, seen(6, 0)), (0, 0, 6), atol=1e-12)


def test_object_box_is_size_and_heading_in_hugsims_order():
    world = HugsimWorld.from_observation(HUGSIM_RIG, seen())
    lead = RoadUser("lead", "car", (4.6, 1.8, 1.4), 20.0, 1.0, 0.3, 0.0, 0.0)
    np.testing.assert_allclose(world.object_box(lead), (20, 1, -1.51, 1.8, 4.6, 1.4, 0.3), atol=1e-9)


@given(heading=angles)
def test_object_heading_is_left_positive_and_written_from_the_models_yaw(heading):
    box = HugsimWorld(0, 0, 0, 0).object_box(RoadUser("a", "car", (4, 2, 1), 1.0, 1.0, heading))
    assert wrap_to_pi(box[6] - heading) == pytest.approx(0, abs=1e-9)
    assert -1.5 * np.pi - 1e-9 <= box[6] <= 0.5 * np.pi + 1e-9


@given(x=metres, y=metres, yaw=angles, turn=st.floats(-1, 1), distance=st.floats(0.1, 5))
def test_motion_is_that_of_hugsims_simulator(x, y, yaw, turn, distance):
    """It moves its ego by a += d sin(th), b += d cos(th), x and z of the world, th right positive."""
    world = HugsimWorld.from_observation(HUGSIM_RIG, seen(x, y, yaw))
    heading = yaw + turn
    before = world.ego_place(HUGSIM_RIG, seen(x, y, heading))
    ahead = seen(x + distance * np.cos(heading), y + distance * np.sin(heading), heading)
    th = world.yaw(heading)
    step = world.ego_place(HUGSIM_RIG, ahead) - before
    np.testing.assert_allclose(step, (distance * np.sin(th), 0, distance * np.cos(th)), atol=1e-9)


@given(x=metres, y=metres, yaw=angles, far=metres, aside=metres)
def test_a_box_lies_where_the_ego_box_sees_it(x, y, yaw, far, aside):
    """Whatever the world's axes are: difference of two boxes, turned by the ego's yaw, is what our own frame says."""
    observation = seen(x, y, yaw)
    place = observation.state.to_world(np.array([[far, aside]]))[0]
    user = RoadUser("a", "car", (4, 2, 1), float(place[0]), float(place[1]), yaw)
    world = HugsimWorld.from_observation(HUGSIM_RIG, seen(3.0, -2.0, 1.0))
    ego, box = world.ego_box(HUGSIM_RIG, observation), world.object_box(user)
    away = np.array(box[:2]) - ego[:2]
    cosine, sine = np.cos(ego[6]), np.sin(ego[6])
    np.testing.assert_allclose((cosine * away[0] + sine * away[1], cosine * away[1] - sine * away[0]), (far, aside),
                               atol=1e-9)  # fmt: skip
    assert wrap_to_pi(box[6] - ego[6]) == pytest.approx(0, abs=1e-9)

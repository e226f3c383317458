"""IDM agents: the planner, the oracle, and the camera agent whose boxes of known cars are worked out, not drawn."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.agents import idm
from gsrain_engine.simulation.agents.base import Agent, CameraView, LanePath, Observation, Rig
from gsrain_engine.simulation.agents.lead_tracking import LeadTracker, Sighting, sightings
from gsrain_engine.simulation.agents.neuroncap import NeuroNCAPBaselineAgent
from gsrain_engine.simulation.agents.registry import AgentOptions, open_agent
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation, run_drive
from gsrain_engine.simulation.traffic.base import RoadUser, VehicleAhead
from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, step_bicycle
from small_scene import small_scene

VEHICLE = Vehicle()
RIG = Rig(VEHICLE, (), 1.5)
ROUTE = Route(np.array([[0.0, 0.0], [300.0, 0.0]]))
GROUND_M, MOUNT_M, ABOVE_M = 7.0, 1.5, 2.0
"""Height of the road; the camera is so far ahead of the rear axle, and above the road."""


def state(left_m=0.0):
    """An ego vehicle that goes along the road at 10 m/s."""
    return VehicleState(0.0, left_m, 0.0, 10.0)


def camera(of):
    """A level front camera, 800 px wide."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    matrix[:3, 3] = -matrix[:3, :3] @ (of.x_m + MOUNT_M, of.y_m, GROUND_M + ABOVE_M)
    return Camera(800, 534, 858.0, 858.0, 399.0, 267.0, matrix)


def car_box(of, gap_m, confidence=0.8, name="car", left_m=0.0, width_m=1.8, overhang_m=0.8):
    """A perfect detector's box of a car's rear, cut at the image's edges: sides by the bumper, bottom by the tires."""
    ahead = gap_m + VEHICLE.front_m - MOUNT_M
    u = 399 - 858 * (np.array([width_m, -width_m]) / 2 + left_m - of.y_m) / ahead
    v = 267 + 858 * np.array([ABOVE_M - 1.4, ABOVE_M]) / (ahead + np.array([0, overhang_m]))
    box = np.clip([u[0], v[0], u[1], v[1]], 0, [800, 534] * 2)
    return Detection(name, confidence, tuple(map(float, box)))


def observation(of, step=0, users=(), views=1):
    """A moment; its images show nothing."""
    view = CameraView(np.zeros((534, 800, 3), np.uint8), camera(of))
    return Observation(step, step * 0.25, of, 0.0, 0.0, GROUND_M, "straight", {f"C{i}": view for i in range(views)},
                       ROUTE, users)  # fmt: skip


def car(id, gap_m, left_m=0.0, yaw_rad=0.0, speed_m_s=0.0):
    """A road user with a gap ahead of the vehicle at the origin."""
    return RoadUser(id, "car", (4.6, 1.8, 1.4), VEHICLE.front_m + gap_m + 2.3, left_m, yaw_rad, speed_m_s)


def test_constant_velocity_is_three_seconds_of_the_route():
    agent = open_agent("constant-velocity", AgentOptions())
    plan = agent.plan(observation(VehicleState(3.0, 2.0, 0.0, 8.0)))
    np.testing.assert_allclose(plan.points, [[4.0 * k, -2.0] for k in range(1, 7)], atol=1e-12)


# Planner


@pytest.mark.parametrize(
    ("speed", "lead", "rate"),
    [
        (10.0, (40.0, 0.0), -1.5 * (45.87 / 40) ** 2),
        (8.0, ((2.0 + 8.0 * 1.5) / np.sqrt(1 - 0.8**4), 8.0), 0.0),  # the equilibrium gap
        (10.0, (12.0, 0.0), -1.25 * 100 / 22),  # an emergency
        (10.0, (7.9, 0.0), -7.0),  # full braking
        (0.0, (3.4, 0.0), -3.0),  # no room to set off
    ],
)
def test_the_planner_brakes_as_its_equations_say(speed, lead, rate):
    planner = idm.IDMPlanner(10.0, hard_m_s2=7.0)
    assert planner.acceleration(speed, VehicleAhead(*map(float, lead))) == pytest.approx(rate, abs=0.01)


@given(
    st.floats(0, 40), st.floats(-5, 120), st.floats(-20, 40), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(1, 30)
)
def test_plans_go_forward_and_back_to_the_route(speed, gap, lead_speed, left, yaw, cruise):
    distances = idm.IDMPlanner(cruise).distances(speed, VehicleAhead(gap, lead_speed))
    assert np.isfinite(distances).all() and (np.diff(distances, prepend=0.0) >= 0).all()
    path = LanePath.of(VehicleState(50.0, left, yaw, speed), ROUTE)
    points = path.points(distances)
    assert points.shape == (6, 2) and (points[:, 0] >= -1e-9).all()
    offset = left * np.exp(-distances / max(6.0, 1.5 * speed))
    expected = VehicleState(50.0, left, yaw).from_world(np.stack([50 + distances, offset], axis=1))
    np.testing.assert_allclose(points, expected, atol=1e-9)
    assert path.place(50 + distances[-1], 0.0) == pytest.approx((distances[-1], -offset[-1]), abs=1e-9)


# Oracle


@pytest.mark.parametrize(
    ("user", "gap_and_speed"),
    [
        (car("half", 8, -1.9), (8.0, 0.0)),
        (car("right", 8, -2.3), None),
        (car("cut-in", 10, 3.3, -0.149, 8.09), (9.9, 8.0)),  # 1.2 m/s to the side: 1.8 m within the foresight
        (car("leaving", 10, 3.3, 0.149, 8.09), None),
        (car("oncoming", 30, 0.0, np.pi, 6.0), (30.0, -6.0)),
    ],
)
def test_the_nearest_in_the_lane_or_on_the_way_into_it_leads(user, gap_and_speed):
    users = [car("behind", -12), user, car("far", 40, speed_m_s=5.0)]
    found = idm.find_oracle_lead(users, LanePath.of(state(), ROUTE), VEHICLE)
    assert found.id == (user.id if gap_and_speed else "far")
    assert (found.lead.gap_m, found.lead.speed_m_s) == pytest.approx(gap_and_speed or (40.0, 5.0), abs=0.3)


# Sightings


def sighted(detection, left_m=0.0):
    here = state(left_m)
    return sightings([detection], camera(here), GROUND_M, LanePath.of(here, ROUTE), VEHICLE)


@given(st.floats(6, 70), st.floats(-0.8, 0.8))
def test_the_ground_gives_the_gap_or_the_width_where_the_image_cuts_the_box(gap, left):
    (level,) = sighted(car_box(state(), gap, left_m=left))
    assert level.gap_m == pytest.approx(gap, abs=1e-6)
    assert level.error_m == pytest.approx((0.09 + (1.6 * (gap + 0.8 + 2.1) ** 2 / (858 * 2)) ** 2) ** 0.5, rel=1e-3)
    (cut,) = sighted(car_box(state(), gap / 20))
    error = 0.1 * (gap / 20 + 3.6 - 1.5)
    assert (cut.gap_m, cut.error_m) == pytest.approx((gap / 20 - error, np.hypot(error, 0.3)))


@pytest.mark.parametrize(
    ("detection", "own_left_m", "counts"),
    [
        *((car_box(state(), 15.0, left_m=left), 0.0, near) for left, near in ((1.0, True), (-1.9, True), (2.3, False))),
        (car_box(state(3.0), 5.0, left_m=3.0), 3.0, True),  # on its own path back to the route
        (car_box(state(3.0), 5.0, left_m=0.0), 3.0, False),
        (Detection("car", 0.9, (100.0, 250.0, 700.0, 534.0)), 0.0, True),
        (Detection("car", 0.9, (524.0, 250.0, 800.0, 534.0)), 0.0, False),  # parked, and cut at the image's side
        (Detection("car", 0.9, (390.0, 240.0, 410.0, 266.0)), 0.0, False),  # above the horizon
        (car_box(state(), 85.0), 0.0, False),
        (car_box(state(), 20.0, name="person", width_m=0.5, overhang_m=0.0), 0.0, True),
        (car_box(state(), 20.0, name="bench"), 0.0, False),
    ],
)
def test_only_road_users_in_the_lane_and_within_reach_count(detection, own_left_m, counts):
    assert bool(sighted(detection, own_left_m)) is counts


# Tracking

DT = 0.25


def tracked(gaps, own_speed_m_s=10.0, error_m=0.5):
    """Track gaps, each a list of gaps or of (gap, confidence), one a moment; returns the states of the tracker."""
    tracker, states = LeadTracker(), []
    for k, row in enumerate(gaps):
        pairs = [each if isinstance(each, tuple) else (each, 0.9) for each in row]
        found = [Sighting(Detection("car", sure, (0.0, 0.0, 1.0, 1.0)), gap, error_m) for gap, sure in pairs]
        states.append(tracker.look(found, k * DT * own_speed_m_s, own_speed_m_s, DT if k else 0.0))
    return states


@given(st.lists(st.floats(-0.5, 0.5), min_size=2, max_size=9), st.floats(-8, 8), st.floats(0.2, 2))
def test_a_track_is_kalmans_filter_for_constant_speed(noise, closing, error):
    gaps = 40 - closing * DT * np.arange(len(noise)) + np.array(noise)
    found = tracked([[gap] for gap in gaps], error_m=error)
    mean, covariance = np.array([gaps[0], 5.0]), np.diag([error**2, 36.0])
    step, push = np.array([[1.0, DT], [0.0, 1.0]]), np.array([DT**2 / 2, DT]) * 4.0
    for k, (gap, there) in enumerate(zip(gaps, found, strict=True)):
        if k:
            mean, covariance = step @ mean, step @ covariance @ step.T + np.outer(push, push)
            gain = covariance[:, 0] / (covariance[0, 0] + error**2)
            mean = mean + gain * (gap + 10 * DT * k - mean[0])
            covariance = covariance - np.outer(gain, covariance[0])
        assert (there.lead.gap_m + 10 * DT * k, there.lead.speed_m_s) == pytest.approx(tuple(mean))


@pytest.mark.parametrize(
    ("gaps", "own_speed_m_s", "believed"),
    [
        ([*([gap] for gap in 40 - 2.5 * np.arange(8)), *[[]] * 5], 10.0, [True] * 12 + [False]),  # for a second
        ([[2.2], [2.1], [2.0], *[[]] * 121], 0.0, [True] * 123 + [False]),  # near and standing: half a minute
        ([*([gap] for gap in 2 + 0.75 * np.arange(5)), *[[]] * 8], 0.0, [True] * 9 + [False] * 4),  # it drove off
        ([[(20.0, 0.15)], [(20.0, 0.4)], [(20.0, 0.15)], [20.0], *[[(20.0, 0.15)]] * 8], 0.0, [False] * 3 + [True] * 9),
        ([[(30.0, 0.4)], [], [(30.0, 0.4)], [(30.0, 0.4)]], 0.0, [False] * 3 + [True]),  # twice on end
    ],
)
def test_who_is_believed_to_be_there(gaps, own_speed_m_s, believed):
    assert [each is not None for each in tracked(gaps, own_speed_m_s)] == believed


def test_jumps_doubles_and_cut_ins():
    jump = tracked([[20.0], [20.0], [20.0], [45.0], [20.0]], 0.0)
    assert all(each.lead.gap_m == pytest.approx(20.0, abs=0.5) for each in jump) and jump[3].sighting is None
    double = tracked([[20.0, (18.0, 0.35)], [20.0, (18.0, 0.35)], [20.0]], 0.0)
    assert double[-1].lead.gap_m == pytest.approx(20.0, abs=0.1)
    cut_in = tracked([[30.0]] * 3 + [[30.0, 12.0]] + [[30.0]] * 5, 0.0)
    assert cut_in[3].lead.gap_m == 12.0 and cut_in[-1].lead.gap_m == pytest.approx(30.0, abs=0.2)
    assert cut_in[-1].track.count == 9


# Camera agent


class GivenBoxes:
    """A detector that returns given boxes."""

    name, boxes = "given", ()

    def detect(self, image):
        return list(self.boxes)


@pytest.fixture
def detector():
    return GivenBoxes()


@pytest.fixture
def agent(detector):
    opened = idm.CameraIDMAgent(detector)
    opened.reset(0, RIG)
    return opened


@pytest.mark.parametrize("is_clear", [True, False])
def test_it_stops_behind_a_car_that_is_detected_and_for_nothing_else(agent, detector, is_clear):
    now, gap = state(), 40.0
    for step in range(60):
        gap = 43.6 - VEHICLE.front_m - now.x_m
        detector.boxes = [car_box(now, gap, left_m=-2.6), car_box(now, gap, 0.2)]  # a parked one and a faint one
        if gap <= 0 or is_clear:
            detector.boxes = [car_box(now, gap)] if gap > 0 else []
        plan = agent.plan(observation(now, step))
        rate = float((plan.points[0, 0] / 0.5 - now.speed_m_s) / 0.25)
        now = step_bicycle(VEHICLE, now, Control(rate, 0.0), 0.25)
    assert (now.speed_m_s < 0.1 and 2.0 < gap < 2.8) if is_clear else (gap < 0 and now.speed_m_s == 10.0)


def test_notes_hold_detections_and_no_ground_truth_and_a_reset_forgets(agent, detector):
    detector.boxes = [car_box(state(), 20.0, 0.91234), Detection("bench", 0.8, (0.0, 0.0, 9.0, 9.0))]
    notes = agent.plan(observation(state(), users=(car("truth", 5.0),))).notes
    box = [round(side, 1) for side in detector.boxes[0].box_xyxy]
    lead = {"class": "car", "gap_m": 20.0, "speed_m_s": 5.0, "measured_gap_m": 20.0, "box_xyxy": box, "unseen_s": 0.0}
    found = [{"class": "car", "confidence": 0.912, "box_xyxy": box}]
    assert notes == {"detector": "given", "detections": found, "lead": lead}
    detector.boxes = []
    assert agent.plan(observation(state(), 1)).notes["lead"] is not None
    agent.reset(0, RIG)
    assert agent.plan(observation(state())).notes["lead"] is None
    with pytest.raises(ValueError, match="2"):
        agent.plan(observation(state(), views=2))
    assert all(isinstance(each, Agent) for each in (agent, idm.OracleIDMAgent(), NeuroNCAPBaselineAgent()))


def test_from_image_to_plan_with_a_tiny_network(tmp_path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from evaluation.detection.tiny_onnx import NAMES, rows, write_constant

    # 10 m ahead of a camera with f 200 px, 1.5 m above the road, a car is 36 px wide and ends 30 px below the middle;
    # images of 240 x 160 px go into the network at 48 / 240, with bars above and below.
    box = np.array([102, 90 + 40, 138, 110 + 40]) * 48 / 240
    file = write_constant(tmp_path / "tiny.onnx", [rows([*box, 0.75, 0])], (48, 48), NAMES)
    agent = open_agent("camera-idm", AgentOptions(detector=file))
    scenario = msgspec.structs.replace(
        load_scenario("stationary-lead"), road_users=(), picture_width_px=240, speed_m_s=2.0, duration_s=1.0
    )
    with open_renderer("cpu") as renderer:
        simulation = Simulation(scenario, small_scene(), agent.needs, renderer)
        one, other = (run_drive(simulation, agent) for _ in range(2))
    assert msgspec.json.encode(one) == msgspec.json.encode(other)
    notes = one.steps[0].notes
    assert (notes["detector"], notes["lead"]["class"]) == ("tiny", "car")
    assert notes["lead"]["measured_gap_m"] == pytest.approx(10 - 0.8 - VEHICLE.front_m, abs=0.05)

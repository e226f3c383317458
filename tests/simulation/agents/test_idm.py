"""IDM agents: the planner, the oracle, and the camera agent whose boxes of known cars are worked out, not drawn."""

import json

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.simulation.agents import idm
from gsrain_engine.simulation.agents.base import Agent, CameraView, LanePath, Observation, Rig
from gsrain_engine.simulation.agents.lead_tracking import LeadTracker, Sighting, road_user_class, sightings
from gsrain_engine.simulation.agents.neuroncap import NeuroNCAPBaselineAgent
from gsrain_engine.simulation.agents.registry import AgentOptions, open_agent
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation, drive_scene, run_drive
from gsrain_engine.simulation.traffic.base import RoadUser, VehicleAhead
from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, step_bicycle
from small_scene import small_scene

VEHICLE = Vehicle()
RIG = Rig(VEHICLE, (), 1.5)
ROUTE = Route(np.array([[0.0, 0.0], [300.0, 0.0]]))
GROUND_M, MOUNT_M, ABOVE_M = 7.0, 1.5, 2.0
"""Height of the road; the camera is so far ahead of the rear axle, and above the road."""


def state(x_m=0.0, speed_m_s=10.0, left_m=0.0):
    """An ego vehicle that goes along the road."""
    return VehicleState(x_m, left_m, 0.0, speed_m_s)


def camera(of, pitch_rad=0.0):
    """A front camera, 800 px wide."""
    cosine, sine = np.cos(pitch_rad), np.sin(pitch_rad)
    matrix = np.eye(4)
    down = np.array([[1.0, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    matrix[:3, :3] = down @ [[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]
    matrix[:3, 3] = -matrix[:3, :3] @ (of.x_m + MOUNT_M, of.y_m, GROUND_M + ABOVE_M)
    return Camera(800, 534, 858.0, 858.0, 399.0, 267.0, matrix)


def car_box(of, gap_m, confidence=0.8, name="car", left_m=0.0, width_m=1.8, overhang_m=0.8, pitch_rad=0.0):
    """A perfect detector's box of a car's rear, cut at the image's edges: sides by the bumper, bottom by the tires."""
    view, bumper = camera(of, pitch_rad), of.x_m + VEHICLE.front_m + gap_m
    places = np.array([
        (bumper, left_m + width_m / 2, GROUND_M + 1.4, 1), (bumper, left_m - width_m / 2, GROUND_M + 1.4, 1),
        (bumper + overhang_m, left_m, GROUND_M, 1),
    ])  # fmt: skip
    right, down, depth = view.world_to_camera[:3] @ places.T
    u, v = right / depth * view.fx + view.cx, down / depth * view.fy + view.cy
    box = np.clip([u[0], v[0], u[1], v[2]], 0, [800, 534] * 2)
    return Detection(name, confidence, tuple(map(float, box)))


def observation(of, step=0, users=(), views=1):
    """A moment; its images show nothing."""
    view = CameraView(np.zeros((534, 800, 3), np.uint8), camera(of))
    return Observation(step, step * 0.25, of, 0.0, 0.0, GROUND_M, "straight", {f"C{i}": view for i in range(views)},
                       ROUTE, users)  # fmt: skip


def car(id, gap_m, of, left_m=0.0, yaw_rad=0.0, speed_m_s=0.0):
    """A road user whose middle is half its length farther than a gap ahead."""
    x = of.x_m + VEHICLE.front_m + gap_m + 2.3
    return RoadUser(id, "car", (4.6, 1.8, 1.4), x, left_m, yaw_rad, speed_m_s, GROUND_M)


# Planner


@pytest.mark.parametrize(
    ("first_m", "strongest_m_s2", "left_m"),
    [(40.0, 3.0, 2.0), (24.0, 3.0, None), (18.0, 3.0, None), (15.0, 3.0, -1), (10.0, 3.0, -1), (10.0, 8.0, None)],
)
def test_a_standing_car_is_hit_only_if_it_is_detected_late(first_m, strongest_m_s2, left_m):
    """Drive at 10 m/s; the car is known from `first_m` on, and the vehicle follows as hard as it can."""
    speed, dt, gap, planner = 10.0, 0.25, 40.0, idm.IDMPlanner(10.0)
    while speed > 0 and gap > 0:
        lead = VehicleAhead(gap, 0.0) if gap <= first_m else None
        mean = planner.distances(speed, lead)[0] / 0.5
        after = max(0.0, speed + float(np.clip((mean - speed) / 0.25, -strongest_m_s2, strongest_m_s2)) * dt)
        gap -= 0.5 * (speed + after) * dt
        speed = after
    assert (gap <= 0) == (left_m == -1)
    assert left_m in (None, -1) or gap == pytest.approx(left_m, abs=0.4)


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


def test_a_free_road_is_taken_at_the_cruising_speed_and_who_stands_waits_for_room():
    planner = idm.IDMPlanner(10.0)
    assert planner.distances(10.0, None) == pytest.approx(np.arange(1, 7) * 5.0)
    assert planner.distances(5.0, None)[-1] > 15.0 and planner.distances(14.0, None)[-1] < 42.0
    for gap, speed, goes in ((0.5, 0.0, False), (3.4, 0.0, False), (3.4, 3.0, True), (8.0, 0.0, True)):
        assert (planner.distances(0.0, VehicleAhead(gap, speed))[-1] > 1.0) == goes
    assert (idm.cruise_speed(0.0), idm.cruise_speed(13.9)) == (10.0, 13.9)


@given(
    st.floats(0, 40), st.floats(-5, 120), st.floats(-20, 40), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(1, 30)
)
def test_no_plan_goes_backward(speed, gap, lead_speed, left, yaw, cruise):
    distances = idm.IDMPlanner(cruise).distances(speed, VehicleAhead(gap, lead_speed))
    assert np.isfinite(distances).all() and (np.diff(distances, prepend=0.0) >= 0).all()
    points = LanePath.of(VehicleState(50.0, left, yaw, speed), ROUTE).points(distances)
    assert points.shape == (6, 2) and (points[:, 0] >= -1e-9).all()


def test_a_lane_path_starts_at_the_vehicle_and_comes_back_gently():
    np.testing.assert_allclose(observation(state(5.0)).route_ahead(3.0), [[x, 0] for x in range(4)], atol=1e-12)
    bend = Route(np.array([[0.0, 0.0], [10.0, 0.0], [17.0, 7.0]]))
    assert np.abs(LanePath.of(VehicleState(10.2, -1.0, 0.3, 0.0), bend).points(np.zeros(6))).max() < 1e-12
    path = LanePath.of(VehicleState(20.0, 1.0, 0.0, 10.0), ROUTE)
    left = path.points(np.array([5.0, 15.0, 60.0]))[:, 1]
    assert left == pytest.approx([np.exp(-5 / 15) - 1, np.exp(-1) - 1, np.exp(-4) - 1])
    assert path.place(20.0, 1.0) == pytest.approx((0.0, 0.0)) and path.place(80.0, 0.0)[1] == pytest.approx(-np.exp(-4))


# Oracle

BEND = Route(60 * np.stack([np.sin(a := np.linspace(0, np.pi / 2, 200)), 1 - np.cos(a)], axis=1))


def on_bend(name, radius, turned=25 / 60):
    return RoadUser(name, "car", (4.5, 1.8, 1.4), radius * np.sin(turned), 60 - radius * np.cos(turned), turned, 15.0)


TURNED = float(np.arctan2(1.2, 8.0))  # 1.2 m/s to the side: 1.8 m within the foresight


@pytest.mark.parametrize(
    ("users", "route", "expected"),
    [
        ([car("far", 40, state(), speed_m_s=5.0), car("near", 12, state()), car("beside", 5, state(), 3.5)], ROUTE,
         ("near", 12.0, 0.0)),
        ([car("behind", -12, state()), car("left", 8, state(), 3.0), car("right", 8, state(), -2.3)], ROUTE, None),
        ([car("half", 8, state(), -1.9)], ROUTE, ("half", 8.0, 0.0)),
        ([car("cut-in", 10, state(), 3.3, -TURNED, 8.09)], ROUTE, ("cut-in", 9.9, 8.0)),
        ([car("straight", 10, state(), 3.3, 0.0, 8.09), car("leaving", 10, state(), 3.3, TURNED, 8.09)], ROUTE, None),
        ([car("oncoming", 30, state(), 0.0, np.pi, 6.0)], ROUTE, ("oncoming", 30.0, -6.0)),
        ([on_bend("next lane", 60 - 3.2)], BEND, None),
        ([on_bend("own lane", 60.0)], BEND, ("own lane", 25 - 2.25 - 3.6, 15.0)),
    ],
)  # fmt: skip
def test_the_nearest_in_the_lane_or_on_the_way_into_it_leads(users, route, expected):
    found = idm.find_oracle_lead(users, LanePath.of(state(), route), VEHICLE)
    assert (found and found.id) == (expected and expected[0])
    assert found is None or (found.lead.gap_m, found.lead.speed_m_s) == pytest.approx(expected[1:], abs=0.3)


def test_neuroncaps_baseline_stops_for_whose_middle_is_in_its_corridor_and_keeps_the_corridor():
    agent = NeuroNCAPBaselineAgent()
    agent.reset(0, RIG)

    def plan(x, y, speed=10.0):
        users = (RoadUser("it", "car", (4.5, 1.8, 1.4), x, y, 0.0),)
        return agent.plan(observation(state(speed_m_s=speed), users=users))

    for place in ((22.1, 0.0), (1.9, 0.0), (10.0, 2.6)):
        assert plan(*place).points[0, 0] == pytest.approx(5.0)
    stop = plan(21.9, -2.4)
    assert (stop.points == 0).all() and stop.points.shape == (6, 2) and stop.notes == {"in_corridor": ["it"]}
    assert (plan(21.9, 0.0, 2.0).points == 0).all()
    agent.reset(0, RIG)
    assert plan(21.9, 0.0, 2.0).points[0, 0] == pytest.approx(1.0)


# Sightings


def sighted(detection, of=None, pitch_rad=0.0):
    of = of or state()
    return sightings([detection], camera(of, pitch_rad), GROUND_M, LanePath.of(of, ROUTE), VEHICLE)


@given(st.floats(6, 70), st.floats(-0.8, 0.8), st.floats(-0.03, 0.05))
def test_the_ground_gives_the_gap_and_the_error_grows_with_the_square_of_the_distance(gap, left, pitch):
    (level,) = sighted(car_box(state(), gap, left_m=left))
    assert level.gap_m == pytest.approx(gap, abs=1e-6)
    assert level.error_m == pytest.approx((0.09 + (1.6 * (gap + 0.8 + 2.1) ** 2 / (858 * 2)) ** 2) ** 0.5, rel=1e-3)
    (pitched,) = sighted(car_box(state(), gap, left_m=left, pitch_rad=pitch), pitch_rad=pitch)
    assert pitched.gap_m == pytest.approx(gap, rel=0.01, abs=0.1)


@pytest.mark.parametrize("gap_m", [3.0, 1.0, 0.3])
def test_a_box_that_the_image_cuts_below_is_measured_by_its_width_to_be_on_the_safe_side(gap_m):
    (sighting,) = sighted(car_box(state(), gap_m))
    error = 0.1 * (gap_m + 3.6 - 1.5)
    assert sighting.gap_m == pytest.approx(gap_m - error, abs=1e-6)
    assert sighting.error_m == pytest.approx((error**2 + 0.09) ** 0.5)


@pytest.mark.parametrize(
    ("detection", "own_left_m", "counts"),
    [
        *((car_box(state(), 15.0, left_m=left), 0.0, near) for left, near in ((1.0, True), (-1.9, True), (2.3, False))),
        (car_box(state(left_m=3.0), 5.0, left_m=3.0), 3.0, True),  # on its own path back to the route
        (car_box(state(left_m=3.0), 5.0, left_m=0.0), 3.0, False),
        (Detection("car", 0.9, (100.0, 250.0, 700.0, 534.0)), 0.0, True),
        (Detection("car", 0.9, (524.0, 250.0, 800.0, 534.0)), 0.0, False),  # parked, and cut at the image's side
        (Detection("car", 0.9, (390.0, 240.0, 410.0, 266.0)), 0.0, False),  # above the horizon
        (car_box(state(), 85.0), 0.0, False),
        (car_box(state(), 20.0, name="person", width_m=0.5, overhang_m=0.0), 0.0, True),
        (car_box(state(), 20.0, name="bench"), 0.0, False),
    ],
)
def test_only_road_users_in_the_lane_and_within_reach_count(detection, own_left_m, counts):
    assert bool(sighted(detection, state(left_m=own_left_m))) is counts


def test_detectors_words_become_classes():
    words = {"car": "car", "Van": "car", "pedestrian": "person", "rider": "person", "bench": None, "dog": None}
    assert {word: road_user_class(Detection(word, 0.9, (0.0, 0.0, 1.0, 1.0))) for word in words} == words


# Tracking

DT = 0.25


def tracked(gaps, own_speed_m_s=10.0, error_m=0.5):
    """Track gaps, each a list of gaps or of (gap, confidence), one a moment; returns what is believed."""
    tracker, states = LeadTracker(), []
    for k, row in enumerate(gaps):
        pairs = [each if isinstance(each, tuple) else (each, 0.9) for each in row]
        found = [Sighting(Detection("car", sure, (0.0, 0.0, 1.0, 1.0)), gap, error_m) for gap, sure in pairs]
        states.append(tracker.look(found, k * DT * own_speed_m_s, own_speed_m_s, DT if k else 0.0))
    return states


@pytest.mark.parametrize("lead_m_s", [0.0, 6.0, 12.0])
def test_gap_and_speed_come_out_of_noise(lead_m_s):
    gaps = 40 + (lead_m_s - 10.0) * DT * np.arange(13)
    noisy = gaps + np.random.default_rng(5).normal(0, 1.0, 13)
    last = tracked([[gap] for gap in noisy], error_m=1.0)[-1]
    assert last.lead.gap_m == pytest.approx(gaps[-1], abs=1.2)
    assert last.lead.speed_m_s == pytest.approx(lead_m_s, abs=1.5)


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
    states = tracked(gaps, own_speed_m_s)
    assert [each is not None for each in states] == believed
    if gaps[-1] == [] and believed[4] and own_speed_m_s == 0 and len(gaps) > 100:
        assert (states[122].lead.gap_m, states[4].lead.speed_m_s) == (states[4].lead.gap_m, 0.0)


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

    name = "given"

    def __init__(self):
        self.boxes: list[Detection] = []

    def detect(self, image):
        return self.boxes


def opened():
    detector = GivenBoxes()
    agent = idm.CameraIDMAgent(detector)
    agent.reset(0, RIG)
    return agent, detector


RNG = np.random.default_rng(1)


def shaky(step, now, gap):
    """Every third image shows nothing, and the others shake."""
    box = np.array(car_box(now, gap).box_xyxy) + RNG.normal(0, 1.0, 4)
    return [] if step % 3 == 2 else [Detection("car" if step % 2 else "truck", 0.5, tuple(box))]


def parked(step, now, gap):
    cars = [(gap, -2.6), (gap + 7, 2.7), (gap - 12, -2.5)]
    return [car_box(now, each, left_m=left) for each, left in cars if each > 1]


@pytest.mark.parametrize(
    ("detected", "low_m", "high_m"),
    [
        (lambda step, now, gap: [car_box(now, gap)], 2.0, 2.8),
        (shaky, 0.5, 4.0),
        (lambda step, now, gap: [car_box(now, gap)] if gap <= 18 else [], 0.5, 4.0),
        (lambda step, now, gap: [car_box(now, gap, 0.2)], None, None),  # hardly detected
        (parked, None, None),
    ],
    ids=("clear", "shaky", "late", "faint", "parked"),
)
def test_it_stops_behind_a_car_that_is_detected_and_for_nothing_else(detected, low_m, high_m):
    agent, detector = opened()
    now, gap = state(), 40.0
    for step in range(60):
        gap = 43.6 - VEHICLE.front_m - now.x_m
        detector.boxes = detected(step, now, gap) if gap > 0 else []
        plan = agent.plan(observation(now, step))
        rate = float((plan.points[0, 0] / 0.5 - now.speed_m_s) / 0.25)
        now = step_bicycle(VEHICLE, now, Control(rate, 0.0), 0.25)
    if low_m is None:
        assert gap < 0 and now.speed_m_s == 10.0
    else:
        assert now.speed_m_s < 0.05 and low_m < gap < high_m
        json.dumps(plan.notes)


def test_notes_hold_what_was_detected_and_nothing_that_it_cannot_know_and_a_reset_forgets():
    agent, detector = opened()
    detector.boxes = [car_box(state(), 20.0, 0.91234), Detection("bench", 0.8, (0.0, 0.0, 9.0, 9.0))]
    notes = agent.plan(observation(state(), users=(car("truth", 5.0, state()),))).notes
    assert json.loads(json.dumps(notes)) == notes and notes["detector"] == "given"
    assert [(each["class"], each["confidence"]) for each in notes["detections"]] == [("car", 0.912)]
    assert notes["lead"]["measured_gap_m"] == 20.0
    assert notes["lead"]["box_xyxy"] == notes["detections"][0]["box_xyxy"]
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


def test_a_real_detector_finds_the_car_on_the_street_and_the_agent_brakes(test_data):
    pytest.importorskip("onnxruntime")
    file = test_data / "detectors/yolox_nano.onnx"
    if not file.is_file():
        pytest.skip(f"no detector at {file}")
    near = load_scenario("stationary-lead")
    near = msgspec.structs.replace(
        near, duration_s=2.5, speed_m_s=8.0, step_s=0.5,
        road_users=(msgspec.structs.replace(near.road_users[0], ahead_m=22.0),),
        rain=msgspec.structs.replace(near.rain, intensity_mm_h=12.0),
    )  # fmt: skip
    rollout = drive_scene(
        load_sorted_scene(None), None, "camera-idm", near, options=AgentOptions(detector=file)
    ).rollout
    first, last = rollout.steps[0], rollout.steps[-2]
    assert rollout.end == "time" and first.notes["lead"]["class"] == "car"
    assert first.notes["lead"]["measured_gap_m"] == pytest.approx(22 - 2.33 - 2.3, abs=2.0)
    assert last.notes["lead"]["speed_m_s"] == pytest.approx(0.0, abs=1.2) and last.ego.speed_m_s < 4.5

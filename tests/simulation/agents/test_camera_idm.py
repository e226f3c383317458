"""The camera agent, shown boxes of known cars, and shown the street by a real detector."""

import json

import msgspec
import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.idm import CameraIDMAgent
from gsrain_engine.simulation.agents.registry import AgentOptions, open_agent
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation, drive
from gsrain_engine.simulation.vehicle import Control, step_bicycle
from small_scene import small_scene

from .seen_road import FRONT_M, RIG, VEHICLE, car, observation, seen_car, state


class Told:
    """A detector that says what it is told."""

    name = "told"

    def __init__(self):
        self.says: list[Detection] = []

    def detect(self, image):
        return self.says


def _agent():
    detector = Told()
    agent = CameraIDMAgent(detector)
    agent.reset(0, RIG)
    return agent, detector


def _driven(seen, stands_at_m=43.6, steps=60):
    """Drive up to a car that stands; `seen(step, state, gap)` is what is detected. Returns states and notes."""
    agent, detector = _agent()
    now, passed = state(), []
    for step in range(steps):
        gap = stands_at_m - FRONT_M - now.x_m
        detector.says = seen(step, now, gap)
        plan = agent.plan(observation(now, step))
        passed.append((now, gap, plan.notes))
        mean = plan.points[0, 0] / 0.5
        now = step_bicycle(VEHICLE, now, Control(float((mean - now.speed_m_s) / 0.25), 0.0), 0.25)
    return passed


def test_it_stops_behind_a_car_that_it_sees():
    passed = _driven(lambda step, now, gap: [seen_car(now, gap)] if gap > 0 else [])
    last, gap, notes = passed[-1]
    assert last.speed_m_s == 0
    assert 2.0 <= gap < 2.8  # a little early: what the picture cuts is taken to be nearer than it looks
    assert notes["lead"]["gap_m"] == pytest.approx(gap - 0.1 * (gap + 2.1), abs=0.2)


def test_it_stops_where_every_third_picture_shows_nothing_and_boxes_shake():
    rng = np.random.default_rng(1)

    def seen(step, now, gap):
        if step % 3 == 2 or gap <= 0:
            return []
        box = seen_car(now, gap, 0.5).box_xyxy
        return [Detection("car" if step % 2 else "truck", 0.5, tuple(np.array(box) + rng.normal(0, 1.0, 4)))]

    last, gap, _ = _driven(seen)[-1]
    assert last.speed_m_s < 0.05
    assert 0.5 < gap < 4.0


def test_it_does_not_stop_for_what_it_does_not_see():
    passed = _driven(lambda step, now, gap: [seen_car(now, gap, 0.2)] if gap > 0 else [], steps=20)
    assert min(gap for _, gap, _ in passed) < 0
    assert passed[3][2]["lead"] is None
    assert passed[3][2]["detections"][0]["confidence"] == 0.2


def test_it_stops_for_what_it_sees_from_eighteen_metres_on():
    passed = _driven(lambda step, now, gap: [seen_car(now, gap)] if 0 < gap <= 18 else [])
    assert min(gap for _, gap, _ in passed) > 0.5


def test_parked_cars_do_not_slow_it_down():
    def seen(step, now, gap):
        beside = [(gap, -2.6), (gap + 7, 2.7), (gap - 12, -2.5)]
        return [seen_car(now, each, left_m=left) for each, left in beside if each > 1]

    assert {now.speed_m_s for now, _, _ in _driven(seen, steps=25)} == {10.0}


def test_notes_say_what_it_saw_in_plain_values_and_nothing_that_it_cannot_know():
    agent, detector = _agent()
    detector.says = [seen_car(state(), 20.0, 0.91234), Detection("bench", 0.8, (0.0, 0.0, 9.0, 9.0))]
    notes = agent.plan(observation(state(), users=(car("truth", 5.0, state()),))).notes
    assert json.loads(json.dumps(notes)) == notes
    assert notes["detector"] == "told"
    assert [(each["class"], each["confidence"]) for each in notes["detections"]] == [("car", 0.912)]
    assert notes["lead"]["measured_gap_m"] == 20.0
    assert notes["lead"]["box_xyxy"] == notes["detections"][0]["box_xyxy"]


def test_a_reset_forgets_the_lead():
    agent, detector = _agent()
    assert isinstance(agent, Agent)
    detector.says = [seen_car(state(), 10.0)]
    assert agent.plan(observation(state())).notes["lead"] is not None
    detector.says = []
    assert agent.plan(observation(state(), 1)).notes["lead"] is not None
    agent.reset(0, RIG)
    assert agent.plan(observation(state())).notes["lead"] is None


def test_it_wants_one_picture():
    agent, _ = _agent()
    with pytest.raises(ValueError, match="2 pictures"):
        agent.plan(observation(state(), views=2))


def test_from_picture_to_plan_with_a_tiny_network(tmp_path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from evaluation.detection.tiny_onnx import NAMES, rows, write_constant

    # 10 m ahead of a camera with f 200 px, 1.5 m above the road, a car is 36 px wide and ends 30 px below the middle;
    # pictures of 240 x 160 px go into the network at 48 / 240, with bars above and below.
    scale = 48 / 240
    box = [102 * scale, 90 * scale + 8, 138 * scale, 110 * scale + 8]
    file = write_constant(tmp_path / "tiny.onnx", [rows([*box, 0.75, 0])], (48, 48), NAMES)
    agent = open_agent("camera-idm", AgentOptions(detector=file))
    scenario = msgspec.structs.replace(
        load_scenario("stationary-lead"), road_users=(), picture_width_px=240, speed_m_s=2.0, duration_s=1.0
    )
    with open_renderer("cpu") as renderer:
        simulation = Simulation(scenario, small_scene(), agent.needs, renderer)
        rollouts = []
        for _ in range(2):
            for _ in drive(simulation, agent):
                pass
            rollouts.append(simulation.rollout(agent.name))
    assert msgspec.json.encode(rollouts[0]) == msgspec.json.encode(rollouts[1])
    first = rollouts[0].steps[0]
    assert first.notes["detector"] == "tiny"
    assert first.notes["lead"]["class"] == "car"
    assert first.notes["lead"]["measured_gap_m"] == pytest.approx(10 - 0.8 - FRONT_M, abs=0.05)


def test_a_real_detector_sees_the_car_on_the_street_and_the_agent_stops(test_data):
    pytest.importorskip("onnxruntime")
    file = test_data / "detectors/yolox_nano.onnx"
    if not file.is_file():
        pytest.skip(f"no detector at {file}")
    scene = load_sorted_scene(None)
    near = msgspec.structs.replace(load_scenario("stationary-lead"), duration_s=2.5, speed_m_s=8.0)
    ahead = (msgspec.structs.replace(near.road_users[0], ahead_m=22.0),)
    near = msgspec.structs.replace(
        near, road_users=ahead, step_s=0.5, rain=msgspec.structs.replace(near.rain, intensity_mm_h=12.0)
    )
    agent = open_agent("camera-idm", AgentOptions(detector=file))
    with open_renderer("cpu") as renderer:
        simulation = Simulation(near, scene, agent.needs, renderer)
        for _ in drive(simulation, agent):
            pass
    rollout = simulation.rollout(agent.name)
    assert rollout.end == "time"
    first, last = rollout.steps[0], rollout.steps[-2]
    assert first.notes["lead"]["class"] == "car"
    assert first.notes["lead"]["measured_gap_m"] == pytest.approx(22 - 2.33 - 2.3, abs=2.0)
    assert last.notes["lead"]["speed_m_s"] == pytest.approx(0.0, abs=1.2)
    assert last.ego.speed_m_s < 4.5

"""Closed-loop drives: the numbers of shipped scenarios, what ends a drive, and that it is the same every time."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.simulation.agents.base import SensorRequirements, Trajectory
from gsrain_engine.simulation.rollout_io import read_rollout, write_rollout
from gsrain_engine.simulation.simulation import Simulation, drive_scene, run_drive
from gsrain_engine.simulation.vehicle import Control
from gsrain_engine.simulation.vehicle_settings import BACKGROUND
from simulation.small_drive import StraightOn, box_actor, driven, in_other_units, lead, scenario, scene_with_box, track
from small_scene import small_scene


@pytest.fixture(scope="module")
def street():
    return load_built_in()


@pytest.mark.parametrize(
    ("name", "agent", "end", "steps", "ego", "users", "plans", "score"),
    [
        ("stationary-lead", "constant-velocity", "lead", 16, (18.75, 10.0), (41.3, 0.0), 17.5, 0.049603174603),
        ("stationary-lead", "oracle-idm", "time", 43, (25.298634618, 3.217573845), (41.3, 0), 4.264708614, 0.308693693),
        ("stationary-lead", "neuroncap-baseline", "lead", 19, (20.600328947, 7.828947368), (41.3, 0), 7.777777778,
         0.222525353),
        ("lead-braking", "constant-velocity", "lead", 22, (26.25, 10), (41.783522727, 7.204545455), 17.5, 0.171957672),
        ("lead-braking", "oracle-idm", "time", 61, (39.035883873, 3.262788585), (51.021926230, 2.598360656),
         4.805257110, 0.401021213),
        ("lead-braking", "neuroncap-baseline", "time", 61, (29.805840164, 2.577868852), (51.021926230, 2.598360656),
         2.49375, 0.352430556),
        ("idm-traffic", "constant-velocity", "van", 37, (36, 8), (50.710167951, 7.105050613), 14, 0.415343915),
        ("idm-traffic", "oracle-idm", "time", 81, (55.741250898, 4.175811047), (47.326710487, 5.516685656), 6.850596792,
         0.751303844),
        ("idm-traffic", "neuroncap-baseline", "time", 81, (52.429398148, 3.342592593), (46.625424150, 5.329465836),
         4.9, 0.535881696),
        ("cut-in", "constant-velocity", "lead", 21, (12.5, 5), (22.897718254, 3.870377978), 8.75, 0.066137566),
        ("cut-in", "oracle-idm", "time", 57, (18.451301298, 1.633077348), (27.678106725, 1.425928729), 2.398051849,
         0.180267874),
        ("cut-in", "neuroncap-baseline", "time", 57, (16.903508772, 1.456140351), (27.678106725, 1.425928729),
         1.9921875, 0.159246858),
    ],
)  # fmt: skip
def test_shipped_scenarios_drive_as_they_did(street, name, agent, end, steps, ego, users, plans, score):
    """Means over the steps: x and speed of the ego vehicle and of road users, planned distances; and the HD-score."""
    metrics, rollout = drive_scene(street, None, agent, name)
    assert (metrics.collided_with or rollout.end, len(rollout.steps)) == (end, steps)
    others = [user for step in rollout.steps for user in step.road_users]
    for records, expected in (([step.ego for step in rollout.steps], ego), (others, users)):
        assert np.mean([(each.x_m, each.speed_m_s) for each in records], axis=0) == pytest.approx(expected, rel=1e-8)
    assert np.mean([x for step in rollout.steps for x, _ in step.plan]) == pytest.approx(plans, rel=1e-8)
    assert metrics.hdscore == pytest.approx(score, abs=1e-8)


@pytest.mark.parametrize("start_m", [0.0, 1.5, 3.0, 4.5, 6.0])
@pytest.mark.parametrize("obstacle", ["wall", "lead", "follower"])
def test_a_fast_vehicle_does_not_jump_over_anything(obstacle, start_m):
    """40 m/s are 10 m a step, 24 m/s are 6 m, and the vehicle is 4.6 m long; a follower as fast is not hit."""
    user = lead(ahead_m=15.0 + start_m, size_lwh_m=[0.5, 0.5, 1.8], turned_deg=90.0)
    if obstacle == "follower":
        user = lead(ahead_m=-5.0 - start_m, speed_m_s=24.0, behaviour={"kind": "constant-velocity"})
    fields = {"speed_m_s": 24.0, "road_users": [user], "duration_s": 1.25}
    if obstacle == "wall":
        fields = {"speed_m_s": 40.0, "duration_s": 30, "ahead_m": start_m}
    rollout = driven(fields, replace(scene_with_box(), ego=track([0.0, 20.0], [(0, 0, 1.5), (200, 0, 1.5)])))
    hit = {"wall": BACKGROUND, "lead": "lead", "follower": None}[obstacle]
    assert (rollout.end, rollout.steps[-1].collision) == ("collision" if hit else "time", hit)


class _GivesUp(StraightOn):
    def plan(self, observation):
        return None if observation.step == 2 else super().plan(observation)


@pytest.mark.parametrize(
    ("fields", "agent", "end", "steps", "completion"),
    [
        ({"duration_s": 30}, StraightOn, "completed", 11, 1.0),
        ({"duration_s": 1.0}, StraightOn, "time", 5, 0.4),
        ({"left_m": 2.5, "leave_m": 2.0}, StraightOn, "off route", 1, 0.0),
        ({}, _GivesUp, "agent", 3, 0.2),
        # Bumpers meet after 8 - 2.3 - 2 = 3.7 m: within the fourth step of 1 m.
        ({"road_users": [lead(ahead_m=8.0)]}, StraightOn, "collision", 5, 0.4),
        ({"keep": "all", "duration_s": 2}, StraightOn, "time", 9, 0.8),  # a bridge passes overhead
    ],
)
def test_ends_of_a_drive(fields, agent, end, steps, completion):
    bridge = box_actor(positions=((8.0, 0.0, 4.5), (8.0, 0.0, 4.5)))
    rollout = driven(fields, replace(scene_with_box(), actors=(bridge,)), agent())
    assert (rollout.end, len(rollout.steps)) == (end, steps)
    assert [step.time_s for step in rollout.steps] == [0.25 * number for number in range(steps)]
    assert rollout.steps[-1].plan == () and all(step.collision is None for step in rollout.steps[:-1])
    assert rollout.steps[-1].route_completion == pytest.approx(completion)
    assert rollout.steps[0].route_left_m == pytest.approx(fields.get("left_m", 0.0))


@pytest.mark.parametrize(("name", "warns"), [("street", False), ("street:dusk", False), ("garden", True)])
def test_scenarios_of_the_street_warn_in_another_scene_but_at_no_hour(name, warns, caplog):
    Simulation(scenario(scene="street"), small_scene(name))
    assert ["made for the built-in street" in each.message for each in caplog.records] == [True] * warns


def test_wrong_plans_seeds_and_steps_after_the_end_are_refused():
    simulation = Simulation(scenario(duration_s=0.25), small_scene())
    simulation.reset()
    for points in ([[1.0, 0.0], [np.nan, 0.0]], [[1.0, 0.0], [1e9, 0.0]]):
        with pytest.raises(ValueError, match="plan"):
            simulation.step(Trajectory(np.array(points)))
    simulation.advance(Control(0.0, 0.0))
    for move in (lambda: simulation.advance(Control(0.0, 0.0)), lambda: simulation.step(None)):
        with pytest.raises(ValueError, match=r"\(time\)"):
            move()
    assert len(simulation.rollout("nobody").steps) == 2 and simulation.reset().step == 0
    for seed in (-1, 2**32):
        with pytest.raises(ValueError, match="seed"):
            Simulation(scenario(), small_scene(), seed=seed)


FIELDS = {
    "duration_s": 3.0,
    "keep": ["box"],
    "rain": {"intensity_mm_h": 8.5, "seed": 5},
    "road_users": [
        lead(id="one", ahead_m=15.0, speed_m_s=3.0, behaviour={"kind": "idm"}),
        lead(id="two", ahead_m=9.0, left_m=3.4, speed_m_s=4.0, behaviour={"kind": "cut-in", "after_s": 1.0}),
    ],
}


def test_drives_are_equal_byte_for_byte_again_at_one_go_and_from_a_file(tmp_path):
    simulation = Simulation(scenario(**FIELDS), scene_with_box())
    runs = [driven(FIELDS, scene_with_box()), *(run_drive(simulation, StraightOn()) for _ in range(2))]
    assert len({msgspec.json.encode(run) for run in runs}) == 1 and runs[0].seed == 5
    write_rollout(tmp_path / "run.jsonl", runs[0])
    assert read_rollout(tmp_path / "run.jsonl") == runs[0]
    assert simulation.reset(7).step == 0 and simulation.seed == 7
    simulation.advance(Control(0.0, 0.0))
    stopped = simulation.rollout("nobody")
    assert (stopped.end, stopped.seed, stopped.scenario["rain"]["seed"], len(stopped.steps)) == ("stopped", 7, 7, 2)


def test_a_scene_in_other_units_and_with_another_axis_up_drives_the_same():
    one, other = driven(FIELDS, scene_with_box()), driven(FIELDS, in_other_units(scene_with_box()))
    assert (one.end, len(one.steps)) == (other.end, len(other.steps))
    for a, b in zip(one.steps, other.steps, strict=True):
        for first, second in ((a.ego, b.ego), *zip(a.road_users, b.road_users, strict=True)):
            numbers = ([v for v in msgspec.structs.astuple(each) if isinstance(v, float)] for each in (first, second))
            np.testing.assert_allclose(*numbers, atol=2e-3)


# Cameras


class _Records(StraightOn):
    name = "records"
    needs = SensorRequirements(cameras=("front",), depth=True, semantic=True)

    def __init__(self):
        self.views = []

    def plan(self, observation):
        self.views.append(observation.views["FRONT"])
        return super().plan(observation)


def views(scene, fields):
    agent = _Records()
    with open_renderer("cpu") as renderer:
        driven({**fields, "duration_s": 0.5}, scene, agent, needs=agent.needs, renderer=renderer)
    return agent.views


def test_cameras_see_the_same_every_time_and_whatever_the_scenes_units():
    fields = {"road_users": [lead(ahead_m=14.0, left_m=1.0)], "rain": {"intensity_mm_h": 8.5}}
    one, same, other = (views(each, fields) for each in
                        (scene_with_box(), scene_with_box(), in_other_units(scene_with_box())))  # fmt: skip
    for a, repeated, b in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a.image, repeated.image)
        assert a.image.shape == (64, 96, 3)
        assert np.mean(np.abs(a.image.astype(int) - b.image.astype(int))) < 0.5
        there = (a.depth_m > 0) & (b.depth_m > 0)
        assert np.median(np.abs(a.depth_m - b.depth_m)[there]) < 0.01
        assert np.mean(a.semantic == b.semantic) > 0.99
        assert (a.instances == 1).sum() > 4 and (a.semantic[a.instances == 1] == 13).all()


def test_cameras_need_a_renderer_and_a_rig():
    blind = replace(small_scene(), rigs={})
    assert Simulation(scenario(), blind).rig.cameras == ()
    with pytest.raises(ValueError, match="draws"):
        Simulation(scenario(), small_scene(), SensorRequirements(cameras=("front",)))
    with open_renderer("cpu") as renderer:
        for name in ("front", "all", "FRONT"):
            with pytest.raises(ValueError, match="rig"):
                Simulation(scenario(), blind, SensorRequirements(cameras=(name,)), renderer)

"""The loop of a drive: who moves when, what ends it, and that it is the same every time."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.scene.scene import PoseTrack
from gsrain_engine.simulation.agents.base import SensorRequirements, Trajectory
from gsrain_engine.simulation.rollout import BACKGROUND
from gsrain_engine.simulation.rollout_io import read_rollout, write_rollout
from gsrain_engine.simulation.simulation import Simulation, drive, run_drive
from gsrain_engine.simulation.vehicle import Control
from simulation.small_drive import StraightOn, box_actor, driven, in_other_units, lead, scenario, scene_with_box
from small_scene import small_scene


def test_it_stops_where_a_road_user_is_touched():
    """Bumpers meet after 8 - 2.3 - 2 = 3.7 m: within the fourth step of 1 m."""
    rollout = driven({"road_users": [lead(ahead_m=8.0)], "duration_s": 10}, scene_with_box())
    assert rollout.end == "collision"
    last = rollout.steps[-1]
    assert (last.step, last.collision, last.plan) == (4, "lead", ())
    assert last.ego.x_m == pytest.approx(4.0)
    assert [step.collision for step in rollout.steps[:-1]] == [None] * 4
    assert [step.time_s for step in rollout.steps] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_who_passes_overhead_is_not_touched():
    bridge = box_actor(positions=((8.0, 0.0, 4.5), (8.0, 0.0, 4.5)))
    scene = replace(small_scene(), actors=(bridge,))
    assert driven({"keep": "all", "duration_s": 2}, scene).end == "time"
    below = box_actor(positions=((8.0, 0.0, 1.0), (8.0, 0.0, 1.0)))
    assert driven({"keep": "all", "duration_s": 2}, replace(scene, actors=(below,))).end == "collision"


def test_what_stands_there_is_hit_too():
    """The route ends at x = 10; a longer one leads into the wall at x = 40."""
    scene = small_scene()
    times = np.array([0.0, 20.0])
    far = PoseTrack(times, np.array([[0, 0, 1.5], [60.0, 0, 1.5]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    rollout = driven({"duration_s": 30}, replace(scene, ego=far))
    assert (rollout.end, rollout.steps[-1].collision) == ("collision", BACKGROUND)
    assert rollout.steps[-1].ego.x_m + 3.6 == pytest.approx(40.0, abs=1.3)


@pytest.mark.parametrize("start_m", [0.0, 1.5, 3.0, 4.5, 6.0])
def test_a_fast_vehicle_does_not_jump_over_what_stands_there(start_m):
    """40 m/s are 10 m a step, and the vehicle is 4.6 m long."""
    times = np.array([0.0, 20.0])
    places = np.array([[start_m, 0, 1.5], [200.0, 0, 1.5]])
    far = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    rollout = driven({"duration_s": 30, "speed_m_s": 40.0}, replace(small_scene(), ego=far))
    assert (rollout.end, rollout.steps[-1].collision) == ("collision", BACKGROUND)
    assert rollout.steps[-1].ego.x_m < 50


@pytest.mark.parametrize("start_m", [0.0, 1.2, 2.4, 3.6, 4.8, 6.0])
def test_a_fast_vehicle_does_not_jump_over_somebody_either(start_m):
    """24 m/s are 6 m a step; 4.6 m of vehicle and half a metre of somebody leave room for that."""
    times = np.array([0.0, 20.0])
    places = np.array([[0.0, 0, 1.5], [200.0, 0, 1.5]])
    far = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    somebody = lead(ahead_m=15.0 + start_m, size_lwh_m=[0.5, 0.5, 1.8], turned_deg=90.0)
    rollout = driven({"speed_m_s": 24.0, "road_users": [somebody]}, replace(scene_with_box(), ego=far))
    assert (rollout.end, rollout.steps[-1].collision) == ("collision", "lead")


def test_who_drives_behind_as_fast_is_not_hit():
    times = np.array([0.0, 20.0])
    far = PoseTrack(times, np.array([[0, 0, 1.5], [200.0, 0, 1.5]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    follower = lead(ahead_m=-5.0, speed_m_s=24.0, behaviour={"kind": "constant-velocity"})
    fields = {"speed_m_s": 24.0, "duration_s": 1.0, "road_users": [follower]}
    assert driven(fields, replace(scene_with_box(), ego=far)).end == "time"


def test_the_end_of_the_route_ends_it():
    rollout = driven({"duration_s": 30}, small_scene())
    assert rollout.end == "completed"
    assert rollout.steps[-1].route_completion == 1.0
    assert rollout.steps[-1].ego.x_m == pytest.approx(10.0)


def test_time_ends_it():
    rollout = driven({"duration_s": 1.0}, small_scene())
    assert (rollout.end, len(rollout.steps)) == ("time", 5)


def test_leaving_the_route_ends_it():
    rollout = driven({"left_m": 2.5, "leave_m": 2.0}, small_scene())
    assert (rollout.end, len(rollout.steps)) == ("off route", 1)
    assert rollout.steps[0].route_left_m == pytest.approx(2.5)


class _GivesUp(StraightOn):
    def plan(self, observation):
        return None if observation.step == 2 else super().plan(observation)


def test_an_agent_that_gives_up_ends_it():
    rollout = driven({}, small_scene(), _GivesUp())
    assert (rollout.end, len(rollout.steps)) == ("agent", 3)


def test_a_plan_that_is_none_is_refused():
    simulation = Simulation(scenario(), small_scene())
    simulation.reset()
    for points, words in (
        ([[1.0, 0.0], [np.nan, 0.0]], "points that are not finite"),
        ([[1.0, 0.0], [1e9, 0.0]], "farther than 10 km"),
    ):
        with pytest.raises(ValueError, match=words):
            simulation.step(Trajectory(np.array(points)))


def test_after_its_end_nothing_moves():
    simulation = Simulation(scenario(duration_s=0.25), small_scene())
    simulation.reset()
    simulation.advance(Control(0.0, 0.0))
    with pytest.raises(ValueError, match=r"the drive is over \(time\); reset it"):
        simulation.advance(Control(0.0, 0.0))
    with pytest.raises(ValueError, match=r"the drive is over \(time\); reset it"):
        simulation.step(None)
    assert len(simulation.rollout("nobody").steps) == 2
    assert simulation.reset().step == 0


def test_a_drive_that_was_stopped_is_on_record_as_it_stands():
    simulation, agent = Simulation(scenario(), small_scene()), StraightOn()
    for observation in drive(simulation, agent):
        if observation.step == 3:
            break
    rollout = simulation.rollout(agent.name)
    assert (rollout.end, rollout.steps[-1].step) == ("stopped", 3)


FIELDS = {
    "duration_s": 3.0,
    "keep": ["box"],
    "rain": {"intensity_mm_h": 8.5},
    "road_users": [
        lead(id="one", ahead_m=15.0, speed_m_s=3.0, behaviour={"kind": "idm"}),
        lead(id="two", ahead_m=9.0, left_m=3.4, speed_m_s=4.0, behaviour={"kind": "cut-in", "after_s": 1.0}),
    ],
}


def test_two_runs_are_equal_byte_for_byte(tmp_path):
    files = []
    for name in ("one", "other"):
        files.append(tmp_path / f"{name}.jsonl")
        write_rollout(files[-1], driven(FIELDS, scene_with_box(), seed=3))
    assert files[0].read_bytes() == files[1].read_bytes()
    assert read_rollout(files[0]).seed == 3


def test_a_second_drive_of_the_same_simulation_is_equal_to_the_first():
    simulation, agent = Simulation(scenario(**FIELDS), scene_with_box()), StraightOn()
    runs = []
    for _ in "ab":
        for _ in drive(simulation, agent):
            pass
        runs.append(msgspec.json.encode(simulation.rollout(agent.name)))
    assert runs[0] == runs[1]


def test_a_scene_in_other_units_and_with_another_axis_up_drives_the_same():
    one, other = driven(FIELDS, scene_with_box()), driven(FIELDS, in_other_units(scene_with_box()))
    assert (one.end, len(one.steps)) == (other.end, len(other.steps))
    for a, b in zip(one.steps, other.steps, strict=True):
        np.testing.assert_allclose(msgspec.structs.astuple(a.ego), msgspec.structs.astuple(b.ego), atol=2e-3)
        for first, second in zip(a.road_users, b.road_users, strict=True):
            assert first.id == second.id
            np.testing.assert_allclose(
                msgspec.structs.astuple(first)[1:], msgspec.structs.astuple(second)[1:], atol=2e-3
            )


class _Sees(StraightOn):
    name = "sees"
    needs = SensorRequirements(cameras=("front",), depth=True, semantic=True)

    def __init__(self):
        self.views = []

    def plan(self, observation):
        self.views.append(observation.views["FRONT"])
        return super().plan(observation)


def seen(scene, fields):
    agent = _Sees()
    with open_renderer("cpu") as renderer:
        driven({**fields, "duration_s": 0.5}, scene, agent, needs=agent.needs, renderer=renderer)
    return agent.views


def test_cameras_see_the_same_whatever_the_scene_s_units():
    fields = {"road_users": [lead(ahead_m=14.0, left_m=1.0)]}
    one, other = seen(scene_with_box(), fields), seen(in_other_units(scene_with_box()), fields)
    assert len(one) == 2
    for a, b in zip(one, other, strict=True):
        assert a.image.shape == (64, 96, 3)
        difference = np.abs(a.image.astype(int) - b.image.astype(int))
        assert np.mean(difference) < 0.5
        there = (a.depth_m > 0) & (b.depth_m > 0)
        assert np.median(np.abs(a.depth_m - b.depth_m)[there]) < 0.01
        assert np.mean(a.semantic == b.semantic) > 0.99
        assert (a.instances == 1).sum() > 4
        assert (a.semantic[a.instances == 1] == 13).all()


def test_pictures_are_the_same_every_time():
    fields = {**FIELDS, "keep": []}
    for a, b in zip(seen(scene_with_box(), fields), seen(scene_with_box(), fields), strict=True):
        np.testing.assert_array_equal(a.image, b.image)


def test_an_agent_that_needs_pictures_gets_a_renderer_or_a_word():
    with pytest.raises(ValueError, match="the agent needs pictures, and there is nothing that draws them"):
        Simulation(scenario(), small_scene(), SensorRequirements(cameras=("front",)))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"rig": "six"}, "has no rig 'six', only one"),
        ({"start_s": 0.0, "keep": ["bus"]}, "has no actor 'bus' to keep, only box"),
        ({"keep": ["box"], "road_users": [lead(id="box")]}, "'box' is called like an actor that it keeps"),
        ({"road_users": [lead(model="tank")]}, "model tank: no such file"),
    ],
)
def test_what_a_scene_lacks_is_said(fields, words):
    with pytest.raises(ValueError, match=words):
        Simulation(scenario(**fields), scene_with_box())


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"start_s": 6.0}, "at 6 s the drive of scene 'small' is over; it ends at 5 s"),
        ({"start_s": float("nan")}, "at nan s the drive of scene 'small' is over"),
        ({"ahead_m": 10.0}, "it starts where the route of scene 'small' ends"),
    ],
)
def test_a_start_after_which_nothing_is_left_to_be_driven_is_refused(fields, words):
    with pytest.raises(ValueError, match=words):
        Simulation(scenario(**fields), small_scene())


def test_the_seed_is_the_scenario_s_unless_another_is_given():
    rainy = scenario(rain={"intensity_mm_h": 8.5, "seed": 5})
    assert Simulation(rainy, small_scene()).rollout("nobody").seed == 5
    other = Simulation(rainy, small_scene(), seed=0)
    assert other.seed == other.rollout("nobody").scenario["rain"]["seed"] == 0


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_that_there_is_not_is_refused(seed):
    with pytest.raises(ValueError, match=r"must be within 0\.\.4294967295"):
        Simulation(scenario(), small_scene(), seed=seed)


def test_a_scene_without_a_rig_shows_nothing_and_says_so():
    blind = replace(small_scene(), rigs={})
    assert Simulation(scenario(), blind).rig.cameras == ()
    with pytest.raises(ValueError, match="has no rig 'six', only none"):
        Simulation(scenario(rig="six"), blind)
    with open_renderer("cpu") as renderer:
        for name in ("front", "all", "FRONT"):
            with pytest.raises(ValueError, match="the scene has no rig of cameras"):
                Simulation(scenario(), blind, SensorRequirements(cameras=(name,)), renderer)


def test_a_scene_without_a_drive_is_refused():
    with pytest.raises(ValueError, match="has no drive to follow"):
        Simulation(scenario(), replace(small_scene(), ego=None))


def test_the_rig_is_as_high_as_the_scene_has_it():
    """A data set whose vehicle frame lies on the ground: cameras hang where they hung when it was recorded."""
    scene = small_scene()
    assert scene.ego is not None
    low = replace(scene, ego=replace(scene.ego, positions=scene.ego.positions - [0, 0, 1.5]))
    simulation = Simulation(scenario(), low)
    simulation.reset()
    assert simulation.rig_to_world[2, 3] == pytest.approx(0.0, abs=0.01)
    assert simulation.rig.height_m == pytest.approx(0.0, abs=0.01)


def test_a_drive_at_one_go_is_the_drive_step_by_step():
    simulation, agent = Simulation(scenario(road_users=[lead(ahead_m=8.0)]), scene_with_box()), StraightOn()
    for _ in drive(simulation, agent):
        pass
    stepwise = simulation.rollout(agent.name)
    assert run_drive(simulation, agent) == stepwise and stepwise.end == "collision"

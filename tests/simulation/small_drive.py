"""A scenario in the small scene, and a driver that goes straight on: what tests of the loop share."""

from dataclasses import replace

import msgspec
import numpy as np

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.rigs import driving_rigs
from gsrain_engine.scene.scene import Actor, PoseTrack, Scene
from gsrain_engine.simulation.agents.base import SensorRequirements, Trajectory
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.simulation import Simulation, drive
from small_scene import patch, small_scene


class StraightOn:
    """Plans to keep its speed, straight ahead."""

    name = "straight-on"
    needs = SensorRequirements()

    def reset(self, seed, rig):
        pass

    def plan(self, observation):
        return Trajectory(np.array([[observation.state.speed_m_s * 0.5 * (k + 1), 0.0] for k in range(6)]))

    def close(self):
        pass


def scenario(**fields):
    """A drive at 4 m/s; fields as a file states them."""
    base = {"name": "test", "speed_m_s": 4.0, "controller": {"kind": "pure-pursuit"}, "picture_width_px": 96}
    return msgspec.convert({**base, **fields}, Scenario)


def lead(**fields):
    """A road user; a cheap model."""
    base = {"id": "lead", "model": "actor:box", "behaviour": {"kind": "stationary"}}
    return {**base, **fields}


def track(times, positions):
    """A track through positions at times, without a turn."""
    n = len(times)
    return PoseTrack(np.array(times), np.array(positions, float), np.tile([1.0, 0, 0, 0], (n, 1)), np.ones(n, bool))


def box_actor(id="box", positions=((5.0, 3.0, 0.0), (13.0, 3.0, 0.0)), times=(0.0, 4.0)):
    """A red block of 4 x 2 x 1.5 m that moves along +x."""
    flank = patch((-2, -1, 0), np.array([4.0, 0, 0]), np.array([0, 0, 1.5]), 8, (0.8, 0.1, 0.1))
    rear = patch((-2, -1, 0), np.array([0, 2.0, 0]), np.array([0, 0, 1.5]), 8, (0.8, 0.1, 0.1))
    return Actor(id, "car", (4.0, 2.0, 1.5), Gaussians.concatenate([flank, rear]), track(times, positions))


def scene_with_box():
    """The small scene with an actor in it, on a road so thin that it shows nothing in front of itself."""
    scene = small_scene()
    road = patch((0, -6, 0), np.array([40.0, 0, 0]), np.array([0, 12.0, 0]), 60, (0.35, 0.33, 0.30))
    road = replace(road, scales=np.tile(np.array([0.45, 0.14, 0.002], np.float32), (len(road), 1)))
    return replace(scene.with_member("layers/road", gaussians=road), actors=(box_actor(),))


def in_other_units(scene):
    """Return the same scene in half meters with y up."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    to_scene = np.eye(4)
    to_scene[:3, :3] = 2 * turn
    layers = tuple(replace(layer, to_scene=to_scene @ layer.to_scene) for layer in scene.layers)
    actors = tuple(
        replace(
            actor,
            track=actor.track.moved(to_scene),
            size_lwh=tuple(2 * side for side in actor.size_lwh),
            gaussians=replace(actor.gaussians, means=2 * actor.gaussians.means, scales=2 * actor.gaussians.scales),
        )
        for actor in scene.actors
    )
    ego = None if scene.ego is None else scene.ego.moved(to_scene)
    return Scene(scene.name, layers, actors, metres_per_unit=0.5, up=(0.0, 1.0, 0.0), ground_m=scene.ground_m,
                 rigs=scene.rigs, ego=ego)  # fmt: skip


def driven(fields, scene, agent=None, **options):
    """Drive a scenario to its end; returns the roll-out."""
    agent = agent or StraightOn()
    simulation = Simulation(scenario(**fields), scene, **options)
    for _ in drive(simulation, agent):
        pass
    return simulation.rollout(agent.name)


def longer_scene():
    """The small scene with a recorded drive of 30 m, and a front and a back camera of nuScenes'."""
    ego = track(np.arange(6.0), [(6 * second, 0, 1.5) for second in range(6)])
    two = tuple(each for each in driving_rigs()["nuscenes"] if each.name in ("CAM_FRONT", "CAM_BACK"))
    return replace(small_scene(), ego=ego, rigs={"nuscenes": two})

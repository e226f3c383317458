"""A drive on the small scene's road, driven once for all tests that play it."""

from dataclasses import replace
from functools import cache

import msgspec

from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.simulation import Simulation, drive
from small_scene import small_scene

CRASH = {
    "name": "crash",
    "speed_m_s": 2.0,
    "duration_s": 6.0,
    "road_users": [{"id": "lead", "ahead_m": 9.0, "behaviour": {"kind": "constant-velocity"}}],
}
"""Gap 4.4 m between the bumpers, closed at 2 m/s: it is hit after a little more than 2 s."""


@cache
def driven(intensity_mm_h=8.5, start_s=0.0, scale=1.0):
    """A scene with a length of its unit, and the roll-out of the crash in it."""
    rain = {"intensity_mm_h": intensity_mm_h}
    scenario = msgspec.convert(CRASH | {"rain": rain, "start_s": start_s}, Scenario)
    scene = scaled(small_scene(), scale)
    simulation, agent = Simulation(scenario, scene), open_agent("constant-velocity")
    for _ in drive(simulation, agent):
        pass
    return scene, simulation.rollout(agent.name)


def scaled(scene, metres_per_unit):
    """The same world in other units."""
    unit = 1 / metres_per_unit
    layers = tuple(
        replace(each, gaussians=replace(each.gaussians, means=each.gaussians.means * unit,
                                        scales=each.gaussians.scales * unit))
        for each in scene.layers
    )  # fmt: skip
    ego = replace(scene.ego, positions=scene.ego.positions * unit)
    return replace(scene, layers=layers, ego=ego, metres_per_unit=metres_per_unit)


def settled(editor):
    """Wait for what is read and written."""
    while editor.rollouts.is_working:
        editor.background.wait(60)
        editor.tick(0.0)

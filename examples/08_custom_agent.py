"""Shows your own agent in a closed loop, next to a built-in one, and which of them stops for the car in its lane.

    python examples/08_custom_agent.py [OUT] [SCENE]

SCENE is a scene folder with the track of an ego vehicle, such as one that was reconstructed from a recorded drive.
In a package of your own, `[project.entry-points."gsrain.agents"]` with `two-seconds = "my_package:open_two_seconds"`
registers it for `gsrain drive --agent two-seconds` and for sweeps; `open_two_seconds(options)` returns the agent.
"""

import sys
from pathlib import Path

import numpy as np
from msgspec import structs

from gsrain import load_scenario
from gsrain_engine.scene.open import load_scene
from gsrain_engine.simulation.agents.base import SPACING_S, Observation, Rig, SensorRequirements, Trajectory
from gsrain_engine.simulation.agents.registry import open_agent
from gsrain_engine.simulation.metrics.summary import ScoredRun, compare_drives, results_table
from gsrain_engine.simulation.rollout_io import write_rollout
from gsrain_engine.simulation.simulation import Simulation, run_drive


class TwoSecondsAgent:
    """Keeps a gap of two seconds plus four meters to the vehicle ahead in its lane."""

    name = "two-seconds"
    needs = SensorRequirements()  # with cameras=("front",), `observation.views` has rainy images

    def reset(self, seed: int, rig: Rig) -> None:
        """Start a drive."""
        self._front_m = rig.vehicle.front_m  # from the rear axle to the front bumper

    def plan(self, observation: Observation) -> Trajectory:
        """Return the positions in 0.5, 1.0, ... 3.0 s: x forward and y left of the vehicle, in meters."""
        others = [observation.state.from_world(user.box.corners) for user in observation.road_users]
        gaps = [float(box[:, 0].min()) - self._front_m for box in others if np.abs(box[:, 1]).min() < 1.5]
        gap_m = min((gap for gap in gaps if gap > 0), default=np.inf)
        speed_m_s = min(observation.state.speed_m_s, max(gap_m - 4.0, 0.0) / 2.0)
        way = observation.route_ahead(reach_m=60.0, step_m=0.25)  # one point every 25 cm
        reached = speed_m_s * SPACING_S * np.arange(1, 7) / 0.25
        return Trajectory(way[np.minimum(reached.round().astype(int), len(way) - 1)], {"gap_m": gap_m})

    def close(self) -> None:
        """Nothing to release."""


out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scenario = load_scenario("stationary-lead")
scenario = structs.replace(scenario, scene=sys.argv[2] if len(sys.argv) > 2 else "street")
simulation = Simulation(scenario, load_scene(scenario.scene))
out.mkdir(parents=True, exist_ok=True)
runs: list[ScoredRun] = []
for agent in (open_agent("constant-velocity"), TwoSecondsAgent()):
    rollout = run_drive(simulation, agent)
    write_rollout(out / f"{agent.name}.jsonl", rollout)  # can be played in the window
    runs.append(ScoredRun.of(rollout, simulation.occupied))
print(results_table(compare_drives(runs)).text)

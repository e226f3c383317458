"""Time of a step with a HUGSIM client: rendering and sending. Prints JSON, then lines.

The client is a process that reads an observation and answers at once; the street in the rain, six cameras, 800 x 450.
"""

import argparse
import json
import shlex
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import msgspec

from gsrain_engine.backends import open_renderer
from gsrain_engine.render.renderer import Renderer, describe_machine
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.agents.base import Observation
from gsrain_engine.simulation.interop.hugsim_agent import HugsimAgent
from gsrain_engine.simulation.interop.hugsim_protocol import with_hugsim_rig
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation

_CLIENT = """
import pickle, sys
answer = pickle.dumps([[0.0, float(k)] for k in range(6)])
while True:
    with open(sys.argv[1] + "/obs_pipe", "rb") as pipe:
        message = pickle.load(pipe)
        pipe.read()
    if message == "Done":
        break
    with open(sys.argv[1] + "/plan_pipe", "wb") as pipe:
        pipe.write(answer)
"""
_KINDS = {"rgb": (False, False), "rgb, depth": (False, True), "rgb, depth, semantic": (True, True)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="street")
    parser.add_argument("--backend", default="auto")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    scene = load_sorted_scene(arguments.scene)
    with open_renderer(arguments.backend) as renderer:
        rows = [_row(name, scene, renderer, arguments.repeats) for name in _KINDS]
    print(json.dumps({"scene": arguments.scene, "rows": rows, "machine": describe_machine()}, indent=1))
    for row in rows:
        print(f"{row['sent']}: drawn in {row['draw_ms']:.0f} ms, sent and answered in {row['exchange_ms']:.0f} ms")


def _row(name: str, scene: Scene, renderer: Renderer, repeats: int) -> dict[str, str | float]:
    semantic, depth = _KINDS[name]
    scenario, shown = with_hugsim_rig(load_scenario("stationary-lead"), scene)
    rainy = msgspec.structs.replace(scenario, rain=msgspec.structs.replace(scenario.rain, intensity_mm_h=8.5))
    with tempfile.TemporaryDirectory() as folder:
        command = shlex.join([sys.executable, "-c", _CLIENT])
        agent = HugsimAgent(Path(folder), command, semantic=semantic, depth=depth)
        simulation = Simulation(rainy, shown, agent.needs, renderer)
        observation = simulation.reset()
        agent.reset(0, simulation.rig)
        agent.plan(observation)
        drawn, exchanged = zip(*(_step(simulation, agent) for _ in range(repeats)), strict=True)
        agent.close()
    return {"sent": name, "draw_ms": 1e3 * median(drawn), "exchange_ms": 1e3 * median(exchanged)}


def _step(simulation: Simulation, agent: HugsimAgent) -> tuple[float, float]:
    start = time.perf_counter()
    observation: Observation = simulation.observation()
    drawn = time.perf_counter()
    agent.plan(observation)
    return drawn - start, time.perf_counter() - drawn


if __name__ == "__main__":
    main()

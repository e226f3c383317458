"""Cost of spray: frames of the street behind fast vehicles in rain, with and without it, in turn."""

import argparse
import json
import time

import msgspec
import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.simulation.agents.base import NOTHING
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from gsrain_engine.water.spray import spray_of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="spray-cut-in")
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--rain", type=float, default=8.5)
    parser.add_argument("--steps", type=int, default=8, help="of the scenario before the frame")
    parser.add_argument("--frames", type=int, default=7)
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    simulation = Simulation(scenario, load_sorted_scene(scenario.scene), NOTHING)
    simulation.reset()
    for _ in range(options.steps):
        simulation.advance(Control(0.0, 0.0))
    scene, rig = simulation.scene_now, simulation.rig_to_world
    camera = simulation.rig.cameras[0].camera(rig).resized(960, 640)
    time_s = options.steps * scenario.step_s
    view = RenderView(camera, time_s, scenario.speed_m_s * rig[:3, 0])
    base = RainSettings(intensity_mm_h=options.rain)
    rains = {
        name: RainSimulation.start(msgspec.structs.replace(base, spray=name == "spray")) for name in ("none", "spray")
    }
    taken: dict[str, list[float]] = {name: [] for name in rains}
    stages: dict[str, dict[str, float]] = {}
    with open_renderer(options.backend) as renderer:
        sky = sky_color(renderer, scene, camera).at(1.0)
        for number in range(options.frames + 1):
            for name, rainfall in rains.items():
                start = time.perf_counter()
                draw(renderer, FrameInput.of(scene, rainfall, sky, view))
                renderer.read()
                if number:  # the first frame compiles
                    taken[name].append(1000 * (time.perf_counter() - start))
                stages[name] = dict(renderer.statistics.stages_ms)
    start = time.perf_counter()
    parcels = spray_of(scene, rains["spray"], time_s)
    own_ms = 1000 * (time.perf_counter() - start)
    print(json.dumps({
        "parcels": len(parcels), "parcels_ms": round(own_ms, 2),
        "frame_ms_min": {name: round(float(np.min(each)), 1) for name, each in taken.items()},
        "ratio": round(float(np.min(taken["spray"]) / np.min(taken["none"])), 3), "stages_ms": stages,
    }))  # fmt: skip


if __name__ == "__main__":
    main()

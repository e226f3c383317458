"""Detection of a car that cuts in and lidar returns over time, with its spray and without.

`python -m benchmarks.spray_detection yolox_nano.onnx` drives the scenario straight ahead, detects the lead in the front
camera every `--every` seconds, and scans with a lidar every second; rows of `--json` have all of it.
"""

import argparse
import json
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.detection.detector import open_detector
from gsrain_engine.evaluation.detection.ground_truth import ground_truth_from_scene
from gsrain_engine.evaluation.detection.metrics import match_detections
from gsrain_engine.evaluation.lidar.scan import ReturnOutcome, scan_in_rain, scene_turns
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from gsrain_engine.water.spray import spray_of

NEEDS = SensorRequirements(cameras=("front",))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("detector", type=Path)
    parser.add_argument("--scenario", default="spray-cut-in")
    parser.add_argument("--rain", default="8.5,25")
    parser.add_argument("--every", type=float, default=0.25)
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--lead", default="lead")
    parser.add_argument("--lidar", default="64")
    parser.add_argument("--confidence", type=float, default=0.3)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scenario = msgspec.structs.replace(
        load_scenario(options.scenario), step_s=options.every, picture_width_px=options.width
    )
    scene, detector, rows = load_sorted_scene(scenario.scene), open_detector(options.detector), []
    with open_renderer("cpu") as renderer:
        for rate in map(float, options.rain.split(",")):
            for seed in range(options.seeds):
                for spray in (False, True):
                    rain = msgspec.structs.replace(scenario.rain, intensity_mm_h=rate, spray=spray, seed=seed)
                    test = msgspec.structs.replace(scenario, rain=rain)
                    rows += _run(Simulation(test, scene, NEEDS, renderer), renderer, detector, options)
    for rate in sorted({row["intensity_mm_h"] for row in rows}):
        for spray in (False, True):
            mine = [row for row in rows if (row["intensity_mm_h"], row["spray"]) == (rate, spray)]
            found = [row["confidence"] >= options.confidence for row in mine]
            seconds = np.array([int(row["time_s"]) for row in mine])
            by_second = [round(float(np.mean(np.array(found)[seconds == each])), 2) for each in np.unique(seconds)]
            confidence = np.mean([row["confidence"] for row in mine])
            lidar = [row for row in mine if "lidar_lead" in row]
            print(f"{rate:g} mm/h, {'spray' if spray else 'no spray'}: recall {np.mean(found):.2f}, by second "
                  f"{by_second}, mean confidence {confidence:.2f}; lidar: on the lead "
                  f"{[row['lidar_lead'] for row in lidar]}, false {[row['lidar_false'] for row in lidar]}")  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def _run(simulation, renderer, detector, options):
    rows, scenario = [], simulation.scenario
    rainfall, sensor = RainSimulation.start(scenario.rain), SENSORS[options.lidar]
    simulation.reset()
    while simulation.end is None:
        observation = simulation.observation()
        (view,), scene = observation.views.values(), simulation.scene_now
        lead = [each for each in scene_objects(scene) if each.id == options.lead]
        truths = ground_truth_from_scene(renderer, scene, lead, view.camera, 0.0)
        row = {"intensity_mm_h": scenario.rain.intensity_mm_h, "seed": scenario.rain.seed,
               "spray": scenario.rain.spray, "time_s": observation.time_s}  # fmt: skip
        if truths:
            (match,) = match_detections(truths, detector.detect(view.image))
            row |= {"confidence": match.confidence_any_class, "distance_m": truths[0].distance_m}
            if observation.time_s % 1 < 1e-9 and scenario.rain.seed == 0:
                row |= _scan(scene, rainfall, sensor, scenario.start_s + observation.time_s, observation.road_users)
            rows.append(row)
        if options.pictures and scenario.rain.seed == 0:
            options.pictures.mkdir(parents=True, exist_ok=True)
            name = f"{scenario.rain.intensity_mm_h:g}_{'spray' if scenario.rain.spray else 'none'}"
            Image.fromarray(view.image).save(options.pictures / f"{name}_{observation.time_s:.2f}.png")
        simulation.advance(Control(0.0, 0.0))
    return rows


def _scan(scene, rainfall, sensor, time_s, users):
    """Returns on the first road user and false returns of one turn."""
    (turn,) = scene_turns(scene, sensor, [time_s])
    rainy = scan_in_rain(turn.beams, sensor, rainfall, turn.anchor_to_world, spray=spray_of(scene, rainfall, time_s))
    user, points = users[0], turn.beams.points_m.astype(np.float64)
    local = (points - [user.x_m, user.y_m, user.z_m]) @ user.pose[:3, :3]
    half = np.array([user.size_lwh[0] / 2 + 0.2, user.size_lwh[1] / 2 + 0.2, user.size_lwh[2] + 0.2])
    on_lead = np.all(np.abs(local) <= half, axis=1) & (local[:, 2] > 0.15) & turn.beams.is_echo
    kept = rainy.fates[on_lead] == ReturnOutcome.KEPT
    return {"lidar_lead": int(kept.sum()), "lidar_lead_clear": int(on_lead.sum()),
            "lidar_false": int(rainy.is_false.sum())}  # fmt: skip


if __name__ == "__main__":
    main()

"""A sweep that takes seconds: short drives down a short road towards a standing car."""

from dataclasses import replace

import msgspec
import numpy as np
import yaml

from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import PoseTrack
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.settings import DriveSweep
from small_scene import small_scene


def write_road(folder):
    """A scene folder; the ego drives 10 m/s for 3 s."""
    times = np.arange(4.0)
    places = np.stack([10 * times, np.zeros(4), np.full(4, 1.5)], axis=1)
    ego = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (4, 1)), np.ones(4, bool))
    scene = replace(small_scene("road"), ego=ego)
    write_scene(scene, folder)
    return folder


def write_scenario(file, scene, **changes):
    scenario = {
        "name": file.stem,
        "scene": str(scene),
        "speed_m_s": 5.0,
        "duration_s": 1.0,
        "road_users": [
            {"id": "lead", "ahead_m": 15.0, "speed_m_s": 0.0, "behaviour": {"kind": "constant-velocity"}},
        ],
        **changes,
    }
    file.write_text(yaml.safe_dump(scenario))
    return file


def sweep_of(scenarios, **changes):
    settings = {"kind": "drive", "scenarios": [str(each) for each in scenarios], "agents": ["constant-velocity"],
                "intensities_mm_h": [0, 8.5], "seeds": 2, "jitter": {"ahead_m": 1.0}, "backend": "cpu"}  # fmt: skip
    return msgspec.convert(settings | changes, DriveSweep)


def small_jobs(folder, **changes):
    """Jobs on a road of their own; four unless changed."""
    return jobs_of(sweep_of([write_scenario(folder / "short.yaml", write_road(folder / "road"))], **changes))

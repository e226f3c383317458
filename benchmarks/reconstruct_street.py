"""Quality of `gsrain reconstruct` on the built-in street, from 30 views of its drive. Prints JSON.

480x320, every eighth view is held out: the front camera every 2 m, or all three cameras of the rig every 3.3 m, of
which the ones at the sides see much from two places only. Once with the depth that the street's capture has, as a lidar
would tell it, and once with pictures and cameras alone.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.training.data import ReconstructionTask
from gsrain_engine.training.settings import load_settings
from gsrain_engine.training.train import reconstruct
from gsrain_extras.street.ground_truth import capture_street

WIDTH, HEIGHT = 480, 320
VIEWS = 30
LAST_S = {1: 6.0, 3: 3.0}
"""Duration of the drive by number of cameras; 10 m/s."""
RIG = "waymo_front3"


def street_capture(with_depth: bool, camera_count: int) -> Capture:
    """Photograph the street from its rig while it drives."""
    scene = load_built_in()
    cameras: list[Camera] = []
    times: list[float] = []
    for time_s in np.linspace(0.0, LAST_S[camera_count], VIEWS // camera_count).tolist():
        for mounted in scene.rigs[RIG][:camera_count]:
            cameras.append(rig_camera(scene, RIG, mounted.name, time_s).resized(WIDTH, HEIGHT))
            times.append(time_s)
    capture = capture_street(cameras, times)
    if with_depth:
        return capture
    return replace(capture, views=tuple(replace(view, depth_source=None, sky_source=None) for view in capture))


def measured(capture: Capture, folder: Path, **changes: Any) -> dict[str, Any]:
    """Reconstruct, and return the figures."""
    task = ReconstructionTask(capture=folder, output=folder / "scene", settings=load_settings(None, **changes))
    work = reconstruct(task, capture)
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value.numbers


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--gaussians", type=int)
    parser.add_argument("--depth", choices=("with", "without", "both"), default="both")
    parser.add_argument("--cameras", type=int, choices=(1, 3), default=1)
    parser.add_argument("--output", type=Path, help="keep the scenes in this folder")
    arguments = parser.parse_args()
    results = dict[str, Any]()
    with tempfile.TemporaryDirectory() as temporary:
        for name in ("with", "without") if arguments.depth == "both" else (arguments.depth,):
            folder = (arguments.output or Path(temporary)) / f"{name}_depth"
            folder.mkdir(parents=True, exist_ok=True)
            results[f"{name} depth"] = measured(
                street_capture(name == "with", arguments.cameras),
                folder,
                steps=arguments.steps,
                gaussians=arguments.gaussians,
            )
    print(json.dumps({"results": results, "machine": describe_machine()}, indent=1))


if __name__ == "__main__":
    main()

"""Shows how to fly a camera of one's own through the rain and film it: up and forward, with the eye on the road.

    python examples/04_camera_path.py [OUT] [SCENE]

What is recorded here, the window records in its Record panel, and `gsrain render` with --camera-path.
"""

import sys
from pathlib import Path

import numpy as np

from gsrain_engine.api import (
    Camera,
    CameraPath,
    Rain,
    Recording,
    film,
    home_camera,
    look_at,
    open_renderer,
    open_scene,
    write_camera_path,
)

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = open_scene(sys.argv[2] if len(sys.argv) > 2 else "street")

# Cameras are in the world: metres, z up. The first one stands where the scene is first looked at from.
home, up = home_camera(scene, 480, 320), np.array([0.0, 0.0, 1.0])
eye, ahead = home.position, home.camera_to_world[:3, 2]
eyes = [eye, eye + 4 * ahead + 1.5 * up, eye + 10 * ahead + 5 * up]
cameras = [Camera.from_fov(480, 320, 50.0, look_at(each, eye + 30 * ahead, up)) for each in eyes]
path = CameraPath.through([0.0, 1.0, 2.0], cameras)

recording = Recording(output=str(out / "flight.mp4"), size_px=(480, 320), fps=10)
with open_renderer() as renderer:
    for progress in film(renderer, recording, scene, Rain(intensity_mm_h=8.5), path):
        print(progress.message)

# Files hold paths in the scene's own units and axes, not in the world.
write_camera_path(out / "flight.json", path.moved(np.linalg.inv(scene.scene_to_world)))
print(recording.output)

"""Shows how to fly a camera of one's own through the rain and film it: up and forward, with the eye on the road.

    python examples/04_camera_path.py [OUT] [SCENE]

What is recorded here, the window records in its Record panel, and `gsrain render` with --camera-path.
"""

import sys
from pathlib import Path

import numpy as np

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.render.backends import open_renderer
from gsrain_engine.render.record import record
from gsrain_engine.render.recorded_views import frame_numbers, sequences_of
from gsrain_engine.render.recording import Recording
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_files import write_camera_path
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.session.view.home_camera import home_camera

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = open_to_draw(sys.argv[2] if len(sys.argv) > 2 else "street")

# Cameras are in the world: metres, z up. The first one stands where the scene is first looked at from.
home, up = home_camera(scene, 480, 320), np.array([0.0, 0.0, 1.0])
eye, ahead = home.position, home.camera_to_world[:3, 2]
eyes = [eye, eye + 4 * ahead + 1.5 * up, eye + 10 * ahead + 5 * up]
cameras = [Camera.from_fov(480, 320, 50.0, look_at(each, eye + 30 * ahead, up)) for each in eyes]
path = CameraPath.through([0.0, 1.0, 2.0], cameras)

recording = Recording(output=str(out / "flight.mp4"), size_px=(480, 320), fps=10)
rainfall = Rainfall.start(Rain(intensity_mm_h=8.5))
sequences = sequences_of(recording, scene, rainfall, path, in_scene_time=True)
with open_renderer() as renderer:
    for progress in record(renderer, recording, sequences, frame_numbers(recording, sequences)):
        print(progress.message)

# Files hold paths in the scene's own units and axes, not in the world.
write_camera_path(out / "flight.json", path.moved(np.linalg.inv(scene.scene_to_world)))
print(recording.output)

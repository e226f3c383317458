"""Shows how to define a camera path through the rain and record a video: up and forward, looking at the road.

    python examples/04_camera_path.py [OUT] [SCENE]

The Record panel of the window and `gsrain render` with --camera-path can record the same video.
"""

import sys
from pathlib import Path

import numpy as np

import gsrain as gr

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = gr.load(sys.argv[2] if len(sys.argv) > 2 else "street")

# Cameras are in world coordinates: meters, z up. The first one is the scene's initial view.
home, up = gr.home_camera(scene), np.array([0.0, 0.0, 1.0])
eye, ahead = home.position, home.camera_to_world[:3, 2]
eyes = [eye, eye + 4 * ahead + 1.5 * up, eye + 10 * ahead + 5 * up]
cameras = [gr.Camera.from_fov(480, 320, 50.0, gr.look_at(each, eye + 30 * ahead, up)) for each in eyes]
path = gr.CameraPath.through([0.0, 1.0, 2.0], cameras)

video = gr.render_video(
    scene, gr.Rain(8.5), path, out / "flight.mp4", size=(480, 320), fps=10, progress=lambda step: print(step.message)
)
path.save(out / "flight.json", scene)  # in the scene's own units and axes, as --camera-path expects
print(video)

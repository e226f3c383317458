"""Shows how to control the window from a program: increases the rain in steps and takes a screenshot of each.

    python examples/11_viewer.py [OUT] [SCENE]

It needs a display. The window runs in its own process, so the program continues while it is open. Meanwhile, a person
can move the camera and change the rain; `viewer.camera` and `viewer.rain` return the current values.
"""

import sys
from pathlib import Path

import gsrain as gr

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = gr.load(sys.argv[2] if len(sys.argv) > 2 else "street")

with gr.Viewer(scene, camera=gr.home_camera(scene)) as viewer:  # closes with the block; viewer.wait() would wait
    for intensity in (0, 5, 12):
        viewer.rain = gr.Rain(intensity)
        print(viewer.screenshot(out / f"{intensity}mm_h.png"))
    print(f"it rains {viewer.rain.intensity_mm_h:g} mm/h at {viewer.camera.position.round(1)}")

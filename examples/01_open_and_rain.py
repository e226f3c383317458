"""Shows the shortest way to a rainy picture: opens a scene and draws it dry and at 8.5 mm/h.

    python examples/01_open_and_rain.py [OUT] [SCENE]

SCENE is a file or folder that `gsrain` opens (3DGS .ply, .spz, .splat, .sog, a scene folder); without it the built-in
street.
"""

import sys
from pathlib import Path

from gsrain_engine.api import Rain, home_camera, open_renderer, open_scene, render_still, write_picture

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = open_scene(sys.argv[2] if len(sys.argv) > 2 else "street")
camera = home_camera(scene, 960, 640)

with open_renderer() as renderer:
    for intensity_mm_h in (0.0, 8.5):
        frame = render_still(renderer, scene, Rain(intensity_mm_h=intensity_mm_h), camera)
        picture = out / f"rain_{intensity_mm_h:g}mm_h.png"
        write_picture(picture, frame.to_uint8())
        print(picture)

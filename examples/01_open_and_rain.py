"""Shows how to render a rainy image in a few lines: opens a scene and renders it dry and at 8.5 mm/h.

    python examples/01_open_and_rain.py [OUT] [SCENE]

SCENE is a file or folder that `gsrain` opens (3DGS .ply, .spz, .splat, .sog, a scene folder); the default is the
built-in street.
"""

import sys
from pathlib import Path

import gsrain as gr

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = gr.load(sys.argv[2] if len(sys.argv) > 2 else "street")

for intensity in (0.0, 8.5):
    picture = out / f"rain_{intensity:g}mm_h.png"
    gr.render(scene, gr.Rain(intensity)).save(picture)
    print(picture)

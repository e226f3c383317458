"""Shows a scene that has become wet, with darker ground under a cloudy sky: clear, after the shower, and in it.

    python examples/07_wet.py [OUT] [SCENE]

No weights and no torch are needed: the look is computed from light, depth and normals.
"""

import sys
from pathlib import Path

from gsrain_engine.api import (
    Rain,
    finished,
    home_camera,
    open_renderer,
    open_scene,
    render_still,
    wet_scene,
    write_picture,
    write_scene,
)

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = open_scene(sys.argv[2] if len(sys.argv) > 2 else "street")
wet = finished(wet_scene(scene), lambda step: print(f"{step.fraction:4.0%} {step.message}"))
write_scene(wet, out / "wet")  # `gsrain out/wet` opens it; the intensity then moves drops and colours together

weathers = {
    "clear": Rain(intensity_mm_h=0.0),
    "wet": Rain(intensity_mm_h=0.0, wetness=1.0),  # after the shower
    "rainy": Rain(intensity_mm_h=8.5),  # as wet as a road is after a while at 8.5 mm/h
}
with open_renderer() as renderer:
    for name, rain in weathers.items():
        frame = render_still(renderer, wet, rain, home_camera(wet, 960, 640))
        write_picture(out / f"{name}.png", frame.to_uint8())
        print(out / f"{name}.png")

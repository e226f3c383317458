"""Shows a scene that has become wet, with darker ground under a cloudy sky: clear, after the shower, and in it.

    python examples/07_wet.py [OUT] [SCENE]

No weights and no torch are needed: the look is computed from light, depth and normals.
"""

import sys
from pathlib import Path

from gsrain_engine.rain.rain import Rain
from gsrain_engine.reconstruct.wet_scene import wet_scene
from gsrain_engine.render.backends import open_renderer
from gsrain_engine.render.pictures import write_picture
from gsrain_engine.render.still import render_still
from gsrain_engine.scene.formats import write_scene
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.progress import finished
from gsrain_engine.session.view.home_camera import home_camera

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = open_to_draw(sys.argv[2] if len(sys.argv) > 2 else "street")
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

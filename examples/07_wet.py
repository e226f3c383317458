"""Shows how to make a scene wet, with darker ground under a cloudy sky: clear, after the shower, and during it.

    python examples/07_wet.py [OUT] [SCENE]

It needs neither weights nor torch: the look is computed from light, depth and normals.
"""

import sys
from pathlib import Path

import gsrain as gr

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = gr.load(sys.argv[2] if len(sys.argv) > 2 else "street")
wet = gr.wet(scene, progress=lambda step: print(f"{step.fraction:4.0%} {step.message}"))
gr.save(wet, out / "wet")  # `gsrain out/wet` opens it; the intensity then changes drops and colors together

weathers = {
    "clear": gr.Rain(),
    "wet": gr.Rain(wetness=1.0),  # after the shower
    "rainy": gr.Rain(8.5),  # as wet as a road is after a while at 8.5 mm/h
}
for name, rain in weathers.items():
    gr.render(wet, rain).save(out / f"{name}.png")
    print(out / f"{name}.png")

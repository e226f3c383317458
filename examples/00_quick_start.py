"""Shows the Python API on one page: make a scene wet, add rain, render images and a video, run a driving agent.

    python examples/00_quick_start.py [OUT] [SCENE]

SCENE is a file or folder that `gsrain` opens; the default is the built-in street. The drive needs a scene whose ego
vehicle has a recorded drive, like the street's.
"""

import sys
from pathlib import Path

import gsrain as gr

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = gr.load(sys.argv[2] if len(sys.argv) > 2 else "street")  # a bare .ply: gr.load(path, up="-y", scale=0.5)
rain = gr.Rain(intensity=8.5, wind=(2, 0), seed=1)  # mm/h, m/s; gr.Rain.preset("paper") has the paper's settings
wet = gr.wet(scene)  # a wet road under a cloudy sky; takes seconds, needs no weights

image = gr.render(wet, rain, size=(480, 320), time=2.0)
image.save(out / "rain.png")
print(f"{image}: mean color {image.rgb.mean(axis=(0, 1)).round()}, up to {image.depth.max():.0f} m away")

path = gr.CameraPath.orbit(scene, seconds=1)
print(gr.render_video(wet, rain, path, out / "rain.mp4", size=(480, 320), fps=5, clear_pair="sunny"))
for number, frame in enumerate(gr.frames(wet, rain, path, size=(480, 320), fps=5)):  # arrays; writes no files
    print(f"frame {number}: {frame.linear.mean():.3f} of white on average")

print(f"the drops on screen carry {gr.measure_rain(rain, seconds=60)}")

run = gr.drive(wet, rain, agent="oracle-idm")
run.save(out / "run.jsonl")  # can be played in the window
print(f"the driver {'has collided' if run.metrics.collided else 'has stopped in time'}")

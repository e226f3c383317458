"""Shows how to recolor a scene from edited images: views of it are turned to dusk, and its colors fitted to them.

    python examples/06_recolor.py [OUT] [SCENE]

Any program can make the images: a diffusion model, an image editor. `gsrain transfer` writes views to a folder, and
`gsrain recolor --images` reads images from one; its option `--refine` also moves the Gaussians, and needs torch.
"""

import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from gsrain import RainSettings
from gsrain_engine.appearance.scene_views import chosen_cameras, scene_views
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.recolor.recolor import recolor_scene
from gsrain_engine.recolor.result import with_colors
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.render.images import write_png
from gsrain_engine.render.sequence import render_image
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_scene
from gsrain_engine.scene.progress import run_to_end


def dusk(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """Darken an image, reds the most; bright areas stay bright."""
    return (image ** np.array([2.2, 1.9, 1.5])).astype(np.float32)


out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = load_scene(sys.argv[2] if len(sys.argv) > 2 else "street")
views = scene_views(scene, chosen_cameras(scene, ViewChoice(count=8, width_px=240)))
targets = [TargetView(view.name, view.camera, view.time_s, dusk(view.image)) for view in views]

settings = RecolorSettings(iterations=8, sh_degree=1, exposure=False)  # the look has the same exposure in every view
recolored = run_to_end(recolor_scene(scene, targets[:4] + targets[5:], targets[4:5], settings))
for view in recolored.measured:
    print(f"{view.name}, which was held out: {view.psnr_clear_db:.1f} dB before, {view.psnr_db:.1f} dB now")

at_dusk = with_colors(scene, recolored.colors)  # in addition to the clear colors: the rain's wetness blends them
write_scene(at_dusk, out / "at_dusk")
with open_renderer() as renderer:
    for wetness in (0.0, 1.0):
        frame = render_image(renderer, at_dusk, RainSettings(wetness=wetness), home_camera(scene, 480, 320))
        write_png(out / f"dusk_{wetness:g}.png", frame.to_uint8())

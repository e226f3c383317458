"""Shows what each scene format keeps: writes a scene in every writable format, reads it back and renders it.

    python examples/05_convert.py [OUT] [SCENE]

`gsrain convert IN OUT` converts the same way; its help lists the formats that can only be read.
"""

import sys
from pathlib import Path

from gsrain import RainSettings
from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.evaluation.image_metrics import psnr
from gsrain_engine.render.sequence import render_image
from gsrain_engine.scene.formats.registry import writable_suffixes
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.open import load_scene

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = load_scene(sys.argv[2] if len(sys.argv) > 2 else "street")
camera = home_camera(scene, 480, 320)

with open_renderer() as renderer:
    original = render_image(renderer, scene, RainSettings(), camera).over()
    for suffix in writable_suffixes():
        file = out / f"scene{suffix}"
        write_scene(scene, file)  # all layers in one file; a name without a suffix would be a scene folder
        again = load_scene(file)
        picture = render_image(renderer, again, RainSettings(), camera).over()
        size = file.stat().st_size / again.gaussian_count
        print(f"{file}: {size:.1f} bytes a Gaussian, {psnr(picture, original):.1f} dB")

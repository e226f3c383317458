"""Pictures against an independent CPU rasterizer's, by EGL here and by OSMesa in a process of its own."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.context import open_context
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.scene.camera import read_camera
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.scene import DrawItem

CASES = {"street_sh3": "golden/street_sh3.ply", "plant": "data/scenes/plant.splat"}
LEAST_PSNR_DB = 50.0


def psnr_db(golden: Path, case: str, renderer: Renderer) -> float:
    """PSNR of a case, in the file's own axes, as the reference was made."""
    layer = read_scene(golden.parent / CASES[case]).layers[0]
    camera = read_camera(golden / f"{case}.camera.json")
    renderer.draw([DrawItem(layer.gaussians, np.eye(4))], camera)
    reference = np.load(golden / f"{case}.reference.npz")["rgb"].astype(np.float32)
    return float(-10 * np.log10(np.mean((renderer.read().rgba[..., :3] - reference) ** 2)))


@pytest.mark.parametrize("case", CASES)
def test_golden_with_egl_and_without_opengl(context, golden, case):
    assert psnr_db(golden, case, SplatRenderer(context)) >= LEAST_PSNR_DB
    assert psnr_db(golden, case, CpuRenderer()) >= 60


def test_golden_with_osmesa(golden):
    """OSMesa wants a process without EGL: this file runs itself."""
    try:
        done = subprocess.run(
            [sys.executable, __file__, str(golden)], capture_output=True, text=True, timeout=300, check=True
        )
    except subprocess.CalledProcessError as error:
        if "OSMesa" in error.stderr and "cannot open shared object" in error.stderr:
            pytest.skip("libOSMesa is not installed (Debian 12: libosmesa6)")
        raise AssertionError(error.stderr) from error
    figures = dict(line.split() for line in done.stdout.splitlines())
    assert set(figures) == set(CASES)
    assert all(float(figure) >= LEAST_PSNR_DB for figure in figures.values()), figures


if __name__ == "__main__":
    with open_context("osmesa") as osmesa:
        for name in CASES:
            print(name, psnr_db(Path(sys.argv[1]), name, SplatRenderer(osmesa)))

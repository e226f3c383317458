"""The cuda back end's own parts, around a stand-in for gsplat on torch's CPU."""

import importlib.util

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install gsrain[jobs]")

from gsrain_engine import backends
from gsrain_engine.backends import NoCudaError, open_renderer
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.cuda import SLABS, split_into_depth_slabs
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from render.cpu.raster_scenes import drawn, psnr_db, random_gaussians, small_camera


@pytest.mark.parametrize("field", ["means", "scales", "quaternions", "opacities", "sh"])
def test_what_is_not_finite_is_left_out(open_kind, field):
    g = random_gaussians(60)
    arrays = {name: getattr(g, name).copy() for name in ("means", "scales", "quaternions", "opacities", "sh")}
    arrays[field].reshape(60, -1)[7, 0] = np.nan
    expected = drawn(CpuRenderer(), g.take(np.delete(np.arange(60), 7)))
    assert psnr_db(drawn(open_kind("cuda"), Gaussians(**arrays)), expected) > 80


def test_other_looks_are_refused(open_kind):
    with pytest.raises(ValueError, match="normals"):
        drawn(open_kind("cuda"), [], look="normals")


def test_slabs_weigh_the_same():
    splats = project([DrawItem(random_gaussians(3000), np.eye(4))], small_camera())
    slabs = split_into_depth_slabs(splats)
    assert len(slabs.starts) == len(slabs.edges_m) == SLABS + 1
    assert (slabs.starts[0], slabs.starts[-1]) == (0, len(splats.nearest_first())) == (0, len(slabs.shapes))
    assert (np.diff(slabs.edges_m) >= 0).all()
    shapes = slabs.shapes.astype(np.float64)
    weights = np.exp(shapes[:, 5]) / np.sqrt(shapes[:, 3] * shapes[:, 4])
    of_slab = np.add.reduceat(weights, slabs.starts[:-1])
    assert np.abs(of_slab - weights.sum() / SLABS).max() <= weights.max()
    none = split_into_depth_slabs(project([DrawItem(Gaussians.empty(), np.eye(4))], small_camera()))
    assert (len(none.shapes), len(none.edges_m)) == (0, SLABS + 1)


@pytest.mark.parametrize("missing", ["torch", "gsplat"])
def test_what_is_missing_is_named(missing, monkeypatch):
    found = {"torch", "gsplat"} - {missing}
    monkeypatch.setattr(backends.importlib.util, "find_spec", lambda name: object() if name in found else None)
    with pytest.raises(NoCudaError, match=missing), open_renderer("cuda"):
        pass


@pytest.mark.gpu
@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed: gsrain[cuda]")
def test_gsplat_draws_the_same():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no NVIDIA GPU")
    gaussians = random_gaussians(3000, 1, 3)
    with open_renderer("cuda") as renderer:
        found = drawn(renderer, gaussians)
    assert psnr_db(found, drawn(CpuRenderer(), gaussians)) >= 50

"""Wet colors on the processor and in torch: blends of two sets of harmonics, at both ends the very bytes of either."""

import numpy as np
import pytest

from gsrain_engine.render.cpu.projection import FEW
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.scene.transforms import blend_wet_sh
from oracles.rasterizer import rasterize_slowly
from rasterized import rasterize

from .raster_scenes import random_gaussians, small_camera
from .test_marked_parts import COLORS, some_of

HERE = np.eye(4)


def wet_part(count=300, degree=1, **fields) -> DrawItem:
    wet_sh = np.random.default_rng(3).normal(0, 0.5, (count, (degree + 1) ** 2, 3)).astype(np.float32)
    return DrawItem(random_gaussians(count, 1, degree), HERE, wet_sh=wet_sh, **fields)


def blended(part: DrawItem) -> DrawItem:
    """The same picture without wet colors."""
    sh = blend_wet_sh(part.gaussians.sh, part.wet_sh, part.wetness)
    return part._replace(gaussians=part.gaussians.with_sh(sh), wet_sh=None, wetness=0.0)


def cuda_renderer():
    pytest.importorskip("torch", reason="torch is not installed: pip install gsrain[jobs]")
    from gsrain_engine.render.cuda import CudaRenderer
    from render.cuda.gsplat_stand_in import rasterization

    return CudaRenderer(rasterization, "cpu")


@pytest.fixture(params=["cpu", "cuda"])
def renderer(request):
    return CpuRenderer() if request.param == "cpu" else cuda_renderer()


def drawn(renderer, part: DrawItem, **options):
    renderer.draw([part], small_camera(), **options)
    return renderer.read().rgba


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [300, FEW + 40])
def test_the_ends_are_the_very_bytes(renderer, degree, count):
    part = wet_part(count, degree)
    clear = drawn(renderer, part._replace(wet_sh=None)).tobytes()
    assert drawn(renderer, part._replace(wetness=0.0)).tobytes() == clear
    soaked = drawn(renderer, part._replace(wetness=1.0)).tobytes()
    assert soaked == drawn(renderer, blended(part._replace(wetness=1.0))).tobytes()
    assert soaked != clear


@pytest.mark.parametrize("wetness", [0.2, 0.7])
def test_between_the_ends_harmonics_are_blended(renderer, wetness):
    part = wet_part(degree=3, wetness=wetness)
    np.testing.assert_allclose(drawn(renderer, part), drawn(renderer, blended(part)), atol=2e-6)


@pytest.mark.parametrize(
    "fields",
    [{"colors": COLORS}, {"selected": some_of(300)}, {"left_out": some_of(300)}, {"limit": 120, "growth": 1.5}],
)
def test_marks_colours_and_limits_come_on_top(renderer, fields):
    part = wet_part(wetness=0.6, **fields)
    np.testing.assert_allclose(drawn(renderer, part), drawn(renderer, blended(part)), atol=2e-6)
    assert np.abs(drawn(renderer, part) - drawn(renderer, part._replace(wetness=0.0))).max() > 0.05


def test_the_slow_reference_says_the_same():
    part, camera = wet_part(60, 3, wetness=0.35, colors=COLORS), small_camera()
    slow = rasterize_slowly([part], camera)
    np.testing.assert_allclose(rasterize([part], camera).rgba, slow[..., :4], atol=2e-4)


def test_what_has_no_finite_wet_colour_is_left_out(renderer):
    part = wet_part(wetness=0.5)
    part.wet_sh[7, 1, 2], part.wet_sh[9, 0, 0] = np.nan, np.inf
    left_out = some_of(300)
    left_out.words[:] = 0
    left_out.words[0] = 1 << 7 | 1 << 9
    expected = drawn(renderer, part._replace(left_out=left_out))
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(drawn(renderer, part), expected, atol=1e-6)
    assert np.isfinite(drawn(renderer, part._replace(wetness=0.0))).all()

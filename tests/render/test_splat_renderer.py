import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.opengl.sort import DepthSort
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from render.cpu.raster_scenes import drawn

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)


def gaussians(means, scales=0.1, opacities=0.9, colors=(1.0, 0.5, 0.25)):
    means = np.atleast_2d(np.array(means, np.float32))
    n = len(means)
    return Gaussians(
        means,
        np.broadcast_to(np.array(scales, np.float32), (n, 3)).copy(),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.broadcast_to(np.array(opacities, np.float32), (n,)).copy(),
        sh_from_color(np.broadcast_to(np.array(colors, np.float32), (n, 3)).copy()),
    )


@pytest.fixture
def renderer(context):
    return SplatRenderer(context)


def cloud(count, coefficients=1):
    """Gaussians by chance, half transparent."""
    rng = np.random.default_rng(3)
    set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (count, 3)), 0.1, 0.5)
    return set_.with_sh(rng.normal(0, 0.3, (count, coefficients, 3)).astype(np.float32))


def draw(renderer, set_, **options):
    return drawn(renderer, set_, camera=CAMERA, **options)


def test_a_gaussian_is_where_and_as_bright_as_the_formula_says(renderer):
    frame = draw(renderer, gaussians([0.3, -0.2, 2.0], 0.05, 0.8))
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    u, v = 50 * 0.3 / 2 + 32, 50 * -0.2 / 2 + 24
    # J of the local affine approximation, at the Gaussian's own direction
    j = np.array([[25, 0, -25 * 0.15], [0, 25, 25 * 0.1]])
    covariance = j @ j.T * 0.05**2 + 0.3 * np.eye(2)
    d = np.stack([x - u, y - v], axis=-1)
    alpha = 0.8 * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, np.linalg.inv(covariance), d))
    alpha[alpha < 1 / 255] = 0
    half = 0.8 * 2.0**-12  # splats keep their largest alpha in 16 bits
    assert np.abs(frame.rgba[..., 3] - alpha).max() < 1.1 * half
    assert np.allclose(frame.rgba[..., :3], alpha[..., None] * [1.0, 0.5, 0.25], atol=1.1 * half)


NAN, INF = float("nan"), float("inf")
extents = st.sampled_from([0.0, 1e-30, 1e-6, 1e-3, 1.0, 10.0, 1e4, 1e30, INF, NAN])
places = st.sampled_from([-1e30, -1e6, -1.0, 0.0, 0.1999, 0.2, 0.2001, 3.0, 1e6, 1e30, NAN, INF])
alphas = st.sampled_from([0.0, 1e-6, 1 / 255, 0.5, 1.0, NAN])
turns = st.sampled_from([-1.0, 0.0, 0.5, 1.0, NAN])
colors = st.sampled_from([-1e30, -1.0, 0.0, 1.0, 1e4, 1e30, NAN, INF])


@given(
    st.tuples(places, places, places), st.tuples(extents, extents, extents), alphas, st.tuples(*[turns] * 4), colors,
)  # fmt: skip
@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_degenerate_gaussians_leave_the_picture_finite_and_the_same(renderer, mean, scales, opacity, turn, color):
    good = gaussians([[0, 0, 2.0], [0.3, 0.1, 4.0]])
    bad = gaussians([mean], scales, opacity, (color,) * 3)
    bad = dataclasses.replace(bad, quaternions=np.array([turn], np.float32))
    both = Gaussians.concatenate([bad, good])
    first, drawn = draw(renderer, both, with_depth=True), renderer.statistics.splats_drawn
    assert np.isfinite(first.rgba).all()
    assert np.isfinite(first.depth).all()
    assert draw(renderer, both, with_depth=True).rgba.tobytes() == first.rgba.tobytes()
    if drawn == len(good):
        assert first.rgba.tobytes() == draw(renderer, good).rgba.tobytes()


def test_splats_lie_in_several_blocks_as_far_as_the_driver_allows(context, monkeypatch):
    whole = draw(SplatRenderer(context), cloud(3000)).rgba
    for slots, count in ((1024, 3000), (256, 1024)):
        monkeypatch.setitem(context.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 32 * slots)
        renderer = SplatRenderer(context)
        assert count < 3000 or draw(renderer, cloud(3000)).rgba.tobytes() == whole.tobytes()
        draw(renderer, gaussians(np.full((count, 3), 2.0)))
    with pytest.raises(MemoryError, match="1280 Gaussians"):
        draw(renderer, gaussians(np.full((1025, 3), 2.0)))


def test_sorting_on_the_gpu_draws_the_same(context, monkeypatch):
    """Also where the processor would sort, since OpenGL is software."""
    by_host = draw(SplatRenderer(context), cloud(9000)).rgba
    monkeypatch.setattr("gsrain_engine.render.opengl.renderer.CpuSort", DepthSort)
    by_gpu = SplatRenderer(context)
    assert draw(by_gpu, cloud(9000)).rgba.tobytes() == by_host.tobytes()
    assert by_gpu.statistics.splats_drawn > 3000


def test_harmonics_in_fewer_bits_show_nearly_the_same_and_change_their_storage_in_place(context):
    renderer = SplatRenderer(context)
    for coefficients in (1, 4, 9, 16):
        set_ = cloud(500, coefficients)
        exact = draw(SplatRenderer(context, harmonics="single"), set_).rgba
        for harmonics, tolerance in (("half", 2e-3), ("byte", 2e-2)):
            renderer.arrays.keep_harmonics_as(harmonics)
            small = draw(renderer, set_).rgba
            assert 0 < np.abs(small - exact).max() < tolerance
        renderer.arrays.keep_harmonics_as("single")
        assert draw(renderer, set_).rgba.tobytes() == exact.tobytes()


def test_uploading_in_slices_shows_the_same_and_giving_it_up_keeps_what_is_shown(renderer, context):
    set_, other = cloud(5000), cloud(300)
    steps = list(renderer.arrays.upload(set_, slice_size=1000))
    assert len(steps) == 20
    assert steps[-1] == 1.0
    assert draw(renderer, set_).rgba.tobytes() == draw(SplatRenderer(context), set_).rgba.tobytes()
    slices = renderer.arrays.upload(other, slice_size=100)
    for _ in range(7):  # two arrays, and a third of the third
        next(slices)
    slices.close()
    renderer.arrays.release_awaited()
    assert (renderer.arrays.missing(set_), renderer.arrays.missing(other)) == (0, 300)
    assert len(list(renderer.arrays.upload(other, slice_size=100))) == 12

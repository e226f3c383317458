import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from given_rain import given_rain
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.opengl.sort import DepthSort
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import DrawItem

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


def rain(gaussians, mixing="linear", light=(0.5, 0.5, 0.5)):
    return given_rain(gaussians, np.array(light, np.float32), mixing)


@pytest.fixture
def renderer(context):
    return SplatRenderer(context)


def draw(renderer, set_, camera=CAMERA, **options):
    renderer.draw([DrawItem(set_, np.eye(4))], camera, **options)
    return renderer.read()


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


def test_camera_scaling_and_turning_the_world_changes_nothing(renderer):
    """A similarity on the scene and on the camera cancels: units and axes of a capture don't show."""
    set_ = gaussians([[0.1, 0.05, 2.0], [-0.2, 0.1, 3.0]], [0.2, 0.05, 0.1])
    similarity = np.array([[0, 0, 2.0, 5], [-2.0, 0, 0, 6], [0, -2.0, 0, 7], [0, 0, 0, 1]])
    plain = draw(renderer, set_)
    renderer.draw([DrawItem(set_, similarity)], CAMERA.moved(similarity), with_depth=True)
    moved = renderer.read()
    assert np.allclose(moved.rgba, plain.rgba, atol=1e-5)
    assert moved.depth is not None
    assert moved.depth[24, 34] == pytest.approx(4.0, rel=0.1)  # meters: twice the scene's units


@pytest.mark.parametrize("mixing", ["linear", "display"])
def test_empty_rain_is_no_rain_to_the_byte(renderer, mixing):
    set_ = gaussians([[0, 0, 2.0]], 0.5)
    clear = draw(renderer, set_).rgba
    assert draw(renderer, set_, rain=rain(Gaussians.empty(), mixing)).rgba.tobytes() == clear.tobytes()


def wall(grey):
    """A wall that fills the picture, alpha 0.999 everywhere."""
    return gaussians([0, 0, 20.0], [2000.0, 2000.0, 0.01], 1.0, (grey, grey, grey))


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


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_needles_of_1_to_10000_are_as_thin_as_a_pixel(renderer, axis):
    """Along x or y a needle crosses the picture, no thicker than its dilation; along z it is a dot."""
    scales = [1e-3, 1e-3, 1e-3]
    scales[axis] = 10.0
    alpha = draw(renderer, gaussians([0.01, 0.01, 5.0], scales, 1.0)).rgba[..., 3]
    columns, rows = (alpha > 0.02).any(axis=0).sum(), (alpha > 0.02).any(axis=1).sum()
    assert (columns, rows) == {0: (64, rows), 1: (columns, 48), 2: (columns, rows)}[axis]
    assert (rows if axis == 0 else columns) <= 6


def with_blocks_of(context, monkeypatch, slots):
    monkeypatch.setitem(context.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 32 * slots)
    return SplatRenderer(context)


def test_splats_in_several_blocks_are_drawn_the_same(context, monkeypatch):
    rng = np.random.default_rng(3)
    set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (3000, 3)), 0.1, 0.5)
    whole = draw(SplatRenderer(context), set_).rgba
    assert draw(with_blocks_of(context, monkeypatch, 1024), set_).rgba.tobytes() == whole.tobytes()


def test_too_many_gaussians_say_so(context, monkeypatch):
    renderer = with_blocks_of(context, monkeypatch, 256)
    draw(renderer, gaussians(np.full((1024, 3), 2.0)))
    with pytest.raises(MemoryError, match=r"1280 Gaussians need .* of storage blocks; this OpenGL driver allows 4 of"):
        draw(renderer, gaussians(np.full((1025, 3), 2.0)))


def test_only_the_first_are_drawn_where_a_part_says_so(renderer):
    set_ = gaussians([[0, 0, 2.0], [0.5, 0, 2.0]])
    renderer.draw([DrawItem(set_, np.eye(4), 1)], CAMERA)
    assert renderer.statistics.gaussians == 1
    assert renderer.read().rgba.tobytes() == draw(renderer, set_.take(slice(0, 1))).rgba.tobytes()


def test_sorting_on_the_gpu_draws_the_same(context, monkeypatch):
    """Also where the processor would sort, since OpenGL is software."""
    rng = np.random.default_rng(3)
    set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (9000, 3)), 0.1, 0.5)
    by_host = draw(SplatRenderer(context), set_).rgba
    monkeypatch.setattr("gsrain_engine.render.opengl.renderer.CpuSort", DepthSort)
    by_gpu = SplatRenderer(context)
    assert draw(by_gpu, set_).rgba.tobytes() == by_host.tobytes()
    assert by_gpu.statistics.splats_drawn > 3000


@pytest.mark.parametrize(("harmonics", "tolerance"), [("half", 2e-3), ("byte", 2e-2)])
def test_smaller_harmonics_show_nearly_the_same(context, harmonics, tolerance):
    rng = np.random.default_rng(3)
    for coefficients in (1, 4, 9, 16):
        set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (500, 3)), 0.1, 0.5)
        set_ = set_.with_sh(rng.normal(0, 0.3, (500, coefficients, 3)).astype(np.float32))
        exact = draw(SplatRenderer(context, harmonics="single"), set_).rgba
        small = draw(SplatRenderer(context, harmonics=harmonics), set_).rgba
        assert 0 < np.abs(small - exact).max() < tolerance


def test_harmonics_change_their_storage_in_place(context):
    rng = np.random.default_rng(3)
    set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (500, 3)), 0.1, 0.5)
    set_ = set_.with_sh(rng.normal(0, 0.3, (500, 4, 3)).astype(np.float32))
    renderer = SplatRenderer(context)
    for harmonics in ("byte", "single", "half"):
        draw(renderer, set_)
        renderer.arrays.keep_harmonics_as(harmonics)
        fresh = SplatRenderer(context, harmonics=harmonics)
        assert draw(renderer, set_).rgba.tobytes() == draw(fresh, set_).rgba.tobytes()


def test_uploading_in_slices_shows_the_same(context):
    rng = np.random.default_rng(5)
    set_ = gaussians(rng.uniform([-2, -1, 1], [2, 1, 9], (5000, 3)), 0.1, 0.5)
    renderer = SplatRenderer(context)
    steps = list(renderer.arrays.upload(set_, slice_size=1000))
    assert len(steps) == 20
    assert steps[-1] == 1.0
    sliced = draw(renderer, set_).rgba
    assert sliced.tobytes() == draw(SplatRenderer(context), set_).rgba.tobytes()

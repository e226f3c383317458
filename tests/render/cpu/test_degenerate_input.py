"""Degenerate Gaussians, as some scenes contain."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from given_rain import given_rain
from gsrain_engine.choices import RenderMode
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.cpu.splats import NEAR_M
from gsrain_engine.render.renderer import Frame
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from oracles.rasterizer import rasterize_slowly

from .raster_scenes import drawn, random_gaussians, small_camera

COUNT = 40
HERE = np.eye(4)
FIELDS = ("means", "scales", "quaternions", "opacities", "sh")
LOOKS: tuple[RenderMode, ...] = ("splats", "points", "ellipsoids", "normals", "opacity", "overdraw")

just_before, just_behind = (float(np.nextafter(np.float32(NEAR_M), np.float32(end))) for end in (0, 1))
strange_numbers = st.sampled_from(
    [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 1e-30, 1e12, 1e19, 3e38, -3e38, 1.0, -1.0, just_before, just_behind]
)
changes = st.lists(
    st.tuples(st.sampled_from(FIELDS), st.integers(0, COUNT - 1), st.integers(0, 11), strange_numbers),
    min_size=1,
    max_size=8,
)


def changed(gaussians: Gaussians, what: list[tuple[str, int, int, float]]) -> Gaussians:
    arrays = {name: getattr(gaussians, name).copy() for name in FIELDS}
    for name, row, column, value in what:
        flat = arrays[name].reshape(COUNT, -1)
        flat[row, column % flat.shape[1]] = value
    return Gaussians(**arrays)


def picture(gaussians: Gaussians, *arguments, **options) -> Frame:
    return drawn(CpuRenderer(), gaussians, *arguments, with_depth=True, **options)


@pytest.mark.parametrize("kind", ["cpu", "opengl"])
@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(what=changes, look=st.sampled_from(LOOKS), model=st.sampled_from([None, "physical", "paper"]))
@example(what=[("means", 0, 2, just_before), ("means", 1, 2, just_behind)], look="splats", model=None)
def test_pictures_stay_finite_and_repeat_themselves(open_kind, kind, what, look, model):
    """Also with strange rain."""
    renderer = open_kind(kind)
    gaussians, rain = changed(random_gaussians(COUNT, 1, 1), what), None
    if model is not None:
        drops = changed(random_gaussians(COUNT, 2, 1), [each for each in what if each[0] != "sh"])
        rain = given_rain(drops, np.ones(3, np.float32), model)
    with_depth = kind == "cpu" or look == "splats"
    frame, again = (drawn(renderer, gaussians, rain, mode=look, with_depth=with_depth) for _ in range(2))
    assert np.isfinite(frame.rgba).all()
    assert not with_depth or np.isfinite(frame.depth).all()
    assert frame.rgba.min() >= 0
    assert frame.rgba[..., 3].max() <= 1 + 1e-5
    assert frame.rgba.tobytes() == again.rgba.tobytes()
    assert not with_depth or frame.depth.tobytes() == again.depth.tobytes()


@settings(max_examples=60)
@given(what=changes)
def test_what_is_left_out_leaves_the_others_alone(what):
    gaussians = changed(random_gaussians(COUNT, 1, 1), what)
    splats = project([DrawItem(gaussians, HERE)], small_camera())
    seen = np.sort(splats.indices[splats.nearest_first()])
    np.testing.assert_array_equal(picture(gaussians).rgba, picture(gaussians.take(seen)).rgba)
    touched = {row for _, row, _, _ in what}
    whole = project([DrawItem(random_gaussians(COUNT, 1, 1), HERE)], small_camera())
    visible = set(whole.indices[whole.nearest_first()].tolist())
    assert visible - touched == set(seen.tolist()) - touched


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", FIELDS)
def test_what_is_not_finite_is_left_out(field, value):
    gaussians = random_gaussians(COUNT, 1, 1)
    for column in range(getattr(gaussians, field).reshape(COUNT, -1).shape[1]):
        frame = picture(changed(gaussians, [(field, 7, column, value)]))
        if field == "opacities" and value == np.inf:  # opaque, no more
            expected = picture(changed(gaussians, [(field, 7, 0, 1.0)]))
        else:
            expected = picture(gaussians.take(np.delete(np.arange(COUNT), 7)))
        np.testing.assert_array_equal(frame.rgba, expected.rgba)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    longest=st.sampled_from([0.1, 1.0, 30.0]),
    opacity=st.sampled_from([0.0, 1.0]),
)
def test_needles_and_planes_agree_with_the_reference(seed, longest, opacity):
    g = random_gaussians(COUNT, seed, 1)
    thin = np.where(np.arange(COUNT) % 2, 1e-4, 1.0)[:, None] * np.array([[1.0, 1e-4, 0]])
    opacities = np.where(np.arange(COUNT) % 3, g.opacities, opacity).astype(np.float32)
    gaussians = Gaussians(g.means, (longest * thin).astype(np.float32), g.quaternions, opacities, g.sh)
    frame, slow = picture(gaussians), rasterize_slowly([DrawItem(gaussians, HERE)], small_camera())
    difference = np.abs(frame.rgba - slow[..., :4]).max(axis=-1)
    assert difference.max() < 2e-2
    assert (difference > 3e-4).mean() < 0.01


def test_the_near_plane_is_exact():
    g = random_gaussians(2, 1)
    means = np.array([[0, 0, just_before], [0, 0, just_behind]], np.float32)
    for i, is_seen in ((0, False), (1, True)):
        one = Gaussians(means[i : i + 1], g.scales[:1], g.quaternions[:1], np.ones(1, np.float32), g.sh[:1])
        assert picture(one).rgba.any() == is_seen

"""Marks, opacity and colors of a part on the processor: as if the Gaussians themselves were so."""

import re

import numpy as np
import pytest

from gsrain_engine.presets import shipped_folder
from gsrain_engine.render.cpu import projection
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.projection import FEW, project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import ColorGrading, DrawItem, grade_sh
from oracles.rasterizer import rasterize_slowly
from rasterized import rasterize

from .raster_scenes import random_gaussians, small_camera

HERE = np.eye(4)
COLORS = ColorGrading(exposure_ev=0.7, temperature=0.3, contrast=1.3, saturation=0.4).matrix
COUNTS = [300, FEW + 40]


def part_of(count: int, seed: int = 1, **fields) -> DrawItem:
    return DrawItem(random_gaussians(count, seed, 1), HERE, **fields)


def some_of(count: int, share: float = 0.4, seed: int = 0) -> BitMask:
    return BitMask.of(np.random.default_rng(seed).random(count) < share)


def baked(part: DrawItem) -> DrawItem:
    """The same picture without marks, opacity and colors of the part's own."""
    g = part.gaussians.take(slice(0, part.drawn_count))
    if part.left_out is not None:
        g = g.take(np.flatnonzero(~part.left_out.flags[: part.drawn_count]))
    scales, opacities = g.scales * np.float32(part.growth), g.opacities * np.float32(part.opacity)
    sh = g.sh if part.colors is None else grade_sh(g.sh, part.colors)
    return DrawItem(Gaussians(g.means, scales, g.quaternions, opacities, sh), part.to_world)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("read_only", [False, True])
def test_what_is_left_out_leaves_no_trace(count, read_only):
    mask = some_of(count)
    mask.words.flags.writeable = not read_only
    part, camera = part_of(count, left_out=mask), small_camera()
    kept = rasterize([baked(part)], camera).rgba
    assert rasterize([part], camera).rgba.tobytes() == kept.tobytes()
    assert rasterize([part_of(count)], camera).rgba.tobytes() != kept.tobytes()
    splats = project([part], camera)
    assert not mask.flags[splats.indices].any()  # it takes no memory, either


def test_colours_are_those_of_graded_harmonics():
    part, camera = part_of(300, colors=COLORS), small_camera()
    np.testing.assert_allclose(rasterize([part], camera).rgba, rasterize([baked(part)], camera).rgba, atol=2e-6)
    assert np.abs(rasterize([part], camera).rgba - rasterize([part_of(300)], camera).rgba).max() > 0.1


def test_the_readable_reference_agrees():
    part = part_of(
        80, left_out=some_of(80, 0.2), selected=some_of(80, 0.5, 1), opacity=0.7, colors=COLORS, limit=60, growth=1.2
    )
    slow, fast = rasterize_slowly([part], small_camera())[..., :4], rasterize([part], small_camera()).rgba
    difference = np.abs(slow - fast).max(axis=-1)
    assert np.median(difference) < 2e-5
    assert (difference > 3e-4).mean() < 0.01


@pytest.mark.parametrize("count", COUNTS)
def test_the_tint_is_half_of_what_is_selected_and_nothing_else(count):
    mask, camera = some_of(count), small_camera()
    plain, marked = project([part_of(count)], camera), project([part_of(count, selected=mask)], camera)
    chosen = mask.flags[plain.indices] & (plain.colors[:, 3] > 0)
    assert 0 < chosen.sum() < len(chosen)
    np.testing.assert_array_equal(marked.shapes, plain.shapes)
    np.testing.assert_array_equal(marked.colors[~chosen], plain.colors[~chosen])
    expected = 0.5 * plain.colors[chosen, :3] + 0.5 * np.array(projection.TINT, np.float32)
    np.testing.assert_allclose(marked.colors[chosen, :3], expected, atol=1e-6)


@pytest.mark.parametrize("look", ["normals", "opacity", "layers"])
def test_other_looks_are_tinted_too(look):
    pictures = []
    for selected in (None, some_of(300)):
        renderer = CpuRenderer()
        renderer.draw([part_of(300, selected=selected)], small_camera(), look=look)
        pictures.append(renderer.read().rgba)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.05


def test_what_is_left_out_has_no_weight_in_a_view():
    mask, camera = some_of(300), small_camera()
    seen = color_operator([part_of(300, left_out=mask, opacity=0.6)], camera)
    rest = color_operator([baked(part_of(300, left_out=mask, opacity=0.6))], camera)
    assert not mask.flags[seen.splats.indices].any()
    np.testing.assert_array_equal(seen.squared_sums(), rest.squared_sums())


def test_shader_and_kernels_have_the_same_tint():
    text = (shipped_folder("shaders") / "common_tint.glsl").read_text(encoding="utf-8")
    color = re.search(r"TINT = vec3\((.*)\)", text)
    share = re.search(r"TINT_SHARE = ([\d.]+);", text)
    assert color is not None
    assert share is not None
    assert tuple(map(float, color[1].split(","))) == projection.TINT
    assert float(share[1]) == projection.TINT_SHARE

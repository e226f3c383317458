"""Marks, opacity, colors and wetness of parts: drawn as the same Gaussians with all that baked in."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.presets import shipped_path
from gsrain_engine.render.cpu import splats
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.projection import FEW, project
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl import buffers
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Actor, ColorGrading, DrawItem, Layer, PoseTrack, Scene, grade_sh
from gsrain_engine.scene.transforms import blend_wet_sh
from oracles.rasterizer import rasterize_slowly
from render.cpu.raster_scenes import drawn, psnr_db, random_gaussians, small_camera

COLORS = ColorGrading(exposure_ev=0.7, temperature=0.3, contrast=1.3, saturation=0.4).matrix


def some_of(count, share=0.4, seed=0, *, writeable=True):
    mask = BitMask.of(np.random.default_rng(seed).random(count) < share)
    mask.words.flags.writeable = writeable
    return mask


def part_of(count, degree=1, **fields):
    """A part with wet colors."""
    wet_sh = np.random.default_rng(3).normal(0, 0.5, (count, (degree + 1) ** 2, 3)).astype(np.float32)
    return DrawItem(random_gaussians(count, 1, degree), np.eye(4), wet_sh=wet_sh, **fields)


def baked(part):
    """The same picture by the Gaussians alone."""
    g = part.gaussians.with_sh(blend_wet_sh(part.gaussians.sh, part.wet_sh, part.wetness))
    g = g.take(slice(0, part.drawn_count))
    if part.left_out is not None:
        g = g.take(np.flatnonzero(~part.left_out.flags[: part.drawn_count]))
    scales, opacities = g.scales * np.float32(part.growth), g.opacities * np.float32(part.opacity)
    sh = g.sh if part.colors is None else grade_sh(g.sh, part.colors)
    return DrawItem(Gaussians(g.means, scales, g.quaternions, opacities, sh), part.to_world)


@pytest.mark.parametrize(
    ("degree", "fields"),
    [
        (1, {"left_out": some_of(400)}),
        (1, {"left_out": some_of(400, writeable=False)}),
        (1, {"opacity": 0.4}),
        (1, {"colors": COLORS}),
        (3, {"wetness": 0.2}),
        (0, {"wetness": 0.7, "limit": 150, "growth": 1.5}),
        (1, {"wetness": 0.6, "left_out": some_of(400), "opacity": 0.6, "colors": COLORS, "limit": 300, "growth": 1.3}),
    ],
)
def test_drawing_it_is_drawing_the_baked(any_renderer, degree, fields):
    part = part_of(400, degree, **fields)
    expected = drawn(any_renderer, [baked(part)])
    assert psnr_db(drawn(any_renderer, [part]), expected) > (60 if any_renderer.name == "opengl" else 90)
    assert psnr_db(drawn(any_renderer, [part_of(400, degree)]), expected) < 40


def test_wet_colors_that_are_the_clear_ones_change_nothing(any_renderer):
    clear = part_of(300)._replace(wet_sh=None)
    same = clear._replace(wet_sh=clear.gaussians.sh, wetness=0.5)
    np.testing.assert_allclose(drawn(any_renderer, [same]).rgba, drawn(any_renderer, [clear]).rgba, atol=2e-3)


@pytest.mark.parametrize("degree", range(4))
def test_both_ends_of_wetness_are_the_very_bytes(any_renderer, degree):
    part = part_of(300, degree)
    clear = drawn(any_renderer, [part._replace(wet_sh=None)]).rgba.tobytes()
    assert drawn(any_renderer, [part]).rgba.tobytes() == clear
    soaked = part._replace(wetness=1.0)
    assert drawn(any_renderer, [soaked]).rgba.tobytes() == drawn(any_renderer, [baked(soaked)]).rgba.tobytes() != clear


@pytest.mark.parametrize("fields", [{"wetness": 1.0}, {"left_out": some_of(FEW + 40)}])
def test_many_are_projected_in_chunks_to_the_same_bytes(fields):
    part = part_of(FEW + 40, **fields)
    expected = drawn(CpuRenderer(), [baked(part)]).rgba.tobytes()
    assert drawn(CpuRenderer(), [part]).rgba.tobytes() == expected
    if part.left_out is not None:
        assert not part.left_out.flags[project([part], small_camera()).indices].any()  # it takes no memory, either


@pytest.mark.parametrize("kind", ["cpu", "opengl", "opengl-tiles"])
def test_what_has_no_finite_wet_color_is_left_out(open_kind, kind):
    renderer = open_kind(kind)
    part, left_out = part_of(300, wetness=0.5), np.zeros(300, bool)
    part.wet_sh[7, 1, 2], part.wet_sh[9, 0, 0], left_out[[7, 9]] = np.nan, np.inf, True
    expected = drawn(renderer, [part._replace(left_out=BitMask.of(left_out))])
    assert np.isfinite(expected.rgba).all()
    np.testing.assert_allclose(drawn(renderer, [part]).rgba, expected.rgba, atol=1e-6)
    assert np.isfinite(drawn(renderer, [part._replace(wetness=0.0)]).rgba).all()


def test_the_readable_reference_agrees():
    masks = {"left_out": some_of(80, 0.2), "selected": some_of(80, 0.5, 1)}
    part = part_of(80, 3, **masks, opacity=0.7, colors=COLORS, limit=60, growth=1.2, wetness=0.35)
    slow = rasterize_slowly([part], small_camera())[..., :4]
    difference = np.abs(slow - drawn(CpuRenderer(), [part]).rgba).max(axis=-1)
    assert np.median(difference) < 2e-5
    assert (difference > 3e-4).mean() < 0.01


@pytest.mark.parametrize("count", [300, FEW + 40])
def test_the_tint_is_half_of_what_is_selected_and_nothing_else(count):
    mask, camera = some_of(count), small_camera()
    plain, marked = project([part_of(count)], camera), project([part_of(count, selected=mask)], camera)
    chosen = mask.flags[plain.indices] & (plain.colors[:, 3] > 0)
    assert 0 < chosen.sum() < len(chosen)
    np.testing.assert_array_equal(marked.shapes, plain.shapes)
    np.testing.assert_array_equal(marked.colors[~chosen], plain.colors[~chosen])
    expected = 0.5 * plain.colors[chosen, :3] + 0.5 * np.array(splats.TINT, np.float32)
    np.testing.assert_allclose(marked.colors[chosen, :3], expected, atol=1e-6)


def test_shader_and_kernels_have_the_same_tint():
    text = (shipped_path("shaders") / "common_tint.glsl").read_text(encoding="utf-8")
    color, share = re.search(r"TINT = vec3\((.*)\)", text)[1], re.search(r"TINT_SHARE = ([\d.]+);", text)[1]
    assert tuple(map(float, color.split(","))) == splats.TINT
    assert float(share) == splats.TINT_SHARE


def test_what_is_left_out_has_no_weight_in_a_view():
    part, camera = part_of(300, left_out=some_of(300), opacity=0.6), small_camera()
    seen, rest = color_operator([part], camera), color_operator([baked(part)], camera)
    assert not part.left_out.flags[seen.splats.indices].any()
    np.testing.assert_array_equal(seen.squared_sums(), rest.squared_sums())


def marked_scene():
    """A layer, and an actor that moves 0.5 m/s to the right, both marked, faded and graded."""
    places = np.array([[0.0, 0, 0], [1, 0, 0]])
    track = PoseTrack(np.array([0.0, 2.0]), places, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    actor = Actor("one", "car", (1.0, 1.0, 1.0), random_gaussians(200, 4, 1), track)
    scene = Scene("small", (Layer("all", random_gaussians(600, 3, 1)),), (actor,))
    for each in scene.members:
        flags = [some_of(len(each.gaussians), share, seed) for seed, share in enumerate((0.3, 0.1, 0.1), start=1)]
        marks = SelectionFlags(**dict(zip(("selected", "hidden", "deleted"), flags, strict=True)))
        grading = ColorGrading(exposure_ev=0.5, saturation=0.5)
        scene = scene.with_member(each.key, marks=marks, opacity=0.8, grading=grading)
    return scene


@pytest.mark.parametrize(
    ("kind", "look"),
    [
        ("opengl-tiles", "splats"),
        *(("opengl", look) for look in ("splats", "points", "normals", "opacity", "layers")),
    ],
)
def test_back_ends_agree_on_marked_scenes(open_kind, kind, look):
    parts = marked_scene().parts(1.0, selection=True)
    assert all(part.left_out and part.selected for part in parts)
    first, second = (drawn(each, parts, mode=look) for each in (open_kind(kind), CpuRenderer()))
    assert psnr_db(first, second) > (60 if look == "splats" else 35)
    for name in ("left_out", "selected"):
        unmarked = [part._replace(**{name: None}) for part in parts]
        assert psnr_db(drawn(CpuRenderer(), unmarked, mode=look), second) < 35


# In OpenGL


@pytest.fixture
def renderer(open_kind):
    return open_kind("opengl")


def test_masks_are_cut_where_buffers_are(renderer, monkeypatch):
    for module in ("buffers", "projection"):
        monkeypatch.setattr(f"gsrain_engine.render.opengl.{module}.CHUNK", 256)
    part = part_of(1000, left_out=some_of(1000), selected=some_of(1000, 0.5, 3))
    rows = np.flatnonzero(~part.left_out.flags)
    rest = DrawItem(part.gaussians.take(rows), part.to_world, selected=part.selected.take(rows))
    assert psnr_db(drawn(renderer, [part]), drawn(renderer, [rest])) > 60


@pytest.mark.parametrize(("harmonics", "atol"), [("half", 3e-3), ("byte", 5e-2)])
def test_wet_colors_are_stored_in_fewer_bits_too(context, harmonics, atol):
    part = part_of(300, 3, wetness=0.4, colors=COLORS, selected=some_of(300))
    found = drawn(SplatRenderer(context, harmonics=harmonics), [part]).rgba
    np.testing.assert_allclose(found, drawn(CpuRenderer(), [part]).rgba, atol=atol)


def test_marks_go_back_when_they_are_gone(renderer):
    g = random_gaussians(200)
    before = drawn(renderer, g).rgba.tobytes()
    for seed in range(3):
        drawn(renderer, [DrawItem(g, np.eye(4), selected=some_of(200, 0.5, seed))])
    assert drawn(renderer, g).rgba.tobytes() == before
    assert not renderer.arrays.masks


def test_a_step_back_finds_its_colors_still_there(renderer, monkeypatch):
    g = random_gaussians(300)
    other = g.with_sh(g.sh * np.float32(0.5))
    first = drawn(renderer, g).rgba
    drawn(renderer, other)
    assert renderer.arrays.missing(g) == 0
    monkeypatch.setattr(buffers, "RESTING_BYTES", 0)
    drawn(renderer, other)
    assert renderer.arrays.missing(g) == 300
    assert renderer.arrays.missing(replace(other)) == 0
    np.testing.assert_array_equal(first, drawn(renderer, g).rgba)


def test_wet_colors_are_uploaded_once_when_they_are_seen_and_stay_while_it_is_dry(renderer, monkeypatch):
    monkeypatch.setattr(buffers, "RESTING_BYTES", 0)
    part = part_of(300)
    drawn(renderer, [part])
    missing = renderer.arrays.missing
    assert (missing(part.gaussians), missing(part.gaussians, part.wet_sh)) == (0, 300)
    uploaded = set()
    for share in (0.3, 0.0, 0.0, 0.9):
        drawn(renderer, [part._replace(wetness=share)])
        assert missing(part.gaussians, part.wet_sh) == 0
        uploaded.add(renderer.arrays.buffers(part.gaussians, part.wet_sh).wet_sh[0].glo)
    assert len(uploaded) == 1
    drawn(renderer, random_gaussians(10))
    drawn(renderer, random_gaussians(10))
    assert missing(part.gaussians, part.wet_sh) == 300

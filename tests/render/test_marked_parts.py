"""Marks, opacity and colors of parts: OpenGL draws what the same Gaussians would be with all that baked in."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl import buffers
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.scene.flags import SelectionFlags
from gsrain_engine.scene.scene import Actor, ColorGrading, DrawItem, Layer, PoseTrack, Scene
from render.cpu.raster_scenes import random_gaussians, small_camera
from render.cpu.test_marked_parts import COLORS, baked, part_of, some_of

LEAST_PSNR_DB = 60.0


@pytest.fixture
def renderer(context):
    return SplatRenderer(context, harmonics="single")


def drawn(renderer, parts, camera=None, **options):
    renderer.draw(parts, camera or small_camera(), **options)
    return renderer.read().rgba


def psnr_db(a, b):
    return -10 * np.log10(max(float(np.mean((a - b) ** 2)), 1e-20))


@pytest.mark.parametrize(
    "fields",
    [
        {"left_out": some_of(1000)},
        {"opacity": 0.4},
        {"colors": COLORS},
        {"left_out": some_of(1000), "opacity": 0.6, "colors": COLORS, "limit": 400, "growth": 1.3},
    ],
    ids=["left out", "opacity", "colors", "all, and thinned out"],
)
def test_drawing_it_is_drawing_the_baked(renderer, fields):
    part = part_of(1000, **fields)
    expected = drawn(renderer, [baked(part)])
    assert psnr_db(drawn(renderer, [part]), expected) > LEAST_PSNR_DB
    assert psnr_db(drawn(renderer, [part_of(1000)]), expected) < 40


def test_masks_are_cut_where_buffers_are(renderer, monkeypatch):
    for module in ("buffers", "projection"):
        monkeypatch.setattr(f"gsrain_engine.render.opengl.{module}.CHUNK", 256)
    part = part_of(1000, left_out=some_of(1000), selected=some_of(1000, 0.5, 3))
    kept = np.flatnonzero(~part.left_out.flags)
    rest = DrawItem(part.gaussians.take(kept), part.to_world, selected=part.selected.take(kept))
    assert psnr_db(drawn(renderer, [part]), drawn(renderer, [rest])) > LEAST_PSNR_DB


def scene_with_an_actor() -> Scene:
    """A layer, and an actor that moves 0.5 m/s to the right."""
    places = np.array([[0.0, 0, 0], [1, 0, 0]])
    track = PoseTrack(np.array([0.0, 2.0]), places, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    actor = Actor("one", "car", (1.0, 1.0, 1.0), random_gaussians(200, 4, 1), track)
    return Scene("small", (Layer("all", random_gaussians(600, 3, 1)),), (actor,))


def marked(scene: Scene) -> Scene:
    """The scene with its layer and its actor both marked, faded and graded."""
    grading = ColorGrading(exposure_ev=0.5, saturation=0.5)
    for each in scene.members:
        count = len(each.gaussians)
        marks = SelectionFlags(
            selected=some_of(count, 0.3, 1), hidden=some_of(count, 0.1, 2), deleted=some_of(count, 0.1, 3)
        )
        scene = scene.with_member(each.key, marks=marks, opacity=0.8, grading=grading)
    return scene


@pytest.mark.parametrize("look", ["splats", "points", "normals", "opacity", "layers"])
def test_back_ends_agree_on_marked_scenes(renderer, look):
    parts = marked(scene_with_an_actor()).parts(1.0, selection=True)
    assert all(part.left_out and part.selected for part in parts)
    pictures = [drawn(each, parts, look=look) for each in (renderer, CpuRenderer())]
    assert psnr_db(*pictures) > (LEAST_PSNR_DB if look == "splats" else 35)
    unmarked = drawn(renderer, scene_with_an_actor().parts(1.0), look=look)
    assert psnr_db(unmarked, pictures[0]) < 35


def test_marks_go_back_when_they_are_gone(context, renderer):
    g = random_gaussians(200)
    before = drawn(renderer, [DrawItem(g, np.eye(4))])
    for seed in range(3):
        drawn(renderer, [DrawItem(g, np.eye(4), selected=some_of(200, 0.5, seed))])
    assert drawn(renderer, [DrawItem(g, np.eye(4))]).tobytes() == before.tobytes()
    assert not renderer.arrays.masks


def test_a_step_back_finds_its_colours_still_there(context, renderer, monkeypatch):
    g = random_gaussians(300)
    other = g.with_sh(g.sh * np.float32(0.5))
    drawn(renderer, [DrawItem(g, np.eye(4))])
    drawn(renderer, [DrawItem(other, np.eye(4))])
    assert renderer.arrays.missing(g) == 0
    monkeypatch.setattr(buffers, "RESTING_BYTES", 0)
    drawn(renderer, [DrawItem(other, np.eye(4))])
    assert renderer.arrays.missing(g) == 300
    assert renderer.arrays.missing(replace(other)) == 0
    first = drawn(renderer, [DrawItem(g, np.eye(4))])
    np.testing.assert_array_equal(first, drawn(SplatRenderer(context, harmonics="single"), [DrawItem(g, np.eye(4))]))

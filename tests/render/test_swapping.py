"""Other Gaussians take a scene's place without holding up a frame: uploads in slices, the sky a picture at a time."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.editor.drawing import live_view
from gsrain_engine.editor.drawing.live_trees import LiveTrees
from gsrain_engine.editor.drawing.live_view import LiveView, SkyColorSampler
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.level_of_detail import LodSubset
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.scene import Layer
from live_frames import SIZE, darkened, picture
from small_scene import patch, small_scene


def camera_at(x_m):
    pose = look_at(np.array([x_m, 0, 1.5]), np.array([x_m + 1, 0, 1.5]), np.array([0.0, 0, 1]))
    return Camera.from_fov(96, 64, 50.0, pose)


HERE = camera_at(0.0)


@pytest.mark.parametrize("staged", [False, True])
def test_the_previous_scene_is_drawn_until_the_next_one_is_uploaded(context, editor, slow_view, staged):
    before, first, frames = picture(editor, slow_view), editor.document.scene, 0
    if staged:
        editor.viewport.staged = PendingScene("Darker", darkened(first))
    else:
        editor.document.edit("Darker", replace_scene, darkened(first))
    while np.array_equal(now := picture(editor, slow_view), before):
        assert editor.viewport.is_catching_up or staged
        frames += 1
        assert frames < 100
    assert frames > 2
    assert editor.viewport.staged is None
    assert not editor.viewport.is_catching_up
    assert np.array_equal(now, picture(editor, LiveView(context, "opengl")))
    editor.document.undo()
    assert np.array_equal(picture(editor, slow_view), before)  # in the very next frame: its arrays are still there
    assert not editor.viewport.is_catching_up
    assert editor.document.scene is first


def test_a_screenshot_waits_for_no_uploads(context, editor, slow_view, tmp_path):
    picture(editor, slow_view)
    editor.document.edit("Darker", replace_scene, darkened(editor.document.scene))
    editor.viewport.screenshot = tmp_path / "now.png"
    picture(editor, slow_view)
    saved, expected = np.asarray(Image.open(tmp_path / "now.png")), picture(editor, LiveView(context, "opengl"))
    np.testing.assert_array_equal(saved, expected.reshape(SIZE[1], SIZE[0], 4)[..., :3])


def test_a_screenshot_samples_the_exact_sky(context, editor, view, monkeypatch, tmp_path):
    monkeypatch.setattr(live_view, "_QUICK", 500)
    editor.document.change_rain("Rain", **msgspec.structs.asdict(load_preset("8.5")))
    picture(editor, view)
    editor.document.edit("Darker", replace_scene, darkened(editor.document.scene))
    editor.viewport.navigation.turn(0.1, 0.0)
    picture(editor, view)
    assert editor.live_rain.sky_is_stale
    editor.viewport.screenshot = tmp_path / "now.png"
    picture(editor, view)
    assert not editor.live_rain.sky_is_stale
    exact = sky_color(SplatRenderer(context), editor.document.scene, editor.viewport.shot(*SIZE).camera)
    assert np.array(editor.live_rain.sky) == pytest.approx(np.array(exact.light), abs=1e-6)


def test_a_scene_that_is_opened_lets_go_of_the_last_one(editor, view):
    first = editor.document.scene
    picture(editor, view)
    editor.viewport.staged = PendingScene("other", darkened(small_scene("other")), is_opened=True)
    while editor.viewport.staged is not None:
        picture(editor, view)
    picture(editor, view)
    assert view.arrays.missing(first.layers[0].gaussians) > 0


class Counting(SplatRenderer):
    """Remembers how much of each part it was asked to draw."""

    def __init__(self, context):
        super().__init__(context)
        self.limits = []

    def draw(self, parts, *arguments, **options):
        self.limits.append({part.limit for part in parts})
        super().draw(parts, *arguments, **options)


@pytest.fixture
def renderer(context):
    return Counting(context)


def test_the_first_look_at_the_sky_is_at_once_and_the_next_a_picture_a_frame(renderer):
    watch, scene = SkyColorSampler(), small_scene()
    first = watch.look(renderer, scene, HERE, resting=False)
    assert first == sky_color(renderer, scene, HERE)
    assert first.found
    assert watch.look(renderer, scene, HERE, resting=True) is None
    assert watch.is_through
    assert watch.is_exact
    renderer.limits.clear()
    other = darkened(scene)
    found, frames = None, 0
    while found is None:
        found = watch.look(renderer, other, HERE, resting=False)
        frames += 1
        assert len(renderer.limits) < frames  # none in the first, as it might be a drag
        assert not watch.is_through
    assert len(renderer.limits) == 8  # four views, each with the sky and without it
    assert found == sky_color(renderer, other, HERE)
    assert watch.look(renderer, other, HERE, resting=False) is None
    assert watch.is_through


def test_no_look_while_something_is_dragged_nor_when_only_the_selection_changes(renderer):
    watch, scene = SkyColorSampler(), small_scene()
    watch.look(renderer, scene, HERE, resting=False)
    renderer.limits.clear()
    marks = SelectionFlags(selected=BitMask.all(len(scene.layers[0].gaussians)))
    assert watch.look(renderer, scene.with_member("layers/road", marks=marks), HERE, resting=True) is None
    assert watch.is_through
    for step in range(5):
        moved = np.eye(4)
        moved[0, 3] = step + 1
        watch.look(renderer, scene.with_member("layers/road", to_scene=moved), HERE, resting=False)
    assert not renderer.limits
    assert not watch.is_through


def test_a_sky_that_was_found_stays_until_another_is_found(renderer):
    """Also where something hides it: a truck around the camera, or the walls of a house."""
    watch, scene = SkyColorSampler(), small_scene()
    scene = replace(
        scene, layers=tuple(replace(each, kind="background") for each in scene.layers)
    )  # found by its depth
    front = patch((2, -30, -5), np.array([0, 60.0, 0]), np.array([0, 0, 60.0]), 30, (0.2, 0.2, 0.2))
    hidden = replace(scene, layers=(*scene.layers, Layer("house", front)))
    present = watch.look(renderer, scene, HERE, resting=False)
    assert present.found
    looks = [watch.look(renderer, hidden, HERE, present, resting=True) for _ in range(20)]
    assert not sky_color(renderer, hidden, HERE).found
    assert present in looks and {each for each in looks if each is not None} == {present}
    assert watch.is_through and not watch.is_exact
    renderer.limits.clear()
    assert watch.look(renderer, hidden, HERE, present, resting=True) is None and not renderer.limits
    beyond = camera_at(20.0)
    found = next(each for _ in range(20) if (each := watch.look(renderer, hidden, beyond, present, resting=True)))
    assert found.found and watch.is_exact and found == sky_color(renderer, hidden, beyond)


def test_large_scenes_are_looked_at_in_part_first_and_in_full_at_rest(renderer, monkeypatch):
    watch, scene = SkyColorSampler(), small_scene()
    watch.look(renderer, scene, HERE, resting=False)
    monkeypatch.setattr(live_view, "_QUICK", 500)
    other, looks = darkened(scene), []
    for resting in (False, True):
        renderer.limits.clear()
        found = (watch.look(renderer, other, HERE, resting=resting) for _ in range(20))
        looks += [each for each in found if each is not None]
        assert (renderer.limits[0] == {None}) == resting
        assert watch.is_exact == resting
    assert len(looks) == 2
    assert looks[1] == sky_color(renderer, other, HERE)
    np.testing.assert_allclose(looks[0].light, looks[1].light, atol=0.1)


def test_a_first_look_at_a_large_scene_merges_details_and_comes_close_to_the_last(monkeypatch):
    watch, scene, trees, cpu = SkyColorSampler(), small_scene(), LiveTrees(), CpuRenderer()
    sky = patch((120, -150, -20), np.array([0, 300.0, 0]), np.array([0, 0, 170.0]), 70, (0.4, 0.6, 0.9))
    sky = sky.with_sh(sky.sh + np.random.default_rng(0).uniform(-0.7, 0.7, sky.sh.shape).astype(np.float32))
    scene = replace(scene, layers=(*scene.layers[:2], Layer("sky", sky, kind="sky")))
    trees.follow([scene], at_once=True)
    trees.wait()
    trees.follow([scene])
    monkeypatch.setattr(live_view, "_QUICK", 60)
    first = watch.look(cpu, scene, HERE, None, trees, resting=False)
    exact = sky_color(cpu, scene, HERE)
    few = sky_color(cpu, scene, HERE, thinning=LodSubset(60 / scene.gaussian_count))
    np.testing.assert_allclose(first.light.airlight, exact.light.airlight, atol=0.01)
    assert np.abs(np.subtract(few.light.airlight, exact.light.airlight)).max() > 0.02
    assert not watch.is_exact

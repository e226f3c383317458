"""Pictures in motion by the processor: details merged, nothing left out, and true after each kind of edit."""

import gc
import weakref

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drawing import live_trees
from gsrain_engine.editor.drawing.live_trees import LiveCut, LiveTrees
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.drawing.remote_view import RemotePictures, RemoteViewer
from gsrain_engine.editor.drawing.textures import CpuTexture
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.viewport.options import CUT_LEVELS, FULL_QUALITY, REFINED
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.level_of_detail import LodSubset, subset_items
from gsrain_engine.render.opengl.renderer import Screen
from gsrain_engine.render.renderer import Frame
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.scene import Layer, Scene
from live_frames import darkened
from render.cpu.raster_scenes import psnr_db
from small_scene import patch

SIZE = 96, 64
EYE = np.array([-30.0, 0.0, 6.0])
CAMERA = Camera.from_fov(*SIZE, 40.0, look_at(EYE, np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, 1.0])))
ERROR_PX = 1.5


def fine_scene() -> Scene:
    """A striped wall on a road, of Gaussians much smaller than pixels, and a few large ones of a sky."""
    wall = patch((0, -10, 0), np.array([0, 20.0, 0]), np.array([0, 0, 8.0]), 90, (0.5, 0.5, 0.5))
    wall.sh[:, 0, 0] += np.float32(1.2) * np.sign(np.sin(0.8 * wall.means[:, 1]))
    road = patch((-30, -10, 0), np.array([30.0, 0, 0]), np.array([0, 20.0, 0]), 90, (0.3, 0.3, 0.3))
    sky = patch((60, -80, -10), np.array([0, 160.0, 0]), np.array([0, 0, 80.0]), 30, (0.4, 0.6, 0.9))
    layers = Layer("wall", wall, wet_sh=wall.sh - np.float32(0.6)), Layer("road", road), Layer("sky", sky, kind="sky")
    return Scene("fine", layers, ground_m=0.0)


def built(*scenes: Scene) -> LiveTrees:
    trees = LiveTrees()
    trees.follow(scenes, at_once=True)
    trees.wait()
    trees.follow(scenes)
    return trees


def frame(
    scene: Scene, trees: LiveTrees | None, wetness: float = 0.0, error_px: float = ERROR_PX, *, selection: bool = False
) -> tuple[Frame, int]:
    """Picture of a cut, or without trees the exact one; and the number of Gaussians."""
    renderer = CpuRenderer()
    items = scene.parts(wetness=wetness, selection=selection)
    if trees is not None:
        items = subset_items(items, LiveCut(error_px, trees, LodSubset(1 / 8)), CAMERA)
    renderer.draw(items, CAMERA)
    return renderer.read(), renderer.statistics.gaussians


def hide(scene: Scene, chosen: np.ndarray, **marks: BitMask) -> Scene:
    return scene.with_member("layers/wall", marks=SelectionFlags(**(marks or {"deleted": BitMask.of(chosen)})))


def test_details_are_merged_but_nothing_is_missing() -> None:
    scene = fine_scene()
    trees = built(scene)
    exact, of_all = frame(scene, None)
    merged, of_cut = frame(scene, trees)
    fewer = CpuRenderer()
    fewer.draw(subset_items(scene.parts(), LodSubset(1 / 8), CAMERA), CAMERA)
    assert of_cut < of_all / 3
    assert psnr_db(merged, exact) > 30 > psnr_db(fewer.read(), exact) + 5
    assert np.abs(merged.over().mean(axis=(0, 1)) - exact.over().mean(axis=(0, 1))).max() < 0.01


@pytest.mark.parametrize("edit", ["poses", "gradings", "wet colors", "deleted", "selected"])
def test_edits_that_leave_the_gaussians_are_in_the_next_picture(edit: str) -> None:
    scene, wetness = fine_scene(), 0.0
    trees = built(scene)
    frame(scene, trees)
    wall = scene.layers[0]
    left = wall.gaussians.means[:, 1] > 0
    if edit == "poses":
        moved = wall.to_scene.copy()
        moved[:3, 3] = 0.0, 4.0, 2.0
        scene = scene.with_member("layers/wall", to_scene=moved)
    elif edit == "gradings":
        scene = scene.with_member("layers/wall", grading=msgspec.structs.replace(wall.grading, exposure_ev=-1.0))
    elif edit == "wet colors":
        frame(scene, trees, 1.0)
        scene, wetness = scene.with_member("layers/wall", wet_sh=wall.gaussians.sh + np.float32(0.8)), 1.0
    elif edit == "deleted":
        scene = hide(scene, left)
    else:
        scene = hide(scene, left, selected=BitMask.of(left))
    trees.follow([scene])
    assert trees.cover([scene])
    (exact, _), (before, _) = (frame(each, None, wetness, selection=True) for each in (scene, fine_scene()))
    merged, count = frame(scene, trees, wetness, selection=True)
    assert psnr_db(merged, exact) > 28 > psnr_db(before, exact) + 3
    assert count < 6000
    unmerged, _ = frame(scene, trees, wetness, 0.01, selection=True)
    assert psnr_db(unmerged, exact) > 38  # equal depths are drawn in another order


def test_gaussians_of_a_drag_get_no_tree() -> None:
    scene, trees = fine_scene(), LiveTrees()
    for _ in range(3):  # other Gaussians in each picture
        other = darkened(scene)
        trees.follow([other])
        trees.wait()
    trees.follow([scene, other])  # would take a tree of the last ones
    assert not trees.cover([other]) and trees.nbytes == 0


def test_other_gaussians_get_a_tree_of_their_own() -> None:
    scene = fine_scene()
    trees = built(scene)
    other = darkened(scene)
    trees.follow([other])
    assert not trees.cover([other]) and trees.nbytes == 0
    assert frame(other, trees)[1] < 4000  # fewer Gaussians meanwhile
    trees.follow([other])
    trees.wait()
    trees.follow([other])
    assert trees.cover([other]) and psnr_db(frame(other, trees)[0], frame(other, None)[0]) > 30
    held = weakref.ref(other.layers[0].gaussians.sh)
    trees.follow([])
    del other
    gc.collect()
    assert held() is None and trees.nbytes == 0


def test_gaussians_that_can_not_be_merged_are_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []
    monkeypatch.setattr(live_trees, "build_lod_tree", lambda gaussians: tried.append(len(gaussians)) or 1 / 0)
    scene = fine_scene()
    trees = built(scene)
    for _ in range(3):
        trees.follow([scene])
        trees.wait()
    assert tried == [8100, 8100] and not trees.cover([scene])
    assert 0 < frame(scene, trees)[1] < 4000  # fewer Gaussians instead


@pytest.fixture
def editor_of():
    opened = list[Editor]()

    def open_editor(scene):
        opened.append(Editor(scene))
        opened[-1].playback.clock.playing = False
        return opened[-1]

    yield open_editor
    for each in opened:
        each.close()


@pytest.fixture
def ready_view(context, monkeypatch):
    """A view whose processor back end is ready."""
    monkeypatch.setattr(CpuTexture, "is_ready", True)
    return LiveView(context, "cpu")


def test_the_window_merges_while_the_camera_moves_and_is_exact_at_rest(editor_of, ready_view) -> None:
    editor = editor_of(fine_scene())
    budget = editor.viewport.budget

    def drawn(moving: bool):
        if moving:
            editor.viewport.navigation.orbit(0.01, 0.0)
        else:
            budget.observe(moving=False, real_s=1.0)
        result = ready_view.draw(editor.render_input(*SIZE))
        editor.apply(result)
        budget.measured(result.frame.quality, 40 * budget.target_ms)  # a slow machine
        return result

    assert drawn(moving=False).frame.quality == FULL_QUALITY
    assert drawn(moving=True).frame.quality.gaussians < 1  # no trees yet
    ready_view.trees.wait()
    assert drawn(moving=True).has_cuts
    result = drawn(moving=True)
    assert result.frame.quality in CUT_LEVELS[1:] and not result.frame.quality.is_exact
    assert editor.viewport.statistics["merged details MB"] > 0.1
    assert editor.viewport.statistics["Gaussians"] < editor.document.scene.gaussian_count / 3
    assert drawn(moving=False).frame.quality == REFINED
    result = drawn(moving=False)
    exact = np.frombuffer(result.textures[0].read(), np.uint8)
    alone = LiveView(ready_view.context, "cpu").draw(editor.render_input(*SIZE))
    np.testing.assert_array_equal(exact, np.frombuffer(alone.textures[0].read(), np.uint8))
    editor.viewport.options.look = "depth"
    assert not drawn(moving=True).has_cuts
    assert drawn(moving=True).frame.quality.error_px == 0


def test_viewers_on_other_screens_get_merged_details_too() -> None:
    scene = fine_scene()
    renderer = CpuRenderer()
    pictures = RemotePictures(renderer, scene, RainSettings(intensity_mm_h=0.0), CAMERA)
    viewer = RemoteViewer(RenderView(CAMERA))
    exact = pictures.picture(viewer, FULL_QUALITY)
    pictures.trees.wait()
    pictures.picture(viewer, FULL_QUALITY)
    assert viewer.budget.has_cuts
    merged = pictures.picture(viewer, CUT_LEVELS[1])
    assert np.abs(merged.astype(int) - exact).mean() < 3
    assert renderer.statistics.gaussians < scene.gaussian_count / 3


def test_enlarged_pictures_are_sharpened(context) -> None:
    step = np.zeros((4, 8, 4), np.float32)
    step[..., 3], step[:, :4, :3], step[:, 4:, :3] = 1.0, 0.4, 0.6
    picture = context.texture((8, 4), 4, step.tobytes(), dtype="f4")
    screen = Screen(context)
    plain, sharp = (
        np.frombuffer(screen.show(picture, sharpness=each).read(), np.uint8).reshape(4, 8, 4)[..., 0].astype(int)
        for each in (0.0, 0.75)
    )
    np.testing.assert_array_equal(plain[1], [102] * 4 + [153] * 4)
    np.testing.assert_allclose(sharp, np.tile([102] * 3 + [92, 163] + [153] * 3, (4, 1)), atol=1)

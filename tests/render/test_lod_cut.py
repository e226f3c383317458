"""Level-of-detail cuts in images: the same on each back end, in exports and in the window."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.drawing import live_view
from gsrain_engine.editor.viewport.options import FULL_QUALITY, QualityLevel
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import LodCut, LodSample, LodSubset, subset_items
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.open import with_lod_trees
from gsrain_engine.scene.scene import DrawItem, Scene
from render.cpu.raster_scenes import psnr_db, random_gaussians
from small_scene import small_scene

CAMERA = Camera.from_fov(120, 80, 30.0, np.eye(4))


def far_scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Small scene with trees, so far ahead that its Gaussians are smaller than pixels."""
    monkeypatch.setattr("gsrain_engine.scene.open._MIN_FOR_TREE", 100)
    to_scene = np.eye(4)
    to_scene[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    to_scene[2, 3] = 300.0
    scene = small_scene()
    return with_lod_trees(replace(scene, layers=tuple(replace(each, to_scene=to_scene) for each in scene.layers)))


def test_each_back_end_draws_the_same_cut(monkeypatch: pytest.MonkeyPatch, any_renderer) -> None:
    items = subset_items(far_scene(monkeypatch).parts(), LodCut(), CAMERA)
    assert len(items) == 6 and all(each.members is not None for each in items)
    assert sum(each.drawn_count for each in items) < 400
    cpu, images = CpuRenderer(), []
    for renderer in (cpu, any_renderer):
        renderer.draw(items, CAMERA)
        images.append(renderer.read())
    assert images[0].rgba[..., 3].max() > 0.9 and psnr_db(*images) > 50
    hidden = [each._replace(opacity=0.0) for each in items]
    any_renderer.draw(hidden, CAMERA)
    assert not any_renderer.read().rgba.any()


def test_a_sample_of_gaussians_in_file_order_covers_all_of_the_scene() -> None:
    g = random_gaussians(4000, 1, 0)
    by_place = g.take(np.argsort(g.means[:, 0]))
    hidden, wet_sh = BitMask.of(by_place.means[:, 1] > np.median(by_place.means[:, 1])), by_place.sh + np.float32(1)
    part = DrawItem(by_place, np.eye(4), left_out=hidden, wet_sh=wet_sh)
    (sample,) = LodSample(0.1).items(part, CAMERA)
    assert len(sample.gaussians) == 400 and sample.gaussians.scales.mean() > by_place.scales.mean()
    edges = np.quantile(by_place.means[:, 0], [0, 0.25, 0.5, 0.75, 1])
    assert np.histogram(sample.gaussians.means[:, 0], edges)[0].min() > 60
    np.testing.assert_array_equal(sample.wet_sh, sample.gaussians.sh + np.float32(1))
    assert sample.left_out is not None
    is_hidden = sample.gaussians.means[:, 1] > np.median(by_place.means[:, 1])
    np.testing.assert_array_equal(sample.left_out.flags, is_hidden)


def test_grown_members_are_the_same_gaussians_grown(any_renderer) -> None:
    g, rows = random_gaussians(300, 1, 0), np.arange(200, 300)
    grown = replace(g.take(rows), scales=g.scales[rows] * np.float32(1.7))
    images = []
    for item in (DrawItem(g, np.eye(4), members=rows, growth=1.7), DrawItem(grown, np.eye(4))):
        any_renderer.draw([item], CAMERA)
        images.append(any_renderer.read())
    assert images[0].rgba[..., 3].max() > 0.1 and psnr_db(*images) > 60


def test_an_export_draws_a_cut_except_with_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, renderer = replace(far_scene(monkeypatch), up=(0.0, 0.0, 1.0)), CpuRenderer()
    simulation = RainSimulation.start(RainSettings(intensity_mm_h=0.0))
    drawn: dict[str, list[int]] = {}
    for lod in ("off", "pixel"):
        settings = ExportSettings(output="a.png", size_px=(120, 80), lod=lod)
        (sequence,) = export_sequences(settings, scene, simulation, CAMERA, in_scene_time=False).values()
        counts = drawn.setdefault(lod, [])
        for with_depth, mode in ((False, "splats"), (True, "splats"), (False, "opacity")):
            sequence.frame(renderer, 0, None, with_depth=with_depth, look=mode)
            counts.append(renderer.statistics.gaussians)
    assert drawn["off"] == [scene.gaussian_count] * 3
    assert drawn["pixel"][0] < 400 and drawn["pixel"][1:] == drawn["off"][1:]


def test_the_window_draws_a_coarser_cut_of_a_large_scene_in_less_time(
    monkeypatch: pytest.MonkeyPatch, view: live_view.LiveView
) -> None:
    scene, quarter = far_scene(monkeypatch), QualityLevel(0.25, 1.0)
    assert view.thinning(FULL_QUALITY, scene) is None and isinstance(view.thinning(quarter, scene), LodSubset)
    monkeypatch.setattr(live_view, "MIN_GAUSSIANS", 100)
    rest, quick = view.thinning(FULL_QUALITY, scene), view.thinning(quarter, scene)
    assert rest == LodCut() and isinstance(quick, LodCut)
    assert quick.pixel == 2 * LodCut().pixel and quick.others == LodSubset(0.25)
    assert (
        view.thinning(FULL_QUALITY, scene, exact=True) is None and view.thinning(FULL_QUALITY, scene, "depth") is None
    )
    assert view.thinning(FULL_QUALITY, small_scene()) is None  # without trees
    uploads = list(live_view.uploads_of(scene.members))
    assert len(uploads) == 6 and uploads[1][0] is scene.layers[0].tree.nodes

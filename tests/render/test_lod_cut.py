"""Level-of-detail cuts in images: the same on each back end, in exports and in the window."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.drawing import live_view
from gsrain_engine.editor.viewport.options import FULL_QUALITY, QualityLevel
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.level_of_detail import LodCut, LodSample, LodSubset, subset_items
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


def test_samples_of_parts_are_one_item_unless_they_differ_in_more_than_their_gaussians() -> None:
    parts = [DrawItem(random_gaussians(200, seed, degree=seed), np.eye(4)) for seed in range(3)]
    wet = [part._replace(wet_sh=part.gaussians.sh[:, :1] + np.float32(1), wetness=1.0) for part in parts]
    sample = LodSample(0.5)
    (dry,), (soaked,) = sample.join(parts, CAMERA), sample.join(wet, CAMERA)
    each = [sample.items(part, CAMERA)[0].gaussians for part in parts]
    assert dry.wet_sh is None and dry.gaussians.sh.shape[1] == 4  # of degree 1
    np.testing.assert_array_equal(dry.gaussians.means, np.concatenate([part.means for part in each]))
    np.testing.assert_array_equal(soaked.wet_sh[:, 0], soaked.gaussians.sh[:, 0] + np.float32(1))
    moved = np.eye(4)
    moved[0, 3] = 1.0
    hidden = BitMask.of(np.arange(200) < 100)
    others = parts[0]._replace(to_world=moved), parts[0]._replace(opacity=0.5), parts[0]._replace(left_out=hidden)
    assert [len(item.gaussians) for item in sample.join([*parts, *others, wet[0]], CAMERA)] == [300, 100, 100, 100, 100]


def test_small_gaussians_of_a_sample_are_fewer_cover_as_much_and_do_not_pop_up() -> None:
    random = np.random.default_rng(5)
    count, least_px2 = 20_000, 0.5
    g = random_gaussians(count, 1, 0)
    means = random.uniform((-20, -12, 20), (20, 12, 80), (count, 3)).astype(np.float32)
    scales = np.full((count, 3), 0.02, np.float32)
    scales[:5], means[:5], opacities = 2.0, (0.0, 0.0, 20.0), np.ones(count, np.float32)
    part = DrawItem(replace(g, means=means, scales=scales, opacities=opacities), np.eye(4))

    def areas_px(camera: Camera, least_px2: float, item: DrawItem = part) -> np.ndarray:
        (drawn,) = LodSample(1.0, least_px2).join([item], camera)
        rows = np.arange(count) if drawn.members is None else drawn.members
        places = item.gaussians.means[rows] + camera.world_to_camera[:3, 3]
        areas = np.zeros(count)
        areas[rows] = 2 * np.pi * camera.fx**2 * drawn.gaussians.scales[rows, 0] ** 2 / (places**2).sum(axis=1)
        return areas

    ahead = np.eye(4)
    ahead[2, 3] = -0.1
    fewer, closer = (areas_px(each, least_px2) for each in (CAMERA, replace(CAMERA, world_to_camera=ahead)))
    in_view = np.all(np.abs(means[:, :2]) < [[0.95 * 60, 0.95 * 40]] / np.array(CAMERA.fx) * means[:, 2:], axis=1)
    whole = areas_px(CAMERA, 0.0)
    assert 300 < np.count_nonzero(fewer) < 0.3 * np.count_nonzero(in_view)
    np.testing.assert_allclose(fewer[:5], whole[:5])
    small = np.flatnonzero(in_view)[5:]
    assert fewer[small].sum() == pytest.approx(whole[small].sum(), rel=0.1)
    change = np.abs(closer - fewer)[small]
    assert change.max() < 0.1 * least_px2 and np.any((closer > 0) & (fewer == 0))
    hidden = part._replace(left_out=BitMask.of(np.arange(count) % 2 == 0))
    np.testing.assert_array_equal(areas_px(CAMERA, least_px2, hidden), np.where(np.arange(count) % 2 == 0, 0, fewer))


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
            sequence.frame(renderer, 0, None, with_depth=with_depth, mode=mode)
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

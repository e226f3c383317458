"""Parts of a training by themselves: exposures, held-out views, sizes, losses, other pictures, curves."""

from dataclasses import replace

import numpy as np
import pytest

from small_capture import small_capture

torch = pytest.importorskip("torch")

from gsrain_engine.datasets.capture import CaptureFrame  # noqa: E402
from gsrain_engine.evaluation.image_metrics import (  # noqa: E402
    fitted_affine,
    with_affine,
)
from gsrain_engine.render.autodiff.differentiable import (  # noqa: E402
    Footprint,
    Rendered,
)
from gsrain_engine.scene.camera import Camera  # noqa: E402
from gsrain_engine.training.data import (  # noqa: E402
    PyramidLevel,
    TrainingView,
    half_size,
)
from gsrain_engine.training.evaluation import (  # noqa: E402
    TrainingCurves,
    score,
    validation_indices,
)
from gsrain_engine.training.model import (  # noqa: E402
    TrainingRender,
    recorded_path,
)
from gsrain_engine.training.settings import TrainingSettings  # noqa: E402
from gsrain_engine.training.step import (  # noqa: E402
    ExposureAffine,
    TrainingTarget,
    view_loss,
)


def noise(*shape):
    return np.random.default_rng(0).random(shape).astype(np.float32)


def test_exposures_find_known_gains_and_keep_no_change_as_their_mean():
    torch.manual_seed(0)
    scene = torch.rand(20, 30, 3)
    exposures = ExposureAffine(2)
    for _ in range(300):
        loss = sum((exposures.apply(k, scene) - gain * scene).square().mean() for k, gain in ((0, 0.8), (1, 1.2)))
        loss.backward()
        exposures.step(0.01)
        assert float(exposures.changes.detach().mean(dim=0).abs().max()) < 1e-6
    for k, gain in ((0, 0.8), (1, 1.2)):
        assert float((exposures.apply(k, scene) - gain * scene).detach().abs().max()) < 0.02
    assert float(exposures.penalty(0).detach()) > 0.05


def test_exposures_go_on_from_their_state():
    first, second = ExposureAffine(3), ExposureAffine(3)
    scene = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(1))

    def advance(exposures):
        (exposures.apply(1, scene) - 0.5 * scene).square().mean().backward()
        exposures.step(0.01)

    for _ in range(3):
        advance(first)
    second.restore(first.state())
    advance(first)
    advance(second)
    assert torch.equal(first.changes, second.changes)


def test_a_fitted_map_undoes_an_exposure_and_only_where_the_mask_says():
    truth = noise(20, 30, 3)
    rendered = truth * np.float32(0.7) + np.float32(0.1)
    mask = np.ones((20, 30), bool)
    mask[:, 15:] = False
    spoiled = np.where(mask[..., None], rendered, 0)
    affine = fitted_affine(spoiled.astype(np.float32), truth, mask)
    assert np.abs(with_affine(rendered, affine) - truth)[:, :15].max() < 0.03
    assert np.array_equal(fitted_affine(rendered, truth, np.zeros((20, 30), bool)), np.eye(3, 4))


def test_held_out_views_lie_inside_every_stretch_or_are_named():
    names = [f"v{k}" for k in range(18)]
    assert validation_indices(names, 8) == [4, 12]
    assert validation_indices(names, 0) == []
    assert validation_indices(names, 8, ("v3", "v1")) == [1, 3]
    with pytest.raises(ValueError, match="no view is named 'nobody'; the first is 'v0'"):
        validation_indices(names, 8, ("nobody",))
    with pytest.raises(ValueError, match="none is left"):
        validation_indices(names, 1)


def test_an_exposure_is_seen_in_the_raw_score_and_not_in_the_exposed_one():
    truth = (noise(40, 60, 3) * 255).astype(np.uint8)
    darker = truth.astype(np.float32) / 255 * np.float32(0.8)
    found = score("v", darker, truth, None)
    assert found.psnr_db < 21
    assert found.psnr_exposed_db > 35
    mask = np.zeros((40, 60), bool)
    mask[5:35, 5:55] = True
    spoiled = np.where(mask[..., None], darker, 1).astype(np.float32)
    assert score("v", spoiled, truth, mask).psnr_db == pytest.approx(score("v", darker, truth, mask).psnr_db)


def level(height=100, width=120):
    depth = np.zeros((height, width), np.float32)
    depth[::4, ::6] = 7
    depth[1::4, ::6] = 5
    mask = np.ones((height, width), bool)
    mask[0, 0] = False
    image = np.full((height, width, 3), 100, np.uint8)
    image[::2] = 200
    return PyramidLevel(Camera(width, height, 90, 80, 61, 52), image, mask, depth, np.zeros((height, width), bool))


def test_halving_averages_colours_takes_the_nearest_depth_and_is_strict_with_masks():
    half = half_size(level())
    assert (half.camera.width, half.camera.height, half.camera.fx, half.camera.cx) == (60, 50, 45, 30.5)
    assert np.all(half.image == 150)
    assert set(np.unique(half.depth)) == {0, 5}
    assert not half.mask[0, 0] and half.mask.sum() == half.mask.size - 1


def test_odd_sizes_lose_a_row_and_small_pictures_stay():
    odd = level(101, 121)
    assert half_size(odd).image.shape == (50, 60, 3)
    view = CaptureFrame("v", odd.camera, odd.image)
    ready = TrainingView.of(view, odd.depth, odd.mask, odd.sky)
    assert [each.camera.height for each in ready.levels] == [101, 50, 50]


def flat_picture(color, alpha, depth, sky=None):
    return TrainingRender(
        color, Rendered(color, alpha, depth, Footprint(torch.zeros(0))), slice(0, 0), {},
        None if sky is None else Rendered(color, alpha, depth, Footprint(torch.zeros(0))),
    )  # fmt: skip


def test_depth_counts_where_it_was_measured_alike_for_near_and_far():
    shape = (20, 20)
    truth_color, settings = torch.full((*shape, 3), 0.5), TrainingSettings(d_ssim=0.0, depth=1.0, cover=0.0)
    losses = []
    for distance in (2.0, 50.0):
        depth = np.zeros(shape, np.float32)
        depth[3, 4] = distance
        truth = TrainingTarget.of(
            PyramidLevel(Camera(20, 20, 9, 9, 9, 9), np.full((*shape, 3), 127, np.uint8), None, depth, None), "cpu"
        )
        picture = flat_picture(truth_color, torch.full(shape, 0.8), torch.full(shape, 0.8 * 1.1 * distance))
        losses.append(float(view_loss(picture, truth_color, truth, settings).depth))
    assert losses[0] == pytest.approx(0.1 / 2.1, rel=1e-4)
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


def test_holes_before_a_surface_and_veils_before_the_sky_cost():
    shape = (20, 20)
    depth, sky = np.zeros(shape, np.float32), np.zeros(shape, bool)
    depth[10:], sky[:10] = 3, True
    truth = TrainingTarget.of(
        PyramidLevel(Camera(20, 20, 9, 9, 9, 9), np.zeros((*shape, 3), np.uint8), None, depth, sky), "cpu"
    )
    settings = TrainingSettings(d_ssim=0.0, depth=0.0, cover=1.0)
    color = torch.zeros((*shape, 3))

    def cover(above, below):
        alpha = torch.cat([torch.full((10, 20), above), torch.full((10, 20), below)])
        return float(view_loss(flat_picture(color, alpha, 3 * alpha, sky=True), color, truth, settings).cover)

    assert cover(0.0, 1.0) == pytest.approx(0, abs=1e-6)
    assert cover(0.3, 1.0) == pytest.approx(0.3, rel=1e-4)
    assert cover(0.0, 0.6) == pytest.approx(0.4, rel=1e-4)


def test_curves_come_back_from_a_checkpoint():
    curves = TrainingCurves()
    curves.add(0.5, 10, 1.0)
    curves.add(0.25, 12, 2.0)
    curves.measured(2, 21.5)
    again = TrainingCurves.restored(curves.state())
    assert vars(again) == vars(curves)
    assert isinstance(again.counts[0], int)
    assert again.recent_loss(1) == 0.25


def test_the_recorded_way_goes_through_the_cameras_of_one_sensor():
    capture = small_capture()
    way = recorded_path(capture.views)
    assert way is not None
    assert way.positions[:, 0] == pytest.approx([0, 1, 2, 3])
    assert np.allclose(way.camera(0.0, 96, 64).world_to_camera, capture[0].camera.world_to_camera, atol=1e-9)
    still = tuple(replace(view, time_s=0.0) for view in capture)
    again = recorded_path(still)
    assert again is not None and not again.is_timed and way.is_timed
    assert again.times_s == pytest.approx(np.arange(4) / 1.4), "a walk: nobody knows how fast it was"
    assert recorded_path(still[:1]) is None

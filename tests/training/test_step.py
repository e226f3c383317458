"""One training step: losses and their gradients, masks of what contradicts, exposures, views at three sizes."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.image_metrics import ssim, window  # noqa: E402
from gsrain_engine.render.autodiff.differentiable import Footprint, Rendered  # noqa: E402
from gsrain_engine.scene.camera import Camera  # noqa: E402
from gsrain_engine.training.data import PyramidLevel, half_size  # noqa: E402
from gsrain_engine.training.losses import (  # noqa: E402
    convolved,
    d_ssim,
    filtered,
    l1,
    robust_mask,
    spread_over_windows,
    view_loss,
    window_means,
)
from gsrain_engine.training.model import TrainingRender  # noqa: E402
from gsrain_engine.training.settings import TrainingSettings  # noqa: E402
from gsrain_engine.training.targets import TrainingTarget  # noqa: E402


def pictures(height: int = 17, width: int = 23):
    """A noisy picture, its truth, and a mask with a hole."""
    generator = np.random.default_rng(5)
    truth = generator.random((height, width, 3))
    mask = np.ones((height, width), bool)
    mask[4:9, 12:] = False
    noisy = np.clip(truth + generator.normal(0, 0.1, truth.shape), 0, 1)
    return torch.tensor(noisy), torch.tensor(truth), torch.tensor(mask)


@pytest.mark.parametrize("masked", [False, True])
def test_d_ssim_is_one_minus_the_metric(masked: bool):
    x, y, mask = pictures()
    expected = 1 - ssim(x.numpy(), y.numpy(), mask.numpy() if masked else None)
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 2e-6)):
        found = float(d_ssim(x.to(dtype), y.to(dtype), mask if masked else None))
        assert found == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("loss", [l1, d_ssim])
def test_gradients_are_those_of_finite_differences_and_none_comes_from_beyond_the_mask(masked: bool, loss):
    x, truth, mask = pictures(13, 14)
    chosen, rendered = mask if masked else None, x.requires_grad_()
    assert torch.autograd.gradcheck(lambda value: loss(value, truth, chosen), (rendered,), rtol=1e-5, atol=1e-9)
    loss(rendered, truth, chosen).backward()
    assert not masked or torch.all(rendered.grad[~mask] == 0)


def test_window_means_of_the_gpu_are_those_of_the_processor_and_spreading_is_their_adjoint():
    planes = pictures()[0].permute(2, 0, 1)
    for edge in (0, 10):
        assert torch.allclose(filtered(planes, edge), convolved(planes, edge), atol=1e-14)
    taps = torch.tensor(np.outer(window(), window()))
    means = window_means(planes)
    assert float(means[1, 2, 3]) == pytest.approx(float((planes[1, 2:13, 3:14] * taps).sum()))
    weights = torch.rand(means.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert float((means * weights).sum()) == pytest.approx(float((planes * spread_over_windows(weights)).sum()))


# Depth and cover

SHAPE = (20, 20)
CAMERA = Camera(20, 20, 9, 9, 9, 9)


def flat_picture(alpha, depth):
    front = Rendered(torch.zeros((*SHAPE, 3)), alpha, depth, Footprint(torch.zeros(0)))
    return TrainingRender(front.color, front, slice(0, 0), {}, front)


def test_holes_before_a_surface_and_veils_before_the_sky_cost_and_so_does_wrong_depth():
    depth, sky = np.zeros(SHAPE, np.float32), np.zeros(SHAPE, bool)
    depth[10:], sky[:10] = 3, True
    truth = TrainingTarget.of(PyramidLevel(CAMERA, np.zeros((*SHAPE, 3), np.uint8), None, depth, sky), "cpu")
    black = torch.zeros((*SHAPE, 3))
    for above, below, distance, weights, cost in (
        (0.0, 1.0, 3, (0, 1), 0.0), (0.3, 1.0, 3, (0, 1), 0.3), (0.0, 0.6, 3, (0, 1), 0.4),
        (0.0, 0.6, 3, (1, 0), 0.0), (0.0, 0.6, 5, (1, 0), 2 / 8), (0.0, 0.01, 5, (1, 0), 0.0),
    ):  # fmt: skip
        settings = TrainingSettings(d_ssim=0.0, depth=weights[0], cover=weights[1])
        alpha = torch.cat([torch.full((10, 20), above), torch.full((10, 20), below)])
        loss = view_loss(flat_picture(alpha, distance * alpha), black, truth, settings)
        assert float(loss.value) == pytest.approx(cost, rel=1e-4, abs=1e-6)


def test_gradients_of_depth_and_cover_are_those_of_finite_differences():
    r, step, settings = np.random.default_rng(3), 1e-6, TrainingSettings(depth=0.7, cover=0.3)
    depth, sky, mask = np.zeros(SHAPE, np.float32), np.zeros(SHAPE, bool), r.random(SHAPE) > 0.2
    depth[5:], sky[:8] = np.where(r.random((15, 20)) > 0.4, 3, 0), True
    level = PyramidLevel(CAMERA, r.integers(0, 255, (*SHAPE, 3), np.uint8), mask, depth, sky)
    truth = TrainingTarget.of(level, "cpu")
    truth = truth._replace(image=truth.image.double(), depths=truth.depths.double())
    alpha, color = torch.tensor(r.random(SHAPE)), torch.tensor(r.random((*SHAPE, 3)))
    values = [color, alpha, alpha * torch.tensor(r.uniform(1, 5, SHAPE))]
    turns = [torch.tensor(r.normal(size=tuple(each.shape))) for each in values]

    def loss(offset):
        color, alpha, depth = (value + offset * turn for value, turn in zip(values, turns, strict=True))
        return view_loss(flat_picture(alpha, depth), color, truth, settings)

    picture = flat_picture(*values[1:])
    found = {id(each): gradient for each, gradient in view_loss(picture, values[0], truth, settings).gradients}
    slope = sum(float((found[id(value)] * turn).sum()) for value, turn in zip(values, turns, strict=True))
    assert slope == pytest.approx(float(loss(step).value - loss(-step).value) / (2 * step), rel=1e-5)


# Transient objects, which other images of the training contradict


def test_a_patch_that_contradicts_is_left_out_and_noise_is_not() -> None:
    truth = torch.rand(60, 100, 3, generator=torch.Generator().manual_seed(0)) * 0.1
    shown = truth + 0.01
    shown[20:30, 40:55] += 0.5
    nothing = torch.zeros(0)
    target = TrainingTarget(truth, None, nothing, nothing, None, pixels=6000)
    counts = robust_mask(shown, target, max_share=0.2)
    assert not counts[22:28, 42:53].any()
    assert counts[:15].all() and counts[:, 70:].all()
    every = target._replace(mask=torch.ones((60, 100), dtype=torch.bool))
    assert torch.equal(robust_mask(shown, every, max_share=0.2), counts)
    assert robust_mask(truth + 0.05, target, max_share=0.2).all()


# Sizes of views


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

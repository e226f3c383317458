"""The losses of training: the same numbers as the metrics, and the gradients of their formulas."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.evaluation.image_metrics import ssim  # noqa: E402
from gsrain_engine.training import step  # noqa: E402
from gsrain_engine.training.step import (  # noqa: E402
    d_ssim,
    l1,
)


def _pictures(height: int = 17, width: int = 23) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    truth = generator.random((height, width, 3))
    mask = np.ones((height, width), bool)
    mask[4:9, 12:] = False
    return np.clip(truth + generator.normal(0, 0.1, truth.shape), 0, 1), truth, mask


def test_l1_is_the_mean_over_the_mask():
    truth = torch.full((4, 5, 3), 0.5)
    mask = torch.zeros(4, 5, dtype=torch.bool)
    mask[:, :2] = True
    rendered = truth + torch.where(mask, 0.1, 0.4)[..., None]
    assert float(l1(rendered, truth, mask)) == pytest.approx(0.1)
    assert float(l1(rendered, truth)) == pytest.approx((2 * 0.1 + 3 * 0.4) / 5)
    assert float(l1(rendered, truth, ~mask & mask)) == 0


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 2e-6)])
def test_d_ssim_is_one_minus_the_metric(masked: bool, dtype: object, tolerance: float):
    x, y, mask = _pictures()
    chosen = mask if masked else None
    got = d_ssim(torch.tensor(x, dtype=dtype), torch.tensor(y, dtype=dtype), torch.tensor(mask) if masked else None)
    assert float(got) == pytest.approx(1 - ssim(x, y, chosen), abs=tolerance)


@pytest.mark.parametrize("masked", [False, True])
def test_gradients_are_those_of_finite_differences(masked: bool):
    x, y, mask = _pictures(13, 14)
    truth, chosen = torch.tensor(y), torch.tensor(mask) if masked else None
    rendered = torch.tensor(x, requires_grad=True)
    assert torch.autograd.gradcheck(lambda value: d_ssim(value, truth, chosen), (rendered,), rtol=1e-5, atol=1e-9)
    assert torch.autograd.gradcheck(lambda value: l1(value, truth, chosen), (rendered,), rtol=1e-5, atol=1e-9)


def test_no_gradient_comes_from_what_the_mask_leaves_out():
    x, y, mask = _pictures()
    rendered = torch.tensor(x, requires_grad=True)
    (
        d_ssim(rendered, torch.tensor(y), torch.tensor(mask)) + l1(rendered, torch.tensor(y), torch.tensor(mask))
    ).backward()
    assert torch.all(rendered.grad[~torch.tensor(mask)] == 0)
    assert float(rendered.grad.abs().max()) > 0


def test_window_means_of_the_gpu_are_those_of_the_processor():
    values = torch.tensor(_pictures()[0])
    on_cpu = step._CpuBlur.apply(values)
    planes = torch.nn.functional.conv2d(
        values.permute(2, 0, 1)[:, None], torch.tensor(np.outer(step.window(), step.window()))[None, None]
    )
    assert torch.allclose(on_cpu, planes[:, 0].permute(1, 2, 0), atol=1e-14)


def test_a_mask_without_a_pixel_costs_nothing():
    x, y, mask = _pictures()
    nothing = torch.zeros(mask.shape, dtype=torch.bool)
    assert float(d_ssim(torch.tensor(x), torch.tensor(y), nothing)) == 0

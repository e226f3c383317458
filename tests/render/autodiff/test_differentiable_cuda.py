import sys

import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.render.autodiff.differentiable import render_gaussians, render_with_gsplat  # noqa: E402

from .differentiable_gsplat_stand_in import rasterization  # noqa: E402
from .trained_scenes import NAMES, camera, display, gradients, tensors, with_values  # noqa: E402


def by_gsplat(values, **others):
    return render_with_gsplat(
        *(values[name] for name in NAMES[:5]), camera(), values[NAMES[5]], rasterize=rasterization, **others
    )


def by_kernels(values):
    return render_gaussians(*(values[name] for name in NAMES[:5]), camera(), world_to_camera=values[NAMES[5]])


def outputs_of(rendered):
    return rendered.color, rendered.alpha, rendered.depth


@pytest.mark.parametrize("degree", [0, 2, 3, None])
def test_both_back_ends_give_one_picture_and_one_gradient(degree):
    values = tensors(60, 2, degree or 0, torch.float32)
    values = display(values) if degree is None else values
    cuda, cpu = by_gsplat(values), by_kernels(values)
    for one, other in zip(outputs_of(cuda), outputs_of(cpu), strict=True):
        assert (one - other).norm() < 1e-4 * other.norm()
    found, expected = gradients(outputs_of(cuda), values), gradients(outputs_of(cpu), values)
    for name in NAMES:
        assert (found[name] - expected[name]).norm() < 1e-3 * expected[name].norm(), name


def test_both_back_ends_have_one_footprint():
    values = tensors(60, 3, 1, torch.float32)
    cuda, cpu = by_gsplat(values), by_kernels(values)
    with pytest.raises(RuntimeError, match="after a backward pass"):
        _ = cuda.footprint.screen_gradients
    for rendered in (cuda, cpu):
        rendered.color.square().sum().backward()
    both = cuda.footprint.drawn & cpu.footprint.drawn
    assert both.sum() > 20
    assert (cuda.footprint.drawn & ~cpu.footprint.drawn).sum() == 0  # ours also counts what only meets the edge
    torch.testing.assert_close(cuda.footprint.radii_px[both], cpu.footprint.radii_px[both], rtol=1e-3, atol=1e-3)
    found, expected = cuda.footprint.screen_gradients, cpu.footprint.screen_gradients
    assert (found - expected).norm() < 1e-3 * expected.norm()


@pytest.mark.parametrize("name", NAMES[:5])
def test_what_is_not_finite_gets_no_gradient(name):
    values = tensors(20, 3, 1, torch.float32)
    spoilt = values[name].detach().clone()
    spoilt[7].view(-1)[0] = float("nan")
    spoilt = with_values(values, **{name: spoilt})
    found = gradients(outputs_of(by_gsplat(spoilt)), spoilt)
    expected = gradients(outputs_of(by_kernels(spoilt)), spoilt)
    for key in NAMES:
        assert torch.isfinite(found[key]).all(), key
        assert (found[key] - expected[key]).norm() < 1e-3 * expected[key].norm(), key
    for key in NAMES[:5]:
        assert (found[key][7] == 0).all()


def test_double_precision_is_refused():
    with pytest.raises(ValueError, match="renders float32, got torch.float64"):
        by_gsplat(tensors(5, 0, 0))


def test_a_missing_gsplat_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    values = tensors(5, 0, 0, torch.float32)
    with pytest.raises(ValueError, match="needs gsplat: pip install 'gsrain\\[cuda\\]'"):
        render_with_gsplat(*(values[name] for name in NAMES[:5]), camera(), None)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU with gsplat")
def test_gsplat_itself_agrees_with_the_kernels():
    pytest.importorskip("gsplat")
    values = tensors(200, 2, 3, torch.float32)
    values = with_values(values, opacities=0.3 * values["opacities"])  # no pixel ends: there the two differ
    on_gpu = {name: each.detach().cuda().requires_grad_() for name, each in values.items()}
    cuda, cpu = by_kernels(on_gpu), by_kernels(values)
    for one, other in zip(outputs_of(cuda), outputs_of(cpu), strict=True):
        assert (one.cpu() - other).norm() < 1e-3 * other.norm()
    found = gradients(tuple(each.cpu() for each in outputs_of(cuda)), on_gpu)
    expected = gradients(outputs_of(cpu), values)
    for name in NAMES:
        assert (found[name].cpu() - expected[name]).norm() < 5e-3 * expected[name].norm(), name
    pulled, by_cpu = cuda.footprint.screen_gradients.cpu(), cpu.footprint.screen_gradients
    assert (pulled - by_cpu).norm() < 5e-3 * by_cpu.norm()

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.gaussians import Gaussians

from .random_splats import random_splats

torch = pytest.importorskip("torch")
from gsrain_engine.training.parameters import (  # noqa: E402
    NAMES,
    SplatParameters,
)

RATES = {"means": 1e-2, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh_dc": 2e-3, "sh_rest": 1e-4}


def some(n: int = 40, degree: int = 3, seed: int = 0) -> Gaussians:
    return random_splats(n, degree, seed)


def with_gradients(parameters: SplatParameters, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    for each in parameters.tensors.values():
        each.grad = torch.randn(each.shape, generator=generator, dtype=each.dtype)


def same(a: SplatParameters, b: SplatParameters) -> bool:
    mine, other = a.state(), b.state()
    return mine.keys() == other.keys() and all(np.array_equal(mine[name], other[name]) for name in mine)


@given(st.integers(0, 3), st.integers(0, 1000))
def test_gaussians_come_back_to_rounding(degree: int, seed: int) -> None:
    before = some(20, degree, seed)
    after = SplatParameters.from_gaussians(before, degree).to_gaussians()
    assert np.array_equal(after.means, before.means)
    assert np.array_equal(after.sh, before.sh)
    np.testing.assert_allclose(after.scales, before.scales, rtol=2e-6)
    np.testing.assert_allclose(after.opacities, before.opacities, rtol=2e-6)
    np.testing.assert_allclose(after.quaternions, before.quaternions, atol=3e-7)


def test_what_has_no_logarithm_stays_finite() -> None:
    g = some(2)
    flat = Gaussians(g.means, np.zeros_like(g.scales), g.quaternions, np.array([0, 1], np.float32), g.sh)
    back = SplatParameters.from_gaussians(flat, 3).to_gaussians()
    assert np.isfinite(back.scales).all() and back.scales.max() < 1e-11
    np.testing.assert_allclose(back.opacities, [0, 1], atol=1e-6)


def test_harmonics_are_padded_and_cut() -> None:
    g = some(5, 2)
    more = SplatParameters.from_gaussians(g, 3)
    assert more.sh.shape == (5, 16, 3) and float(more.sh[:, 9:].detach().abs().max()) == 0
    assert SplatParameters.from_gaussians(g, 0).tensors["sh_rest"].shape == (5, 0, 3)
    assert more.sh_up_to(1).shape == (5, 4, 3)
    assert np.array_equal(more.sh_up_to(0).detach().numpy(), g.sh[:, :1])


def test_steps_are_those_of_adam() -> None:
    mine = SplatParameters.from_gaussians(some(), 3)
    theirs = {name: each.detach().clone().requires_grad_(True) for name, each in mine.tensors.items()}
    groups = [{"params": [theirs[name]], "lr": RATES[name]} for name in NAMES]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15)
    for seed in range(5):
        with_gradients(mine, seed)
        for name in NAMES:
            theirs[name].grad = mine.tensors[name].grad.clone()
        mine.step(RATES)
        adam.step()
    for name in NAMES:
        np.testing.assert_allclose(mine.tensors[name].detach(), theirs[name].detach(), atol=2e-6)


def test_the_slow_way_of_other_devices_does_the_same() -> None:
    here, there = SplatParameters.from_gaussians(some(), 3), SplatParameters.from_gaussians(some(), 3)
    rows = torch.arange(len(here)) % 3 == 0
    for seed, which in enumerate((None, rows, None)):
        for each in (here, there):
            with_gradients(each, seed)
        here.step(RATES, which)
        shares = 1 - 0.9 ** (seed + 1), 1 - 0.999 ** (seed + 1)
        with torch.no_grad():
            for name, rate in RATES.items():
                there._steps[name] += 1
                there._step_device(name, rate, shares, which)
    for name in NAMES:
        np.testing.assert_allclose(here.tensors[name].detach(), there.tensors[name].detach(), atol=1e-6)


def test_rows_that_were_not_drawn_stay() -> None:
    parameters = SplatParameters.from_gaussians(some(), 3)
    with_gradients(parameters, 0)
    parameters.step(RATES)
    before = parameters.state()
    with_gradients(parameters, 1)
    rows = torch.zeros(len(parameters), dtype=torch.bool)
    rows[7] = True
    parameters.step(RATES, rows)
    for name, array in parameters.state().items():
        if name != "steps" and array.size:
            changed = np.flatnonzero((array != before[name]).reshape(len(array), -1).any(axis=1))
            assert changed.tolist() == [7], name


def test_names_without_a_rate_stay() -> None:
    parameters = SplatParameters.from_gaussians(some(), 3)
    with_gradients(parameters, 0)
    before = parameters.state()
    parameters.step({"sh_dc": 1e-2, "means": 0.0})
    after = parameters.state()
    assert {name for name in NAMES if not np.array_equal(before[name], after[name])} == {"sh_dc"}


def test_moments_follow_their_rows() -> None:
    whole, part = SplatParameters.from_gaussians(some(), 3), SplatParameters.from_gaussians(some(), 3)
    for each in (whole, part):
        with_gradients(each, 0)
        each.step(RATES)
    order = torch.tensor([5, 2, 9])
    part.keep(order)
    part.extend(whole.rows(torch.tensor([1])))
    assert len(part) == 4
    for each in (whole, part):
        each.zero_grad()
        for tensor in each.tensors.values():
            tensor.grad = torch.ones_like(tensor)
        each.step(RATES)
    for name in NAMES:
        kept = part.tensors[name].detach()
        np.testing.assert_allclose(kept[:3], whole.tensors[name].detach()[order], atol=1e-7)
    assert not torch.allclose(part.tensors["means"][3], whole.tensors["means"][1])  # new: its moments began at 0


def test_a_checkpoint_goes_on_to_the_bit() -> None:
    straight = SplatParameters.from_gaussians(some(), 3)
    with_gradients(straight, 0)
    straight.step(RATES)
    resumed = SplatParameters.from_gaussians(some(3), 3)
    resumed.restore(straight.state())
    for each in (straight, resumed):
        with_gradients(each, 1)
        each.step(RATES)
    assert same(straight, resumed)


def test_what_was_put_starts_again() -> None:
    parameters = SplatParameters.from_gaussians(some(), 3)
    with_gradients(parameters, 0)
    parameters.step(RATES)
    rows = torch.tensor([3])
    parameters.put("opacity_logits", rows, torch.tensor([2.0]))
    state = parameters.state()
    assert state["opacity_logits"][3] == 2
    assert state["opacity_logits.first"][3] == 0 and state["opacity_logits.first"][4] != 0
    assert state["means.first"][3].any()


def test_names_are_checked() -> None:
    with pytest.raises(ValueError, match="sh_rest"):
        SplatParameters({"means": torch.zeros(1, 3)})

"""Density control: 3DGS's and MCMC's, by what their papers promise."""

from types import SimpleNamespace

import numpy as np
import pytest

from gsrain_engine.scene.gaussians import Gaussians

from .random_splats import random_splats

torch = pytest.importorskip("torch")
from gsrain_engine.training.mcmc import MAX_COPIES, MCMCSettings, MCMCStrategy, relocation_factors  # noqa: E402
from gsrain_engine.training.parameters import SplatParameters  # noqa: E402
from gsrain_engine.training.strategy import DefaultStrategy, DefaultStrategySettings, rotate_vectors  # noqa: E402


def generator(seed: int = 0):
    return torch.Generator().manual_seed(seed)


def adaptive(**changes: object) -> DefaultStrategy:
    values = {"extent": 10.0, "max_count": 1000, "first_step": 0, "last_step": 100, "every": 10, "reset_every": 0}
    return DefaultStrategy(DefaultStrategySettings(**(values | changes)))


def monte_carlo(**changes: object) -> MCMCStrategy:
    values = {"max_count": 1000, "means_rate": lambda step: 0.0, "first_step": 0, "last_step": 100, "every": 10}
    return MCMCStrategy(MCMCSettings(**(values | changes)))


def picture(gradients, radii=None):
    """Renderer statistics of an image of 200 x 200 px."""
    gradients = torch.as_tensor(gradients, dtype=torch.float32)
    radii = torch.full_like(gradients, 3.0) if radii is None else torch.as_tensor(radii)
    footprint = SimpleNamespace(radii_px=radii, drawn=radii > 0, screen_gradients=gradients)
    return SimpleNamespace(alpha=torch.zeros(200, 200), footprint=footprint)


def parameters(scales=(0.01, 0.01, 1.0, 1.0), opacities=(0.5, 0.5, 0.5, 0.001)) -> SplatParameters:
    g = random_splats(len(scales), 1)
    sizes = np.repeat(np.array(scales, np.float32)[:, None], 3, axis=1)
    return SplatParameters.from_gaussians(Gaussians(g.means, sizes, g.quaternions, np.float32(opacities), g.sh), 1)


def copies_of(g: Gaussians, count: int) -> Gaussians:
    return g.take(np.zeros(count, np.int64))


def axes_of(g: Gaussians) -> np.ndarray:
    return rotate_vectors(torch.as_tensor(g.quaternions).double().repeat(3, 1), torch.eye(3).double()).numpy()


# A gradient of g per px is 100 g in normalized device units at 200 px.


def test_small_are_cloned_large_split_and_faint_pruned() -> None:
    control, splats = adaptive(), parameters()
    before = splats.to_gaussians()
    for step in (3, 110):  # between two changes, and after the last one
        control.observe(step, picture([1, 1, 1, 1]))
        assert control.adapt(step, splats, generator()) is None and len(splats) == 4
    control = adaptive()
    control.observe(9, picture([5e-6, 1e-6, 5e-6, 0]))
    assert control.adapt(10, splats, generator()) == "1 cloned, 1 split, 1 pruned"
    after = splats.to_gaussians()
    assert np.array_equal(after.means[:3], before.means[[0, 1, 0]])
    np.testing.assert_allclose(after.scales[3:], 1 / 1.6, rtol=1e-5)
    assert len(after) == 5 and not np.array_equal(after.means[3], after.means[4])


def test_children_lie_as_their_parent_did() -> None:
    g, n = random_splats(1), 4000
    wide = Gaussians(g.means, np.array([[0.5, 2.0, 0.1]], np.float32), g.quaternions, np.ones(1, np.float32) / 2, g.sh)
    splats = SplatParameters.from_gaussians(copies_of(wide, n), 0)
    control = adaptive(max_count=10 * n)
    control.observe(9, picture(np.full(n, 1e-3)))
    control.adapt(10, splats, generator())
    offsets = splats.to_gaussians().means.astype(np.float64) - g.means
    assert len(offsets) == 2 * n
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=0.08)
    np.testing.assert_allclose(np.std(offsets @ axes_of(g).T, axis=0), [0.5, 2.0, 0.1], rtol=0.05)


def test_gradients_are_averaged_over_pictures_that_show_the_gaussian_and_over_its_rows() -> None:
    control, splats = adaptive(), parameters((0.01, 0.01), (0.5, 0.5))
    for _ in range(3):
        control.observe(9, picture([9, 1e-6, 3e-6, 9]), slice(1, 3))
    control.observe(9, picture([9, 0, 3e-6, 9], radii=[3.0, 0.0, 3.0, 3.0]), slice(1, 3))
    assert control.adapt(10, splats, generator()) == "1 cloned, 0 split, 0 pruned"
    assert np.array_equal(splats.to_means()[2], splats.to_means()[1])


def test_large_ones_go_after_a_reset_and_opacities_are_lowered() -> None:
    control, splats = adaptive(reset_every=20), parameters((0.01, 2.0), (0.5, 0.5))
    for step, change in ((10, ""), (20, ", opacities reset"), (30, "")):
        control.observe(step - 1, picture([0, 0]))
        assert control.adapt(step, splats, generator()) == f"0 cloned, 0 split, {int(step == 30)} pruned{change}"
    np.testing.assert_allclose(splats.to_gaussians().opacities, 0.01, rtol=1e-5)


def test_wide_ones_and_then_the_highest_gradients_win_the_room_that_is_left() -> None:
    for max_count, first_radius_px, change, grown in (
        (6, 3.0, "2 cloned, 0 split, 0 pruned", [0, 1, 2, 3, 1, 3]),
        (5, 20.0, "0 cloned, 1 split, 0 pruned", [1, 2, 3]),
        (4, 3.0, "0 cloned, 0 split, 0 pruned", [0, 1, 2, 3]),
    ):
        control, splats = adaptive(max_count=max_count), parameters((0.01,) * 4, (0.5,) * 4)
        means = splats.to_means()[grown]
        control.observe(9, picture([4e-6, 9e-6, 5e-6, 8e-6], [first_radius_px, 3.0, 3.0, 3.0]))
        assert control.adapt(10, splats, generator()) == change and len(splats) == max_count
        assert np.array_equal(splats.to_means()[: len(grown)], means)


@pytest.mark.parametrize("make", [adaptive, lambda: monte_carlo(means_rate=lambda step: 1e-4)])
def test_a_strategy_restored_from_its_state_changes_the_same_bytes_on_the_cpu(make) -> None:
    first, second = make(), make()
    first.observe(8, picture([5e-6, 1e-6, 5e-6, 0]))
    second.restore(first.state())
    states = []
    for control in (first, second):
        splats = parameters()
        control.observe(9, picture([5e-6, 1e-6, 5e-6, 0]))
        control.adapt(10, splats, generator(3))
        states.append(splats.state())
    assert all(np.array_equal(array, states[1][name]) for name, array in states[0].items())


@pytest.mark.parametrize("copies", [1, 3, MAX_COPIES])
@pytest.mark.parametrize("opacity", [0.02, 0.9, 0.995])
def test_a_stack_has_the_opacity_and_the_integral_of_the_one(opacity: float, copies: int) -> None:
    old = torch.tensor([opacity], dtype=torch.float64)
    new, shrink = relocation_factors(old, torch.tensor([copies]))
    x = np.linspace(-12, 12, 40_001)
    one = opacity * np.exp(-0.5 * x**2)
    stack = 1 - (1 - float(new) * np.exp(-0.5 * (x / float(shrink)) ** 2)) ** copies
    assert stack.max() == pytest.approx(opacity, rel=1e-9)
    assert stack.sum() == pytest.approx(one.sum(), rel=1e-6)


def test_the_dead_move_to_the_living_by_opacity() -> None:
    n = 3000
    splats = parameters((0.1,) * (n + 2), np.r_[np.full(n, 0.001), 0.2, 0.6])
    places = splats.to_means()[n:]
    assert monte_carlo(max_count=0).adapt(10, splats, generator()) == f"{n} relocated, 0 added"
    first, second = ((splats.to_means()[:n] == place).all(axis=1).mean() for place in places)
    assert first + second == 1 and second == pytest.approx(0.75, abs=0.03)


def test_the_number_grows_to_the_cap_and_sources_and_copies_start_anew() -> None:
    control, splats = monte_carlo(max_count=107), parameters((0.1,) * 100, (0.5,) * 100)
    splats.tensors["means"].grad = torch.ones(100, 3)
    splats.step({"means": 1e-9})
    for step, count, least in ((10, 105, 6), (20, 107, 8), (30, 107, 8)):
        control.adapt(step, splats, generator(step))
        assert len(splats) == count and (splats.state()["means.first"] == 0).all(axis=1).sum() >= least


def test_noise_follows_the_covariance_and_spares_the_opaque() -> None:
    n, g = 4000, random_splats(1)
    flat = Gaussians(
        np.zeros((1, 3), np.float32), np.array([[0.3, 0.1, 0.01]], np.float32), g.quaternions,
        np.array([0.004], np.float32), g.sh,
    )  # fmt: skip
    many = Gaussians.concatenate([copies_of(flat, n), random_splats(5)])
    many.opacities[n:] = 0.9
    splats = SplatParameters.from_gaussians(many, 0)
    monte_carlo(means_rate=lambda step: 1e-3, noise=10.0).adapt(3, splats, generator())
    moved = (splats.to_gaussians().means - many.means).astype(np.float64)
    strength = 1e-2 / (1 + np.exp(-100 * (1 - 0.004 - 0.995)))
    spread = np.std(moved[:n] @ axes_of(g).T, axis=0)
    np.testing.assert_allclose(spread, strength * np.array([0.09, 0.01, 1e-4]), rtol=0.06)
    assert np.abs(moved[n:]).max() == 0


def test_the_pull_is_the_mean_of_opacities_and_scales() -> None:
    pull = monte_carlo().regularization(parameters((0.1, 0.3), (0.2, 0.6)))
    assert float(pull.detach()) == pytest.approx(0.01 * 0.4 + 0.01 * 0.2, rel=1e-5)


def test_schedules_scale_with_the_run() -> None:
    paper, half, short = (DefaultStrategySettings.for_run(steps, 1.0, 10) for steps in (30_000, 15_000, 1000))
    assert paper == DefaultStrategySettings(extent=1.0, max_count=10)
    assert (half.first_step, half.last_step, half.every, half.reset_every) == (250, 7500, 50, 1500)
    assert (short.first_step, short.last_step, short.every, short.reset_every) == (30, 500, 25, 1000)
    sampled = MCMCSettings.for_run(3000, 10, lambda step: 0.0)
    assert (sampled.first_step, sampled.last_step, sampled.every) == (50, 2500, 25)

"""Trainable Gaussians and the model of them: activations, Adam, moments that follow their rows, actors on tracks."""

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import Actor, PoseTrack

from .random_splats import random_splats

torch = pytest.importorskip("torch")
from gsrain_engine.render.autodiff.differentiable import render_gaussians  # noqa: E402
from gsrain_engine.training.model import SplatModel  # noqa: E402
from gsrain_engine.training.parameters import (  # noqa: E402
    NAMES,
    AdamStep,
    SplatParameters,
    adam_step,
    fused_adam_step,
)
from render.gsplat_stand_in import adam  # noqa: E402

RATES = {"means": 1e-2, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh_dc": 2e-3, "sh_rest": 1e-4}


def some(n: int = 40) -> SplatParameters:
    return SplatParameters.from_gaussians(random_splats(n, 3), 3)


def with_gradients(parameters: SplatParameters, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    for each in parameters.tensors.values():
        each.grad = torch.randn(each.shape, generator=generator, dtype=each.dtype)


def stepped(parameters: SplatParameters, seed: int = 0, rows=None) -> SplatParameters:
    with_gradients(parameters, seed)
    parameters.step(RATES, rows)
    return parameters


@given(st.integers(0, 3), st.integers(0, 1000))
def test_gaussians_come_back_to_rounding(degree: int, seed: int) -> None:
    before = random_splats(20, degree, seed)
    after = SplatParameters.from_gaussians(before, degree).to_gaussians()
    assert np.array_equal(after.means, before.means)
    assert np.array_equal(after.sh, before.sh)
    np.testing.assert_allclose(after.scales, before.scales, rtol=2e-6)
    np.testing.assert_allclose(after.opacities, before.opacities, rtol=2e-6)
    np.testing.assert_allclose(after.quaternions, before.quaternions, atol=3e-7)


def test_steps_are_those_of_torchs_adam() -> None:
    mine = some()
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


@pytest.mark.parametrize("has_kernel", [False, True])
def test_the_step_of_other_devices_is_that_of_the_kernel(monkeypatch: pytest.MonkeyPatch, has_kernel: bool) -> None:
    calls: list[int] = []

    def counted(*arguments: object) -> None:
        calls.append(1)
        adam(*arguments)

    if has_kernel:
        for name in ("gsplat", "gsplat.cuda", "gsplat.cuda._wrapper"):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        sys.modules["gsplat.cuda._wrapper"].adam = counted  # pyright: ignore[reportAttributeAccessIssue]
    random = np.random.default_rng(0)
    here = [random.normal(size=(40, 3)).astype(np.float32) for _ in range(3)] + [random.random((40, 3), np.float32)]
    here[2] *= np.float32(1e-13)  # first moments so small that epsilon counts
    here[3] *= np.float32(1e-26)
    here[1] *= np.float32(1e-13)
    there = [torch.tensor(each) for each in here]
    for rows in (np.zeros(0, bool), np.arange(40) % 3 == 0):
        adam_step(*here, rows, 1e-2, 0.3, 0.02)
        fused_adam_step([tuple(there)], torch.tensor(rows) if len(rows) else None, [AdamStep(1e-2, 0.3, 0.02)])
        for mine, theirs in zip(here, there, strict=True):
            np.testing.assert_allclose(theirs, mine, rtol=1e-4, atol=1e-6 * np.abs(mine).max())
    assert len(calls) == (2 if has_kernel else 0)


def test_rows_that_were_not_drawn_and_names_without_a_rate_stay() -> None:
    parameters = stepped(some())
    before = parameters.state()
    rows = torch.zeros(len(parameters), dtype=torch.bool)
    rows[7] = True
    for name, array in stepped(parameters, 1, rows).state().items():
        if name != "steps" and array.size:
            changed = np.flatnonzero((array != before[name]).reshape(len(array), -1).any(axis=1))
            assert changed.tolist() == [7], name
    before = parameters.state()
    parameters.step({"sh_dc": 1e-2, "means": 0.0})
    after = parameters.state()
    assert {name for name in NAMES if not np.array_equal(before[name], after[name])} == {"sh_dc"}


def test_moments_follow_their_rows() -> None:
    whole, part = stepped(some()), stepped(some())
    order = torch.tensor([5, 2, 9])
    part.keep(order)
    part.extend(whole.rows(torch.tensor([1])))
    assert len(part) == 4
    for each in (whole, part):
        for tensor in each.tensors.values():
            tensor.grad = torch.ones_like(tensor)
        each.step(RATES)
    for name in NAMES:
        np.testing.assert_allclose(part.tensors[name].detach()[:3], whole.tensors[name].detach()[order], atol=1e-7)
    assert not torch.allclose(part.tensors["means"][3], whole.tensors["means"][1])  # new: its moments began at 0


def test_rows_that_were_put_start_anew() -> None:
    parameters = stepped(some())
    parameters.put("opacity_logits", torch.tensor([3]), torch.tensor([2.0]))
    state = parameters.state()
    assert (state["opacity_logits"][3], state["opacity_logits.first"][3]) == (2, 0)
    assert state["opacity_logits.first"][4] != 0 and state["means.first"][3].any()


# Actors: drawn where their tracks have them, learned in their own frames

TURN = Rotation.from_euler("xyz", [0.3, -0.2, 1.1])
PLACE, WEIGHTS = np.array([0.5, 0.8, 0.4]), torch.linspace(0.2, 1.7, 3)
CAMERA = Camera.from_fov(64, 48, 60.0, look_at(np.array([-6.0, 0.5, 1.0]), np.zeros(3), np.array([0.0, 0.0, 1.0])))


def model() -> SplatModel:
    w_last = TURN.as_quat()
    track = PoseTrack(
        np.array([0.0, 1.0]), np.tile(PLACE, (2, 1)), np.tile(np.roll(w_last, 1), (2, 1)), np.array([True, False])
    )
    van = Actor(id="van", class_name="car", size_lwh=(4.0, 2.0, 2.0), gaussians=random_splats(30, 0, 1), track=track)
    return SplatModel(
        SplatParameters.from_gaussians(random_splats(50, 1, 2), 1),
        None,
        {"van": SplatParameters.from_gaussians(van.gaussians, 0)},
        {"van": van},
    )


def test_an_actor_is_drawn_and_learned_where_its_track_has_it() -> None:
    splats = model()
    picture = splats.render(CAMERA, 0.5)
    assert (picture.background_rows, picture.actor_rows) == (slice(0, 50), {"van": slice(50, 80)})

    # The same Gaussians, put there beforehand.
    own, still = splats.actors["van"].to_gaussians(), splats.background.to_gaussians()
    world = replace(
        own,
        means=(TURN.apply(own.means) + PLACE).astype(np.float32),
        quaternions=np.roll((TURN * Rotation.from_quat(np.roll(own.quaternions, -1, 1))).as_quat(), 1, 1).astype("f4"),
        sh=np.concatenate([own.sh, np.zeros((30, 3, 3), np.float32)], axis=1),
    )
    both = {
        name: torch.tensor(np.concatenate([getattr(still, name), getattr(world, name)]), requires_grad=True)
        for name in ("means", "scales", "quaternions", "opacities", "sh")
    }
    expected = render_gaussians(*both.values(), CAMERA)
    assert torch.allclose(picture.color, expected.color, atol=2e-5)
    assert float(expected.color.detach().max()) > 0.1

    (picture.color * WEIGHTS).sum().backward()
    (expected.color * WEIGHTS).sum().backward()
    learned, moved = splats.actors["van"].tensors["means"].grad.numpy(), both["means"].grad[50:].numpy()
    assert np.linalg.norm(moved) > 0
    np.testing.assert_allclose(TURN.apply(learned), moved, rtol=1e-3, atol=1e-3 * np.abs(moved).max())


def learned(splats: SplatModel, seed: int) -> SplatModel:
    for _, each in splats.parts:
        stepped(each, seed)
    return splats


def test_a_model_restored_from_its_state_goes_on_to_the_bit_on_the_cpu_actors_too() -> None:
    straight, resumed = learned(model(), 0), model()
    resumed.restore(straight.state())
    mine, other = learned(straight, 1).state(), learned(resumed, 1).state()
    assert {f"actors/van:{name}" for name in NAMES} <= mine.keys() == other.keys()
    assert all(np.array_equal(array, other[name]) for name, array in mine.items())

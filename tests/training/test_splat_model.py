"""Things that move in a training: drawn where their tracks have them, learned in their own frames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import Actor, PoseTrack

from .random_splats import random_splats

torch = pytest.importorskip("torch")
from gsrain_engine.render.autodiff.differentiable import render_gaussians  # noqa: E402
from gsrain_engine.training.model import SplatModel  # noqa: E402
from gsrain_engine.training.parameters import (  # noqa: E402
    NAMES,
    SplatParameters,
)

TURN = Rotation.from_euler("xyz", [0.3, -0.2, 1.1])
PLACE = np.array([0.5, 0.8, 0.4])
WEIGHTS = torch.linspace(0.2, 1.7, 3)


def camera() -> Camera:
    return Camera.from_fov(64, 48, 60.0, look_at(np.array([-6.0, 0.5, 1.0]), np.zeros(3), np.array([0.0, 0.0, 1.0])))


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
    picture = splats.render(camera(), 0.5)
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
    expected = render_gaussians(*both.values(), camera())
    assert torch.allclose(picture.color, expected.color, atol=2e-5)
    assert float(expected.color.detach().max()) > 0.1

    (picture.color * WEIGHTS).sum().backward()
    (expected.color * WEIGHTS).sum().backward()
    learned, moved = splats.actors["van"].tensors["means"].grad.numpy(), both["means"].grad[50:].numpy()
    assert np.linalg.norm(moved) > 0
    np.testing.assert_allclose(TURN.apply(learned), moved, rtol=1e-3, atol=1e-3 * np.abs(moved).max())


def test_an_actor_that_is_not_there_takes_no_part() -> None:
    splats = model()
    picture = splats.render(camera(), 1.5)
    assert picture.actor_rows == {}
    alone = SplatModel(splats.background, None, {}, {}).render(camera(), 1.5)
    assert torch.equal(picture.color, alone.color)


def test_a_model_goes_back_to_its_state_actors_too() -> None:
    splats = model()
    before = {name: array.copy() for name, array in splats.state().items()}
    assert {f"actors/van:{name}" for name in NAMES} <= before.keys()
    (splats.render(camera(), 0.5).color * WEIGHTS).sum().backward()
    for _, parameters in splats.parts:
        parameters.step(dict.fromkeys(NAMES, 0.01))
    splats.zero_grad()
    assert not np.array_equal(splats.state()["actors/van:means"], before["actors/van:means"])
    splats.restore(before)
    assert all(np.array_equal(array, before[name]) for name, array in splats.state().items())

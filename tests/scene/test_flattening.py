"""Moved Gaussians, and whole scenes as one set of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.scene.gaussians import Gaussians, evaluate_sh
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.scene.transforms import FILE_UP, flatten_scene, transform_gaussians


def sample(count: int, sh_degree: int = 3, seed: int = 1) -> Gaussians:
    rng = np.random.default_rng(seed)
    f = np.float32
    return Gaussians(
        rng.normal(0, 5, (count, 3)).astype(f),
        rng.uniform(0.01, 0.5, (count, 3)).astype(f),
        normalized(rng.normal(size=(count, 4))).astype(f),
        rng.uniform(0, 1, count).astype(f),
        rng.normal(0, 0.3, (count, (sh_degree + 1) ** 2, 3)).astype(f),
    )


def covariances(g: Gaussians) -> np.ndarray:
    m = matrices_from_quaternions(g.quaternions.astype(np.float64)) * g.scales[:, None, :]
    return m @ m.swapaxes(1, 2)


def similarity(seed: int, scale: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = scale * matrices_from_quaternions(normalized(rng.normal(size=4)))
    matrix[:3, 3] = rng.normal(0, 10, 3)
    return matrix


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100))
@settings(max_examples=25, deadline=None)
def test_moved_gaussians_have_the_moved_ellipsoids_and_colours(seed: int, scale: float) -> None:
    g, matrix = sample(20, seed=seed % 7), similarity(seed, scale)
    m = transform_gaussians(g, matrix)
    a = matrix[:3, :3]
    np.testing.assert_allclose(m.means, g.means @ a.T + matrix[:3, 3], rtol=1e-5, atol=1e-4 * max(scale, 1))
    np.testing.assert_allclose(covariances(m), a @ covariances(g) @ a.T, atol=1e-5 * scale**2)
    np.testing.assert_allclose(np.linalg.norm(m.quaternions, axis=1), 1, atol=1e-6)
    d = np.random.default_rng(seed).normal(size=(20, 3)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    turned = (d @ (a / scale).T).astype(np.float32)
    np.testing.assert_allclose(evaluate_sh(m.sh, turned), evaluate_sh(g.sh, d), atol=1e-5)


def test_the_identity_changes_nothing() -> None:
    g = sample(4)
    assert transform_gaussians(g, np.eye(4)) is g


def car(time_on_track: float = 0.0) -> Actor:
    quarter_left = np.array([[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]] * 2)
    times = np.array([0.0, 1.0]) + time_on_track
    track = PoseTrack(times, np.array([[10.0, 0, 0], [20, 0, 0]]), quarter_left, np.ones(2, np.bool_))
    return Actor("a", "car", (4.5, 1.8, 1.5), sample(6, 1, seed=4), track)


def test_visible_layers_and_actors_at_time_0_are_joined() -> None:
    layers = (Layer("a", sample(5)), Layer("b", sample(7), visible=False), Layer("sky", sample(3, 2), kind="sky"))
    scene = Scene("s", layers, (car(), replace(car(), visible=False)), up=FILE_UP)
    joined = flatten_scene(scene)
    assert len(joined) == 5 + 3 + 6
    np.testing.assert_array_equal(joined.means[:5], layers[0].gaussians.means)
    np.testing.assert_array_equal(joined.sh[:5], layers[0].gaussians.sh)
    np.testing.assert_array_equal(joined.sh[5:8, :9], layers[2].gaussians.sh)
    x, y, z = car().gaussians.means.T
    np.testing.assert_allclose(joined.means[8:], np.stack([10 - y, x, z], axis=1), atol=1e-5)
    np.testing.assert_allclose(flatten_scene(scene, 1.0).means[8:, 0], 20 - y, atol=1e-5)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.3, 0.2, -0.7)])
def test_files_show_in_the_world_what_the_scene_shows(up: tuple[float, float, float]) -> None:
    scene = Scene("s", (Layer("a", sample(9)),), (car(),), metres_per_unit=2.5, up=up)
    read_back = Scene("t", (Layer("t", flatten_scene(scene)),), up=FILE_UP)
    before = Gaussians.concatenate([transform_gaussians(part.gaussians, part.to_world) for part in scene.parts()])
    (part,) = read_back.parts()
    after = transform_gaussians(part.gaussians, part.to_world)
    np.testing.assert_allclose(after.means, before.means, atol=1e-4)
    np.testing.assert_allclose(covariances(after), covariances(before), atol=1e-5)
    np.testing.assert_allclose(after.sh, before.sh, atol=1e-5)


def test_a_scene_without_anything_visible_is_empty() -> None:
    assert len(flatten_scene(Scene("s", (Layer("a", sample(5), visible=False),)))) == 0

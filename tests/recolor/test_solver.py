"""Blending weights of a view, and least squares over them against a dense solver."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.fast_math import harmonics
from gsrain_engine.recolor.solver import TIKHONOV, ColorTarget, apply_normal, evaluate_colors, solve_colors
from gsrain_engine.recolor.weights import MIN_PIECE, STEP, LazyWeights, StoredWeights, weights_of
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.projection import view_directions
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import DrawItem


def ball(count: int = 300, seed: int = 0) -> DrawItem:
    r = np.random.default_rng(seed)
    quaternions = r.normal(size=(count, 4))
    numbers = (
        r.normal(0, 0.5, (count, 3)), np.exp(r.normal(np.log(0.12), 0.4, (count, 3))),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), r.uniform(0.2, 1, count),
        np.zeros((count, 1, 3)),
    )  # fmt: skip
    return DrawItem(Gaussians(*(each.astype(np.float32) for each in numbers)), np.eye(4))


def around(angle: float) -> Camera:
    eye = 4 * np.array([np.cos(angle), np.sin(angle), 0.3 * np.sin(3 * angle)])
    return Camera.from_fov(48, 40, 40, look_at(eye, np.zeros(3), np.array([0.0, 0, 1])))


def views_of(part: DrawItem, truth: np.ndarray, count: int = 6) -> list[ColorTarget]:
    targets = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        camera = around(angle)
        view = color_operator([part], camera)
        weights = weights_of(view)
        indices = view.splats.indices[weights.rows]
        basis = harmonics(view_directions([part], camera, indices), truth.shape[1])
        picture = weights.blend(evaluate_colors(truth, indices, basis))
        targets.append(ColorTarget(weights, indices, basis, picture, np.ones(picture.shape[:2], np.float32)))
    return targets


def solved(targets: list[ColorTarget], count: int, iterations: int, tikhonov: float = TIKHONOV):
    """Norms of the residual, and the change of the harmonics; the prior's weight is the same for all Gaussians."""
    steps = []
    prior = (tikhonov * np.where(np.arange(targets[0].basis.shape[1]) == 0, 1, 4)).astype(np.float32)[None, :, None]
    change = run_to_end(solve_colors(targets, count, iterations, prior), steps.append)
    return [step.length for step in steps], change


def truth_of(count: int, k: int = 4) -> np.ndarray:
    return np.random.default_rng(5).normal(0, 0.5, (count, k, 3)).astype(np.float32)


# Weights


@pytest.fixture(scope="module")
def both() -> tuple[StoredWeights, LazyWeights]:
    view = color_operator([ball()], around(0.4))
    stored = weights_of(view)
    assert isinstance(stored, StoredWeights)
    return stored, LazyWeights(view)


def random_plane(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, shape).astype(np.float32)


def test_stored_weights_blend_and_gather_as_compositing_does(both):
    stored, walked = both
    colors = random_plane(0, len(walked.rows), 3)
    left_out = 60 * MIN_PIECE * STEP  # a few dozen splats of each pixel may each lose that much
    np.testing.assert_allclose(stored.blend(colors[stored.rows]), walked.blend(colors), atol=left_out)
    assert walked.blend(colors).max() > 0.5
    image = random_plane(1, 40, 48, 3)
    expected = walked.accumulate(image)
    np.testing.assert_allclose(stored.accumulate(image), expected[stored.rows], rtol=2e-2, atol=0.05)
    missing = np.setdiff1d(walked.rows, stored.rows)
    assert np.abs(expected[missing]).max(initial=0) < 0.05
    assert isinstance(weights_of(walked.view, max_bytes=100), LazyWeights) and stored.nbytes > 100


def test_forth_and_back_in_one_pass_is_forth_then_back_and_has_the_squares_on_its_diagonal(both):
    stored, walked = both
    colors, trust = random_plane(2, len(stored.rows), 3) - 0.5, random_plane(3, 40, 48)
    expected = stored.accumulate(stored.blend(colors) * trust[..., None])
    np.testing.assert_allclose(stored.normal(colors, trust), expected, rtol=1e-5, atol=1e-5)
    squares = stored.squared_sums(trust)
    for n in (0, 7, len(stored.rows) // 2):
        unit = np.zeros((len(stored.rows), 3), np.float32)
        unit[n] = 1
        assert squares[n] == pytest.approx(stored.normal(unit, trust)[n, 0], rel=1e-4)
    ones = np.ones_like(trust)
    np.testing.assert_allclose(stored.squared_sums(ones), walked.squared_sums(ones)[stored.rows], rtol=2e-2, atol=0.01)


# Solver


def test_the_solution_is_that_of_a_dense_solver():
    targets = views_of(ball(40, 2), truth_of(40, 1), 3)
    matrix = np.zeros((40, 40))
    for n in range(40):
        unit = np.zeros((40, 1, 3), np.float32)
        unit[n] = 1
        matrix[:, n] = apply_normal(targets, unit)[:, 0, 0]
    right = np.zeros((40, 3))
    for target in targets:
        right[target.indices] += target.basis * target.weights.accumulate(target.residual)
    dense = np.linalg.solve(matrix + 0.3 * np.eye(40), right)
    np.testing.assert_allclose(solved(targets, 40, 60, 0.3)[1][:, 0], dense, atol=2e-3)


def test_unobserved_gaussians_and_disabled_harmonics_stay_and_explained_views_need_no_step():
    g = ball(50).gaussians
    behind = Gaussians(g.means + np.float32(100), g.scales, g.quaternions, g.opacities, g.sh)
    both, truth = DrawItem(Gaussians.concatenate([g, behind]), np.eye(4)), truth_of(100)
    lengths, change = solved(views_of(both, truth), 100, 15, 1e-3)
    assert lengths[-1] < 0.05 and not change[50:].any() and np.abs(change[:50]).max() > 0.1
    assert change.tobytes() == solved(views_of(both, truth), 100, 15, 1e-3)[1].tobytes()
    plain = [replace(t, basis=t.basis * np.float32([1, 0, 0, 0])) for t in views_of(ball(50), truth_of(50))]
    _, change = solved(plain, 50, 8)
    assert not change[:, 1:].any() and change[:, 0].any()
    lengths, change = solved(views_of(ball(50), np.zeros((50, 4, 3), np.float32)), 50, 8)
    assert lengths == [] and not change.any()

import numpy as np

from gsrain_engine.recolor.solver import (
    TIKHONOV,
    ColorTarget,
    apply_normal,
    evaluate_colors,
    solve_colors,
)
from gsrain_engine.recolor.weights import weights_of
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.render.cpu.fast_math import harmonics
from gsrain_engine.render.cpu.projection import view_directions
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem


def plain_pull(k: int, tikhonov: float = TIKHONOV) -> np.ndarray:
    """Pull on k harmonics that is the same for all Gaussians."""
    return (tikhonov * np.where(np.arange(k) == 0, 1, 4)).astype(np.float32)[None, :, None]


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


def views_of(part: DrawItem, truth: np.ndarray, count: int = 6, most_bytes: float = np.inf) -> list[ColorTarget]:
    targets = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        camera = around(angle)
        view = color_operator([part], camera)
        weights = weights_of(view, most_bytes)
        indices = view.splats.indices[weights.rows]
        basis = harmonics(view_directions([part], camera, indices), truth.shape[1])
        wanted = weights.blend(evaluate_colors(truth, indices, basis))
        targets.append(ColorTarget(weights, indices, basis, wanted, np.ones(wanted.shape[:2], np.float32)))
    return targets


def run(solver):
    lengths = []
    while True:
        try:
            lengths.append(next(solver).length)
        except StopIteration as end:
            return lengths, end.value


def truth_of(count: int, k: int = 4) -> np.ndarray:
    return np.random.default_rng(5).normal(0, 0.5, (count, k, 3)).astype(np.float32)


def squared_error(targets, change) -> float:
    return sum(
        float(((t.weights.blend(evaluate_colors(change, t.indices, t.basis)) - t.residual) ** 2).sum()) for t in targets
    )


def test_the_normal_operator_is_symmetric_and_never_negative():
    part = ball()
    targets = views_of(part, truth_of(300))
    r = np.random.default_rng(1)
    a, b = (r.normal(size=(300, 4, 3)).astype(np.float32) for _ in range(2))
    left, right = np.vdot(a, apply_normal(targets, b)), np.vdot(apply_normal(targets, a), b)
    size = np.linalg.norm(apply_normal(targets, a)) * np.linalg.norm(b)
    assert abs(left - right) < 1e-5 * size
    assert np.vdot(a, apply_normal(targets, a)) > 0


def test_known_colors_explain_the_views_again():
    part = ball()
    targets = views_of(part, truth_of(300))
    start = squared_error(targets, np.zeros((300, 4, 3), np.float32))
    lengths, change = run(solve_colors(targets, 300, 15, plain_pull(4, 1e-3)))
    assert len(lengths) == 15
    assert lengths[-1] < 0.05
    assert squared_error(targets, change) < 1e-2 * start


def test_the_solution_is_that_of_a_dense_solver():
    part = ball(40, 2)
    targets = views_of(part, truth_of(40, 1), 3)
    matrix = np.zeros((40, 40))
    for n in range(40):
        unit = np.zeros((40, 1, 3), np.float32)
        unit[n] = 1
        matrix[:, n] = apply_normal(targets, unit)[:, 0, 0]
    right = np.zeros((40, 3))
    for target in targets:
        gathered = target.weights.accumulate(target.residual)
        right[target.indices] += target.basis * gathered
    dense = np.linalg.solve(matrix + 0.3 * np.eye(40), right)
    _, change = run(solve_colors(targets, 40, 60, plain_pull(1, 0.3)))
    np.testing.assert_allclose(change[:, 0], dense, atol=2e-3)


def test_what_no_view_sees_does_not_change():
    part = ball(50)
    g = part.gaussians
    behind = Gaussians(g.means + np.float32(100), g.scales, g.quaternions, g.opacities, g.sh)
    both = DrawItem(Gaussians.concatenate([g, behind]), np.eye(4))
    _, change = run(solve_colors(views_of(both, truth_of(100)), 100, 8, plain_pull(4)))
    assert not change[50:].any()
    assert np.abs(change[:50]).max() > 0.1


def test_forbidden_harmonics_stay():
    part = ball(50)
    targets = views_of(part, truth_of(50))
    only_plain = [
        ColorTarget(t.weights, t.indices, t.basis * np.float32([1, 0, 0, 0]), t.residual, t.trust) for t in targets
    ]
    _, change = run(solve_colors(only_plain, 50, 8, plain_pull(4)))
    assert not change[:, 1:].any()
    assert change[:, 0].any()


def test_views_that_are_explained_already_need_no_step():
    part = ball(50)
    targets = views_of(part, np.zeros((50, 4, 3), np.float32))
    lengths, change = run(solve_colors(targets, 50, 8, plain_pull(4)))
    assert lengths == []
    assert not change.any()


def test_the_same_bytes_every_time():
    part = ball()
    first, second = (run(solve_colors(views_of(part, truth_of(300)), 300, 4, plain_pull(4)))[1] for _ in range(2))
    assert first.tobytes() == second.tobytes()

import numba
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from gsrain_engine.render.autodiff.differentiable import render_gaussians  # noqa: E402
from gsrain_engine.scene.camera import Camera  # noqa: E402
from gsrain_engine.scene.scene import DrawItem  # noqa: E402
from oracles.dense_gradients import render_densely  # noqa: E402
from rasterized import rasterize  # noqa: E402
from render.cpu.raster_scenes import random_gaussians, small_camera  # noqa: E402

from .trained_scenes import NAMES, camera, display, gradients, rendered, tensors, with_values  # noqa: E402

EXACT, SINGLE = 1e-9, 1e-3
"""Relative L2: float64 instances of the kernels, and float32."""


def dense(values, view=None):
    return render_densely(*(values[name] for name in NAMES[:5]), view or camera(), values[NAMES[5]])


def doubled(values):
    return {name: each.detach().double().requires_grad_() for name, each in values.items()}


def assert_like_the_dense_one(values, tolerance=EXACT, view=None) -> dict:
    exact = doubled(values)
    fast, slow = rendered(values, view), dense(exact, view)
    for one, other in zip(fast, slow, strict=True):
        assert (one.double() - other).norm() <= tolerance * other.norm()
    found, expected = gradients(fast, values), gradients(slow, exact)
    for name in values:
        assert expected[name].norm() > 0, name
        assert found[name].dtype == values[name].dtype
        assert (found[name].double() - expected[name]).norm() <= tolerance * expected[name].norm(), name
    return found


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_are_those_of_the_dense_reference_at_every_sh_degree(degree):
    assert_like_the_dense_one(tensors(60, degree, degree))


def test_gradients_of_display_colors_are_the_references():
    values = display(tensors(60, 4, 0))
    found = assert_like_the_dense_one(values)["colors"]
    negative = values["colors"] < 0
    assert negative.any()
    assert (found[negative] == 0).all()  # what is cut at 0 does not move


@pytest.mark.parametrize("seed", range(3))
def test_gradients_in_single_precision_are_within_a_thousandth(seed):
    assert_like_the_dense_one(tensors(120, seed, 3, torch.float32), SINGLE)


def test_gradients_are_the_references_where_pixels_finish_and_alpha_is_at_its_most():
    values = tensors(80, 5, 1)
    values = with_values(values, scales=4 * values["scales"], opacities=torch.linspace(0.9, 1, 80).double())
    alpha = rendered(values)[1]
    assert (alpha > 1 - 1e-4).double().mean() > 0.3  # pixels do finish
    assert_like_the_dense_one(values)
    single = {name: each.detach().float().requires_grad_() for name, each in values.items()}
    assert_like_the_dense_one(single, SINGLE)


def test_gradients_are_the_references_where_the_jacobian_is_held_back():
    # Large and near ones whose centres lie far beside the picture, of which only a flank is seen.
    values = tensors(40, 6, 2)
    means = values["means"].detach().clone()
    means[:, 0] = torch.sign(means[:, 0]) * 0.9 * means[:, 2]
    values = with_values(values, means=means, scales=4 * values["scales"])
    x_over_z = (means[:, 0] / means[:, 2]).abs()
    limit = (40 - 0.42 * 40) / 60 + 0.15 * 40 / 60
    assert (x_over_z > 1.2 * limit).all()
    assert_like_the_dense_one(values)


@pytest.mark.parametrize("only", ["color", "alpha", "depth"])
def test_gradients_reach_all_through_one_output_alone(only):
    values = tensors(30, 8, 0)
    place = ("color", "alpha", "depth").index(only)
    geometry = {name: each for name, each in values.items() if name != "colors"}
    found = gradients((rendered(values)[place],), geometry)
    expected = gradients((dense(values)[place],), geometry)
    for name in geometry:
        torch.testing.assert_close(found[name], expected[name], rtol=1e-9, atol=1e-9)


def weighed(view):
    """A few random sums over the whole picture: as strict as its pixels one by one, and far fewer ways back."""
    weights = torch.from_numpy(np.random.default_rng(4).normal(size=(4, 5 * view.width * view.height)))

    def sums(*numbers):
        outputs = rendered(dict(zip(NAMES, numbers, strict=True)), view)
        return weights @ torch.cat([each.reshape(-1) for each in outputs])

    return sums


@pytest.mark.parametrize("change", [dict, display])
def test_numerical_derivatives_agree(change):
    values = change(tensors(5, 3, 2))
    assert torch.autograd.gradcheck(weighed(camera(12, 9)), list(values.values()))


def test_colors_alone_get_the_same_gradients():
    for values in (tensors(60, 2, 3), display(tensors(60, 2, 0))):
        outputs = rendered(values)[:1]
        every = gradients(outputs, values)["colors"]
        fixed = {name: each.detach() for name, each in values.items()} | {"colors": values["colors"]}
        alone = gradients(rendered(fixed)[:1], {"colors": values["colors"]})["colors"]
        torch.testing.assert_close(alone, every, rtol=1e-12, atol=1e-12)


def test_the_picture_is_the_renderers():
    gaussians = random_gaussians(3000, 1, 3)
    view = small_camera(200, 130)
    frame = rasterize([DrawItem(gaussians, np.eye(4))], view)
    g = gaussians
    r = render_gaussians(*map(torch.from_numpy, (g.means, g.scales, g.quaternions, g.opacities, g.sh)), view)
    error = np.dstack([r.color.numpy(), r.alpha.numpy()]) - frame.rgba
    assert -10 * np.log10((error**2).mean()) > 60
    solid = r.alpha.numpy() > 0.5
    np.testing.assert_allclose((r.depth / r.alpha).numpy()[solid], frame.depth[solid], rtol=1e-3)


def test_every_run_gives_the_same_bytes_at_any_thread_count():
    values = tensors(3000, 0, 2, torch.float32)
    view = camera(200, 130)
    results, before = [], numba.get_num_threads()
    try:
        for threads in [*range(1, numba.config.NUMBA_NUM_THREADS + 1), before]:
            numba.set_num_threads(threads)
            outputs = rendered(values, view)
            found = gradients(outputs, values)
            results.append(b"".join(each.detach().numpy().tobytes() for each in (*outputs, *found.values())))
    finally:
        numba.set_num_threads(before)
    assert len(set(results)) == 1


@pytest.mark.parametrize("name", NAMES[:5])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_left_out_and_gets_no_gradient(name, bad):
    values = tensors(20, 3, 1)
    rows = torch.arange(20) != 7
    spoilt = values[name].detach().clone()
    spoilt[7].view(-1)[0] = bad
    spoilt = with_values(values, **{name: spoilt})
    without = {key: each.detach()[rows].requires_grad_() for key, each in values.items() if key != NAMES[5]}
    without[NAMES[5]] = values[NAMES[5]]
    outputs, clean = rendered(spoilt), rendered(without)
    for one, other in zip(outputs, clean, strict=True):
        assert torch.equal(one, other)
    found, expected = gradients(outputs, spoilt), gradients(clean, without)
    for key in NAMES[:5]:
        assert (found[key][7] == 0).all()
        assert torch.equal(found[key][rows], expected[key])
    assert torch.isfinite(found[NAMES[5]]).all()


@pytest.mark.parametrize("colors", [(0, 4, 3), (0, 3)])
def test_an_empty_scene_renders_nothing_and_goes_back(colors):
    shapes = ((0, 3), (0, 3), (0, 4), (0,), colors)
    values = [torch.zeros(shape, requires_grad=True) for shape in shapes]
    pose = torch.eye(4, requires_grad=True)
    r = render_gaussians(*values, small_camera(), world_to_camera=pose)
    assert r.color.shape == (53, 75, 3)
    assert not r.color.any()
    assert not r.alpha.any()
    (r.color.sum() + r.alpha.sum() + r.depth.sum()).backward()
    assert [each.grad.shape for each in values] == list(shapes)
    assert not pose.grad.any()
    assert r.footprint.drawn.shape == r.footprint.screen_gradients.shape == (0,)


def one_ball(x: float = 0.0):
    pose = torch.eye(4).double()
    numbers = ([[x, 0.1, 4.0]], [[0.2, 0.2, 0.2]], [[1.0, 0, 0, 0]], [0.8], [[0.9, 0.5, 0.2]])
    return [torch.tensor(each, dtype=torch.float64, requires_grad=True) for each in numbers], pose


def test_radii_are_three_standard_deviations():
    values, _ = one_ball()
    twin = [torch.cat([each, each]) for each in values]
    twin[0] = twin[0] + torch.tensor([[0, 0, 0], [0, 0, -10.0]])
    footprint = render_gaussians(*twin, Camera(64, 48, 60, 60, 32, 24)).footprint
    tilt = 1 + (0.1 / 4) ** 2  # the ray is slanted, which makes the longer axis
    assert footprint.radii_px[0].item() == pytest.approx(3 * np.sqrt((60 * 0.2 / 4) ** 2 * tilt + 0.3), rel=1e-9)
    assert footprint.radii_px[1].item() == 0
    assert footprint.drawn.tolist() == [True, False]


def test_screen_gradients_are_those_by_the_centre_in_the_image():
    values, _ = one_ball(0.15)
    weights = torch.from_numpy(np.random.default_rng(2).normal(size=(48, 64, 3)))

    def loss(cx: float, cy: float):
        r = render_gaussians(*values, Camera(64, 48, 60, 60, cx, cy))
        return (r.color * weights).sum(), r.footprint

    total, footprint = loss(32.1, 24.2)
    with pytest.raises(RuntimeError, match="after a backward pass"):
        _ = footprint.screen_gradients
    total.backward()
    step = 1e-5  # to move the principal point is to move every center
    across = (loss(32.1 + step, 24.2)[0] - loss(32.1 - step, 24.2)[0]).item() / (2 * step)
    down = (loss(32.1, 24.2 + step)[0] - loss(32.1, 24.2 - step)[0]).item() / (2 * step)
    assert footprint.screen_gradients.tolist() == pytest.approx([np.hypot(across, down)], rel=1e-6)


@settings(max_examples=15)
@given(length=st.floats(0.01, 100), seed=st.integers(0, 5))
def test_a_quaternions_length_changes_nothing_and_is_never_pulled_at(length, seed):
    values = tensors(20, seed, 0)
    longer = with_values(values, quaternions=length * values["quaternions"])
    outputs = rendered(longer)
    for one, other in zip(outputs, rendered(values), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)
    found = gradients(outputs, longer)["quaternions"]
    along = (found * longer["quaternions"]).sum(dim=1)
    assert (along.abs() <= 1e-12 + 1e-9 * found.norm(dim=1) * longer["quaternions"].norm(dim=1)).all()


def test_training_finds_a_picture():
    view = camera(64, 48)
    truth = [each.detach() for each in rendered(tensors(40, 1, 0, torch.float32), view)]
    values = tensors(40, 2, 0, torch.float32)
    colors = values["colors"]
    optimizer = torch.optim.Adam([values["means"], colors, values["opacities"]], lr=0.03)
    losses = []
    for _ in range(40):
        optimizer.zero_grad()
        loss = (rendered(values, view)[0] - truth[0]).abs().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("means", lambda each: each[:, :2], r"means have shape \(6, 2\), expected \(n, 3\)"),
        ("means", lambda each: each.half(), "means are torch.float16, expected torch.float32 or torch.float64"),
        ("scales", lambda each: each[:5], r"scales have shape \(5, 3\), expected \(6, 3\)"),
        ("quaternions", lambda each: each[:, :3], r"quaternions have shape \(6, 3\), expected \(6, 4\)"),
        ("opacities", lambda each: each[:, None], r"opacities have shape \(6, 1\), expected \(6,\)"),
        ("opacities", lambda each: each.float(), "opacities are torch.float32, expected torch.float64"),
        ("colors", lambda each: each[:, :2], r"colors have shape \(6, 2, 3\), expected \(6, 3\) or \(6, k, 3\)"),
        ("world_to_camera", lambda each: each[:3], r"world_to_camera has shape \(3, 4\), expected \(4, 4\)"),
        ("world_to_camera", lambda each: each.float(), "world_to_camera are torch.float32, expected torch.float64"),
    ],
)
def test_what_does_not_fit_is_named(name, change, message):
    values = tensors(6, 0, 1)
    values[name] = change(values[name])
    with pytest.raises(ValueError, match=message):
        rendered(values)


def test_a_backend_that_cannot_take_the_tensors_is_refused():
    values = tensors(6, 0, 1)
    with pytest.raises(ValueError, match="backend 'cuda' can't take tensors on cpu"):
        render_gaussians(*(values[name] for name in NAMES[:5]), camera(), backend="cuda")

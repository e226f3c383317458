"""Differentiable rendering against a dense reference, and by gsplat's stand-in against the kernels."""

import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from gsrain_engine.render.autodiff.differentiable import render_gaussians, render_with_gsplat  # noqa: E402
from gsrain_engine.render.cpu.renderer import CpuRenderer  # noqa: E402
from gsrain_engine.scene.camera import Camera, look_at  # noqa: E402
from oracles.dense_gradients import render_densely  # noqa: E402
from render import gsplat_stand_in  # noqa: E402
from render.cpu.raster_scenes import at_each_thread_count, drawn, random_gaussians, small_camera  # noqa: E402

NAMES = ("means", "scales", "quaternions", "opacities", "colors", "world_to_camera")
EXACT, SINGLE = 1e-9, 1e-3
"""Relative L2: float64 instances of the kernels, and float32."""


def camera(width=40, height=30):
    """Look along +z from beside the origin, turned in every axis."""
    pose = look_at(np.array([0.1, 0.05, -0.2]), np.array([0.2, 0.1, 5.0]), np.array([0.1, -1, 0]))
    base = small_camera(width, height)
    return Camera(width, height, base.fx, base.fy, base.cx, base.cy, pose)


def tensors(count, seed=0, degree=3, dtype=torch.float64):
    """Gaussians and a pose that want gradients; the quaternions are not unit ones.

    Without a degree they have display colors, some of them negative.
    """
    g = random_gaussians(count, seed, degree or 0)
    colors = g.sh if degree is not None else g.sh[:, 0] + 0.3
    arrays = (g.means, g.scales, 1.7 * g.quaternions, g.opacities, colors, camera().world_to_camera)
    values = zip(NAMES, arrays, strict=True)
    return {name: torch.from_numpy(each.astype(np.float64)).to(dtype).requires_grad_() for name, each in values}


def with_values(values, **others):
    """The same Gaussians but for some tensors."""
    return {name: others.get(name, each).detach().clone().requires_grad_() for name, each in values.items()}


def rendered(values, view=None):
    return render_gaussians(*(values[name] for name in NAMES[:5]), view or camera(), world_to_camera=values[NAMES[5]])


def by_gsplat(values):
    gaussians = (values[name] for name in NAMES[:5])
    return render_with_gsplat(*gaussians, camera(), values[NAMES[5]], gsplat_stand_in)


def outputs_of(rendered):
    return rendered.color, rendered.alpha, rendered.depth


def dense(values):
    return render_densely(*(values[name] for name in NAMES[:5]), camera(), values[NAMES[5]])


def gradients(outputs, values):
    """Gradients of a loss that weighs every number of the picture at random."""
    r = np.random.default_rng(1)
    loss = sum((each.double() * torch.from_numpy(r.normal(size=tuple(each.shape)))).sum() for each in outputs)
    found = torch.autograd.grad(loss, list(values.values()))
    return dict(zip(values, found, strict=True))


def assert_near(found, expected, tolerance, what=""):
    assert (found.double() - expected.double()).norm() <= tolerance * expected.norm(), what


def assert_like_the_dense_one(values, tolerance=EXACT):
    exact = {name: each.detach().double().requires_grad_() for name, each in values.items()}
    fast, slow = outputs_of(rendered(values)), dense(exact)
    for one, other in zip(fast, slow, strict=True):
        assert_near(one, other, tolerance)
    found, expected = gradients(fast, values), gradients(slow, exact)
    for name in values:
        assert expected[name].norm() > 0, name
        assert found[name].dtype == values[name].dtype
        assert_near(found[name], expected[name], tolerance, name)
    return found


@pytest.mark.parametrize("degree", [0, 1, 2, 3, None])
def test_gradients_are_those_of_the_dense_reference_for_all_colors(degree):
    values = tensors(60, 4, degree)
    found = assert_like_the_dense_one(values)
    assert_like_the_dense_one({name: each.detach().float().requires_grad_() for name, each in values.items()}, SINGLE)
    if degree is None:
        negative = values["colors"] < 0
        assert negative.any()
        assert (found["colors"][negative] == 0).all()  # what is cut at 0 does not move


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_gradients_are_the_references_where_pixels_finish_and_alpha_is_limited(dtype):
    values = tensors(80, 5, 1, dtype)
    values = with_values(values, scales=4 * values["scales"], opacities=torch.linspace(0.9, 1, 80).to(dtype))
    assert (rendered(values).alpha > 1 - 1e-4).double().mean() > 0.3  # pixels do finish
    assert_like_the_dense_one(values, EXACT if dtype == torch.float64 else SINGLE)


def test_gradients_are_the_references_where_the_jacobian_is_held_back():
    # Large and near ones whose centers lie far beside the picture, of which only a flank is seen.
    values = tensors(40, 6, 2)
    means = values["means"].detach().clone()
    means[:, 0] = torch.sign(means[:, 0]) * 0.9 * means[:, 2]
    values = with_values(values, means=means, scales=4 * values["scales"])
    limit = (40 - 0.42 * 40) / 60 + 0.15 * 40 / 60
    assert ((means[:, 0] / means[:, 2]).abs() > 1.2 * limit).all()
    assert_like_the_dense_one(values)


@pytest.mark.parametrize("place", [0, 1, 2], ids=["color", "alpha", "depth"])
def test_gradients_reach_all_through_one_output_alone(place):
    values = tensors(30, 8, 0)
    geometry = {name: each for name, each in values.items() if name != "colors"}
    found = gradients((outputs_of(rendered(values))[place],), geometry)
    expected = gradients((dense(values)[place],), geometry)
    for name in geometry:
        torch.testing.assert_close(found[name], expected[name], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("degree", [2, None])
def test_numerical_derivatives_agree(degree):
    """Of a few random sums over the whole picture: as strict as its pixels one by one."""
    view = camera(12, 9)
    weights = torch.from_numpy(np.random.default_rng(4).normal(size=(4, 5 * view.width * view.height)))

    def sums(*numbers):
        outputs = outputs_of(rendered(dict(zip(NAMES, numbers, strict=True)), view))
        return weights @ torch.cat([each.reshape(-1) for each in outputs])

    assert torch.autograd.gradcheck(sums, list(tensors(5, 3, degree).values()))


@pytest.mark.parametrize("degree", [3, None])
def test_colors_alone_get_the_same_gradients(degree):
    values = tensors(60, 2, degree)
    every = gradients((rendered(values).color,), values)["colors"]
    fixed = {name: each.detach() for name, each in values.items()} | {"colors": values["colors"]}
    alone = gradients((rendered(fixed).color,), {"colors": values["colors"]})["colors"]
    torch.testing.assert_close(alone, every, rtol=1e-12, atol=1e-12)


def test_the_picture_is_the_renderers():
    g, view = random_gaussians(3000, 1, 3), small_camera(200, 130)
    frame = drawn(CpuRenderer(), g, camera=view, with_depth=True)
    r = render_gaussians(*map(torch.from_numpy, (g.means, g.scales, g.quaternions, g.opacities, g.sh)), view)
    error = np.dstack([r.color.numpy(), r.alpha.numpy()]) - frame.rgba
    assert -10 * np.log10((error**2).mean()) > 60
    solid = r.alpha.numpy() > 0.51
    np.testing.assert_allclose((r.depth / r.alpha).numpy()[solid], frame.depth[solid], rtol=1e-3)


def test_every_run_gives_the_same_bytes_at_any_thread_count():
    values, view = tensors(3000, 0, 2, torch.float32), camera(200, 130)

    def arrays():
        outputs = outputs_of(rendered(values, view))
        found = gradients(outputs, values)
        return b"".join(each.detach().numpy().tobytes() for each in (*outputs, *found.values()))

    assert len(at_each_thread_count(arrays)) == 1


@pytest.mark.parametrize("name", NAMES[:5])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_left_out_and_gets_no_gradient(name, bad):
    values = tensors(20, 3, 1, torch.float32)
    rows = torch.arange(20) != 7
    spoilt = values[name].detach().clone()
    spoilt[7].view(-1)[0] = bad
    spoilt = with_values(values, **{name: spoilt})
    without = {key: each.detach()[rows].requires_grad_() for key, each in values.items() if key != NAMES[5]}
    without[NAMES[5]] = values[NAMES[5]]
    outputs, clean = outputs_of(rendered(spoilt)), outputs_of(rendered(without))
    for one, other in zip(outputs, clean, strict=True):
        assert torch.equal(one, other)
    found, expected = gradients(outputs, spoilt), gradients(clean, without)
    by_stand_in = gradients(outputs_of(by_gsplat(spoilt)), spoilt)
    for key in NAMES[:5]:
        assert (found[key][7] == 0).all()
        assert (by_stand_in[key][7] == 0).all()
        assert torch.equal(found[key][rows], expected[key])
    for key in NAMES:
        assert torch.isfinite(found[key]).all()
        assert_near(by_stand_in[key], found[key], SINGLE, key)


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


def test_a_footprint_has_three_standard_deviations_and_the_gradient_by_the_center_in_the_image():
    numbers = ([[0.15, 0.1, 4.0], [0, 0, -6]], [[0.2] * 3] * 2, [[1.0, 0, 0, 0]] * 2, [0.8] * 2, [[0.9, 0.5, 0.2]] * 2)
    values = [torch.tensor(each, dtype=torch.float64, requires_grad=True) for each in numbers]
    weights = torch.from_numpy(np.random.default_rng(2).normal(size=(48, 64, 3)))

    def loss(cx, cy):
        r = render_gaussians(*values, Camera(64, 48, 60, 60, cx, cy))
        return (r.color * weights).sum(), r.footprint

    total, footprint = loss(32.1, 24.2)
    assert footprint.drawn.tolist() == [True, False]
    tilt = 1 + (0.15**2 + 0.1**2) / 4**2  # the ray is slanted, which makes the longer axis
    radius = 3 * np.sqrt((60 * 0.2 / 4) ** 2 * tilt + 0.3)
    assert footprint.radii_px.tolist() == pytest.approx([radius, 0], rel=1e-9)
    with pytest.raises(RuntimeError):
        _ = footprint.screen_gradients
    total.backward()
    step = 1e-5  # to move the principal point is to move every center
    across = (loss(32.1 + step, 24.2)[0] - loss(32.1 - step, 24.2)[0]).item() / (2 * step)
    down = (loss(32.1, 24.2 + step)[0] - loss(32.1, 24.2 - step)[0]).item() / (2 * step)
    assert footprint.screen_gradients.tolist() == pytest.approx([np.hypot(across, down), 0], rel=1e-6)


@settings(max_examples=15)
@given(length=st.floats(0.01, 100), seed=st.integers(0, 5))
def test_a_quaternions_length_changes_nothing_and_is_never_pulled_at(length, seed):
    values = tensors(20, seed, 0)
    longer = with_values(values, quaternions=length * values["quaternions"])
    outputs = outputs_of(rendered(longer))
    for one, other in zip(outputs, outputs_of(rendered(values)), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)
    found = gradients(outputs, longer)["quaternions"]
    along = (found * longer["quaternions"]).sum(dim=1)
    assert (along.abs() <= 1e-12 + 1e-9 * found.norm(dim=1) * longer["quaternions"].norm(dim=1)).all()


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("means", lambda each: each[:, :2], "(n, 3)"),
        ("means", lambda each: each.half(), "torch.float64"),
        ("scales", lambda each: each[:5], "(6, 3)"),
        ("quaternions", lambda each: each[:, :3], "(6, 4)"),
        ("opacities", lambda each: each[:, None], "(6,)"),
        ("opacities", lambda each: each.float(), "torch.float64"),
        ("colors", lambda each: each[:, :2], "(6, k, 3)"),
        ("world_to_camera", lambda each: each[:3], "(4, 4)"),
        ("world_to_camera", lambda each: each.float(), "torch.float64"),
    ],
)
def test_what_does_not_fit_is_named(name, change, expected):
    values = tensors(6, 0, 1)
    values[name] = change(values[name])
    with pytest.raises(ValueError) as error:
        rendered(values)
    assert str(error.value).startswith(name)
    assert expected in str(error.value)


def test_back_ends_that_cannot_take_the_tensors_are_refused(monkeypatch):
    gaussians = [values for name, values in tensors(6, 0, 1).items() if name in NAMES[:5]]
    with pytest.raises(ValueError, match="cpu"):
        render_gaussians(*gaussians, camera(), backend="cuda")
    with pytest.raises(ValueError, match="float32"):
        render_with_gsplat(*gaussians, camera(), None, gsplat_stand_in)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(ValueError, match="gsplat"):
        render_with_gsplat(*(each.float() for each in gaussians), camera(), None)


# By gsplat


def assert_back_ends_agree(render, values, on_device, tolerance):
    """Pictures, gradients and footprints of a back end's tensors and of the kernels'."""
    theirs, ours = render(on_device), rendered(values)
    with pytest.raises(RuntimeError):
        _ = theirs.footprint.screen_gradients
    pictures = [tuple(each.cpu() for each in outputs_of(found)) for found in (theirs, ours)]
    for one, other in zip(*pictures, strict=True):
        assert_near(one, other, tolerance / 5)
    found, expected = gradients(pictures[0], on_device), gradients(pictures[1], values)
    for name in NAMES:
        assert_near(found[name].cpu(), expected[name], tolerance, name)
    footprints = []
    for each in (render(on_device), rendered(values)):
        each.color.square().sum().backward()
        footprints.append(each.footprint)
    assert_near(*(each.screen_gradients.cpu() for each in footprints), tolerance)
    theirs, ours = (each.radii_px.cpu() for each in footprints)
    assert (theirs > 0).sum() > 20
    assert (ours[theirs > 0] > 0).all()  # ours also counts what only meets the edge
    torch.testing.assert_close(theirs[theirs > 0], ours[theirs > 0], rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("degree", [0, 2, 3, None])
def test_both_back_ends_give_one_picture_one_gradient_and_one_footprint(degree):
    values = tensors(60, 2, degree, torch.float32)
    assert_back_ends_agree(by_gsplat, values, values, SINGLE)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU with gsplat")
def test_gsplat_itself_agrees_with_the_kernels():
    pytest.importorskip("gsplat")
    values = tensors(200, 2, 3, torch.float32)
    values = with_values(values, opacities=0.3 * values["opacities"])  # no pixel ends: there the two differ
    on_gpu = {name: each.detach().cuda().requires_grad_() for name, each in values.items()}
    assert_back_ends_agree(rendered, values, on_gpu, 5e-3)

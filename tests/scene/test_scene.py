import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import matrices_from_quaternions, quaternion_product, quaternions_from_matrices
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene, rotation_to_z_up

unit = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: np.array(q) / np.linalg.norm(q))
)


def some(n=3, k=1):
    f = np.float32
    return Gaussians(
        np.arange(3 * n, dtype=f).reshape(n, 3), np.ones((n, 3), f), np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
        np.ones(n, f), np.zeros((n, k, 3), f),
    )  # fmt: skip


def track(valid=(True, True, True)):
    quarter = Rotation.from_euler("z", [[0], [90], [90]], degrees=True).as_quat()[:, [3, 0, 1, 2]]
    return PoseTrack(np.array([0.0, 1, 3]), np.array([[0.0, 0, 0], [2, 0, 0], [2, 4, 0]]), quarter, np.array(valid))


@given(unit)
def test_quaternions_and_matrices_are_scipys(q):
    matrix = matrices_from_quaternions(q)
    assert np.allclose(matrix, Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), atol=1e-12)
    assert np.allclose(matrices_from_quaternions(quaternions_from_matrices(matrix)), matrix, atol=1e-9)


@given(unit, unit)
def test_products_compose(a, b):
    both = matrices_from_quaternions(quaternion_product(a, b))
    assert np.allclose(both, matrices_from_quaternions(a) @ matrices_from_quaternions(b), atol=1e-12)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda u: np.linalg.norm(u) > 0.1))
@example((0.0, 5.96e-8, -0.5))
@example((1e-9, 1e-3, -1.0))
def test_up_becomes_z(up):
    turn = rotation_to_z_up(up)
    assert np.allclose(turn @ (np.array(up) / np.linalg.norm(up)), [0, 0, 1], atol=1e-9)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)


def test_up_along_an_axis_is_exact():
    for axis in range(3):
        for sign in (1.0, -1.0):
            up = tuple(sign * np.eye(3)[axis])
            assert set(np.abs(rotation_to_z_up(up)).ravel()) == {0.0, 1.0}


def test_tracks_interpolate_linearly_and_along_the_arc():
    pose = track().pose(0.5)
    assert pose is not None
    assert pose[:3, 3] == pytest.approx([1, 0, 0])
    assert np.allclose(pose[:3, :3], Rotation.from_euler("z", 45, degrees=True).as_matrix())
    before, after = track().pose(-5.0), track().pose(99.0)
    assert before is not None
    assert after is not None
    assert before[:3, 3] == pytest.approx([0, 0, 0])
    assert after[:3, 3] == pytest.approx([2, 4, 0])


def test_an_actor_is_there_only_while_its_track_is_valid():
    scene = Scene("s", (Layer("a", some()),), (Actor("x", "car", (4.0, 2.0, 1.5), some(), track((True, False, True))),))
    assert [len(scene.parts(t)) for t in (0.5, 1.5, 3.5)] == [2, 1, 2]


def test_parts_take_units_up_and_pose_to_the_world():
    scene = Scene("s", (Layer("a", some()),), (Actor("x", "car", (4.0, 2.0, 1.5), some(), track()),),
                  metres_per_unit=2.0, up=(0.0, -1.0, 0.0))  # fmt: skip
    layer, actor = scene.parts(1.0)
    assert layer.to_world @ [0, -1, 0, 1] == pytest.approx([0, 0, 2, 1])
    assert actor.to_world @ [1, 0, 0, 1] == pytest.approx(layer.to_world @ [2, 1, 0, 1])


def test_ego_pose_has_metres_and_no_scale():
    scene = Scene("s", ego=track(), metres_per_unit=3.0)
    pose = scene.ego_to_world(0.5)
    assert pose is not None
    assert pose[:3, 3] == pytest.approx([3, 0, 0])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_hidden_layers_are_not_drawn_and_unknown_ones_refused():
    scene = Scene("s", (Layer("a", some()), Layer("b", some(), visible=False)))
    assert len(scene.parts()) == 1
    assert scene.gaussian_count == 6
    assert len(scene.with_member("layers/a", gaussians=some(5)).layers[0].gaussians) == 5
    with pytest.raises(KeyError, match="layers/c"):
        scene.member("layers/c")


def test_concatenation_pads_harmonics():
    joined = Gaussians.concatenate([some(2, 1), some(3, 9)])
    assert joined.sh.shape == (5, 9, 3)
    assert joined.sh_degree == 2
    assert len(Gaussians.concatenate([])) == 0


def test_shapes_that_do_not_fit_are_refused():
    g = some(2)
    with pytest.raises(ValueError, match="2 coefficients a color"):
        g.with_sh(np.zeros((2, 2, 3), np.float32))


def test_color_harmonics_show_the_color():
    from gsrain_engine.scene.gaussians import SH_C0

    color = np.array([[0.2, 0.5, 0.9]], np.float32)
    assert sh_from_color(color)[0, 0] * SH_C0 + 0.5 == pytest.approx(color[0])

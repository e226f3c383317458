import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.street.layout import Label
from gsrain_engine.scene.street.mesh import Quads, box, even_lines, graded_lines, panel, tube


def _areas(quads: Quads) -> np.ndarray:
    c = quads.corners.astype(np.float64)
    return 0.5 * np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]), axis=1)


@given(st.lists(st.floats(0.02, 9.0), min_size=1, max_size=5), st.floats(0.01, 0.2), st.floats(0.2, 1.0))
def test_graded_lines_rise_and_hit_every_break(lengths: list[float], edge: float, coarse: float) -> None:
    breaks = [0.0, *np.cumsum(lengths)]
    lines = graded_lines(breaks, edge, coarse)
    assert (np.diff(lines) > 0).all()
    for at in breaks:
        assert np.min(np.abs(lines - at)) < 1e-9
    assert np.diff(lines).max() <= max(1.5 * coarse, 1.5 * edge) + 1e-9


def test_cells_are_fine_at_the_edges() -> None:
    steps = np.diff(graded_lines([0.0, 4.0], 0.05, 0.5))
    assert steps[0] == pytest.approx(0.05)
    assert steps.max() > 0.4
    assert steps[0] < steps[1] < steps[2]


def test_panel_faces_u_cross_v_and_keeps_its_area() -> None:
    quads = panel(
        (1, 2, 3), (1, 0, 0), (0, 0, 1), even_lines(0.0, 2.0, 0.3), even_lines(0.0, 1.5, 0.2), 0.5, Label.BUILDING
    )
    np.testing.assert_allclose(quads.normals, np.tile([0, -1, 0], (len(quads), 1)), atol=1e-6)
    assert _areas(quads).sum() == pytest.approx(3.0, rel=1e-5)


def test_box_faces_outwards() -> None:
    quads = box((1, 2, 3), (2, 1, 0.5), 0.5, Label.FURNITURE, faces="xXyYzZ")
    outward = quads.centers - np.array([1, 2, 3], np.float32)
    assert (np.sum(outward * quads.normals, axis=1) > 0).all()
    assert _areas(quads).sum() == pytest.approx(2 * (2 * 1 + 2 * 0.5 + 1 * 0.5), rel=1e-5)


def test_tube_faces_outwards() -> None:
    z = np.linspace(0, 2, 6)
    path = np.stack([np.zeros(6), np.zeros(6), z], axis=1)
    quads = tube(path, np.full(6, 0.1), 0.5, Label.POLE, sides=12)
    assert (np.sum(quads.centers[:, :2] * quads.normals[:, :2], axis=1) > 0.09).all()


def test_repeated_moves_whole_copies() -> None:
    one = box((0, 0, 0), (1, 1, 1), 0.5, Label.CAR)
    two = one.repeated(np.array([[0.0, 0, 0], [5.0, 0, 0]]))
    np.testing.assert_allclose(two.corners[len(one) :], one.corners + np.float32([5, 0, 0]))
    np.testing.assert_array_equal(two.normals[len(one) :], one.normals)

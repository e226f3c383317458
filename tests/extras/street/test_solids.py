"""Smooth solids: closed meshes with outward normals, occlusion where they meet, and shade from a light."""

import numpy as np
import pytest

from gsrain_extras.street.people import FIGURES, build_person, person_size
from gsrain_extras.street.solids import ellipsoid, mesh_solids, round_cone


def test_a_ball_is_closed_round_and_faces_outwards() -> None:
    ball = mesh_solids([ellipsoid((0.1, -0.2, 0.3), (0.2, 0.2, 0.2), 4)], 0.02)
    outward = ball.centers - [0.1, -0.2, 0.3]
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), 0.2, atol=0.004)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.sum(ball.normals * outward, axis=1).min() > 0.98
    crossed = 0.5 * np.cross(ball.corners[:, 2] - ball.corners[:, 0], ball.corners[:, 3] - ball.corners[:, 1])
    assert np.sum(crossed * outward, axis=1).min() > 0  # corners counter-clockwise from outside
    np.testing.assert_allclose(crossed.sum(axis=0), 0, atol=1e-9)  # closed: areas cancel
    assert np.linalg.norm(crossed, axis=1).sum() == pytest.approx(4 * np.pi * 0.2**2, rel=0.03)
    assert set(ball.materials.tolist()) == {4} and ball.sky_access.min() > 0.95


def test_joints_are_darker_and_the_lee_is_in_the_shade() -> None:
    limbs = [round_cone((0, 0, 0), (0, 0, 0.6), 0.05, 0.05, 0), round_cone((0, 0.1, 0), (0, 0.1, 0.6), 0.05, 0.05, 1)]
    pair = mesh_solids(limbs, 0.02)
    _, y, z = pair.centers.T
    middle = (z > 0.1) & (z < 0.5)
    crease = middle & (np.abs(y - 0.05) < 0.02)
    assert pair.sky_access[crease].mean() < 0.85 < 0.95 < pair.sky_access[middle & (y < -0.03)].mean()
    sun = np.array([0.0, 1.0, 0.0])
    lit = pair.field.lit(pair.centers + 0.01 * pair.normals, sun)
    facing = pair.normals @ sun > 0.5
    assert lit[middle & facing & (y > 0.12)].min() > 0.9 > 0.5 > lit[middle & facing & (y < 0.06)].mean()


@pytest.mark.parametrize("figure", [FIGURES[0], FIGURES[3]])
def test_people_fill_their_boxes_and_stand_on_the_ground(figure) -> None:
    points = build_person(figure).corners.reshape(-1, 3)
    length, width, height = person_size(figure)
    low, high = points.min(axis=0), points.max(axis=0)
    assert high[2] == pytest.approx(height, abs=0.06) and abs(low[2]) < 0.04
    assert (np.maximum(np.abs(low), np.abs(high))[:2] < np.array([length, width]) / 2 + 0.12).all()

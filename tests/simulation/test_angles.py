"""Angles that differ by whole turns."""

import numpy as np
import pytest

from gsrain_engine.simulation.geometry import wrap_angle, wrap_degrees


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
@pytest.mark.parametrize("angle", [-3.1, -1.0, 0.0, 0.5, 3.1])
def test_whole_turns_do_not_matter(angle, turns):
    assert wrap_angle(angle + turns * 2 * np.pi) == pytest.approx(angle, abs=1e-12)
    assert wrap_degrees(np.degrees(angle) + 360.0 * turns) == pytest.approx(np.degrees(angle), abs=1e-9)


def test_half_a_turn_is_to_the_right():
    assert wrap_angle(np.pi) == -np.pi and wrap_degrees(180.0) == -180.0


def test_many_at_once():
    np.testing.assert_allclose(wrap_angle(np.array([0.0, 4.0, -4.0])), [0.0, 4.0 - 2 * np.pi, 2 * np.pi - 4.0])

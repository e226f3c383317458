import numpy as np
import pytest

from gsrain_engine.scene.gaussians import evaluate_sh
from gsrain_engine.scene.scene import UNCHANGED, ColorGrading, grade_sh


def test_defaults_change_nothing():
    assert np.allclose(UNCHANGED.matrix, np.eye(3, 4))


def test_a_stop_doubles_light_and_grey_stays_grey():
    matrix = ColorGrading(exposure_ev=1, saturation=0.3).matrix
    assert matrix @ [0.2, 0.2, 0.2, 1] == pytest.approx(np.full(3, 0.2 * 2 ** (1 / 2.2)))
    assert ColorGrading(contrast=1.7).matrix @ [0.5, 0.5, 0.5, 1] == pytest.approx([0.5] * 3)
    grey = ColorGrading(saturation=0).matrix @ [0.9, 0.2, 0.1, 1]
    assert np.ptp(grey) < 1e-12
    warm = ColorGrading(temperature=0.4).matrix @ [0.5, 0.5, 0.5, 1]
    assert warm[0] > warm[1] > warm[2]
    green = ColorGrading(tint=-0.4).matrix @ [0.5, 0.5, 0.5, 1]
    assert green[1] > green[0] == pytest.approx(green[2])


def test_harmonics_are_graded_like_the_colours_they_show():
    rng = np.random.default_rng(1)
    sh = rng.normal(0, 0.3, (20, 16, 3)).astype(np.float32)
    directions = rng.normal(size=(20, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrix = ColorGrading(exposure_ev=0.7, temperature=0.3, tint=-0.2, contrast=1.4, saturation=0.6).matrix
    expected = evaluate_sh(sh, directions) @ matrix[:, :3].T + matrix[:, 3]
    assert evaluate_sh(grade_sh(sh, matrix), directions) == pytest.approx(expected, abs=1e-5)

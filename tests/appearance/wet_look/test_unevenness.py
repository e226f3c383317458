"""Small slopes of the water's surface: by place alone, as steep as asked for, and gone where a pixel hides them."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.noise import lattice_noise_at, tilt_normals, water_slopes


def places(x0=0.0, n=200, step=0.05):
    x, y = np.meshgrid(x0 + step * np.arange(n), step * np.arange(n))
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def test_bumps_have_mean_0_and_variance_1_at_any_size():
    for size in (3.0, 0.7, 0.1):
        found = lattice_noise_at(places(n=400, step=0.37), size, 0.4, 1)
        assert found.std() == pytest.approx(1, abs=0.12)
        assert abs(found.mean()) < 0.15


def test_slopes_belong_to_places():
    near = np.full((200, 200), 0.001, np.float32)
    one, other = water_slopes(places(), near, 0), water_slopes(places(x0=2.0), near, 0)
    np.testing.assert_allclose(one[:, 40:], other[:, :-40], atol=0.05)
    assert one.std() == pytest.approx(1, rel=0.12)
    assert abs(np.corrcoef(one[..., 0].ravel(), one[..., 1].ravel())[0, 1]) < 0.1


def test_what_a_pixel_hides_tilts_nothing():
    far = np.full((200, 200), 20.0, np.float32)
    assert np.abs(water_slopes(places(), far, 0)).max() < 0.01


def test_normals_are_tilted_by_the_angle_of_the_slope():
    up = np.array([[[0.0, 0, 1]]], np.float32)
    found = tilt_normals(up, np.array([[[2.0, 0]]], np.float32), 0.05)
    np.testing.assert_allclose(found[0, 0], np.array([0.1, 0, 1]) / np.hypot(1, 0.1), atol=1e-6)

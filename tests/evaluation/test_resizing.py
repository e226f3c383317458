"""Resizing is Pillow's filter in float, and does not alias."""

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.evaluation.fid_features import cell_statistics, resized


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(0).integers(64, 192, (90, 120, 3)).astype(np.uint8)


def test_it_is_pillows_bicubic_of_bytes_but_for_the_rounding(picture):
    """Pillow rounds twice, between its two passes and after them: half a level each, the first through the filter."""
    ours = resized(picture, 61, 47)
    pillow = np.asarray(Image.fromarray(picture).resize((61, 47), Image.Resampling.BICUBIC), np.float32)
    assert ours.shape == (47, 61, 3)
    assert np.abs(ours - pillow).max() <= 1.2
    assert np.abs(ours - pillow).mean() < 0.4
    assert (ours != np.rint(ours)).mean() > 0.9


def test_it_is_a_bicubic_sum_of_source_pixels(picture):
    """Keys' kernel with a = -0.5, stretched by the scale and normalized, at one pixel."""
    ours, scale = resized(picture, 40, 30), 3.0

    def weights(at, count):
        t = np.abs((np.arange(count) + 0.5 - (at + 0.5) * scale) / scale)
        near, far = 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
        values = np.where(t < 1, near, np.where(t < 2, far, 0))
        return values / values.sum()

    expected = np.einsum("y,x,yxc->c", weights(12, 90), weights(20, 120), picture.astype(np.float64))
    np.testing.assert_allclose(ours[12, 20], expected, atol=1e-3)


def test_fine_stripes_become_grey_and_nothing_leaves_the_range():
    stripes = np.zeros((256, 256, 3), np.uint8)
    stripes[:, ::2] = 255
    assert np.abs(resized(stripes, 60, 60)[:, 3:-3] - 127.5).max() < 3
    edge = np.zeros((64, 64, 3), np.uint8)
    edge[:, 32:] = 255
    larger = resized(edge, 299, 299)
    assert (larger.min(), larger.max()) == (0, 255)


def test_cell_statistics_see_colour_and_direction(picture):
    assert cell_statistics(picture).shape == (160,)
    flat = np.full((50, 70, 3), (51, 102, 204), np.uint8)
    cells = cell_statistics(flat).reshape(16, 10)
    np.testing.assert_allclose(cells[:, :3], np.tile([0.2, 0.4, 0.8], (16, 1)), atol=1e-6)
    np.testing.assert_allclose(cells[:, 3:], 0, atol=1e-3)
    upright = np.zeros((128, 128, 3), np.uint8)
    upright[:, ::16] = 255
    across, _, down, _ = cell_statistics(upright).reshape(16, 10)[:, 6:].mean(axis=0)
    assert across > 0.05
    assert down < 1e-6
    assert not np.array_equal(cell_statistics(picture), cell_statistics(picture[::-1]))

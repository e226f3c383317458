import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.evaluation.detection.description import DetectorDescription
from gsrain_engine.evaluation.detection.detector import letterbox, network_input

SIDES = st.integers(1, 3000)
FITS = st.sampled_from(["letterbox", "letterbox_corner", "stretch"])


@given(SIDES, SIDES, st.integers(32, 800), st.integers(32, 800), FITS)
def test_the_whole_picture_comes_back_whole(width: int, height: int, wide: int, high: int, fit: str):
    placement = letterbox((width, height), (wide, high), fit)
    left, top = placement.left, placement.top
    assert left >= 0 and left + placement.width <= wide
    assert top >= 0 and top + placement.height <= high
    assert placement.width == wide or placement.height == high
    inside = np.array([[left, top, left + placement.width, top + placement.height]], np.float32)
    assert placement.in_image(inside)[0] == pytest.approx((0, 0, width, height))


def test_bars_are_where_the_description_says():
    picture = np.full((10, 20, 3), (250, 100, 50), np.uint8)
    for fit, rows in (("letterbox", slice(16, 48)), ("letterbox_corner", slice(0, 32)), ("stretch", slice(0, 64))):
        description = DetectorDescription(decode="yolo", fit=fit, padding=7, scale=1)
        values = network_input(picture, letterbox((20, 10), (64, 64), fit), (64, 64), description)
        expected = np.full((3, 64, 64), 7, np.float32)
        expected[:, rows] = np.array([250, 100, 50])[:, None, None]
        assert np.array_equal(values[0], expected)


def test_values_are_ordered_scaled_and_normalized():
    picture = np.full((32, 32, 3), (255, 128, 0), np.uint8)
    description = DetectorDescription(
        decode="yolo", channels="bgr", scale=1 / 255, mean=(0.1, 0.2, 0.3), deviation=(0.5, 0.25, 2)
    )
    values = network_input(picture, letterbox((32, 32), (32, 32), "stretch"), (32, 32), description)
    assert values[0, :, 9, 9] == pytest.approx([(0 - 0.1) / 0.5, (128 / 255 - 0.2) / 0.25, (1 - 0.3) / 2], rel=1e-5)
    assert values.dtype == np.float32 and values.flags.c_contiguous

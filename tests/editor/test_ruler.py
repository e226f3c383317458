"""Positions of times on the timeline's ruler."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.timeline import Ruler


@given(st.floats(0, 100), st.floats(0.2, 500), st.floats(0, 800), st.floats(-5, 5))
def test_the_ruler_zooms_about_the_mouse_and_comes_back_from_pixels(first, shown, x, steps):
    ruler = Ruler(first, shown, 800.0)
    assert ruler.x(ruler.time(x)) == pytest.approx(x, abs=1e-6)
    held = ruler.time(x)
    ruler.zoom(steps, x)
    if ruler.first_s > -0.0399 * ruler.visible_span_s:  # not held back at 0
        assert ruler.time(x) == pytest.approx(held, abs=1e-6 * ruler.visible_span_s)


def test_the_ruler_fits_shows_and_pans():
    ruler = Ruler(width_px=100.0)
    ruler.fit(2.0, 12.0)
    assert 0 < ruler.x(2.0) < 10 < 90 < ruler.x(12.0) < 100
    first = ruler.first_s
    ruler.show(5.0)
    assert ruler.first_s == first
    ruler.show(50.0)
    assert ruler.first_s < 50 < ruler.first_s + 2
    ruler.pan(10.0)
    assert ruler.x(50.0) == pytest.approx(14.0, abs=1.0)
    ruler.pan(1e6)
    assert ruler.x(0.0) == pytest.approx(4.0, abs=0.1)

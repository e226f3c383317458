import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.selection.screen import outlines, polygon, rectangle, stroke

W, H = 40, 30
places = st.tuples(st.integers(-1300, 3900), st.integers(-1300, 3300)).map(lambda xy: (xy[0] / 65, xy[1] / 65))


def centers():
    return np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)


@given(places, places)
def test_rectangle_takes_pixel_centers_between_its_corners(first, second):
    x, y = centers()
    inside = (x >= min(first[0], second[0])) & (x <= max(first[0], second[0]))
    inside &= (y >= min(first[1], second[1])) & (y <= max(first[1], second[1]))
    assert np.array_equal(rectangle(first, second, W, H), inside)


@given(st.lists(places, min_size=3, max_size=12))
def test_polygon_is_even_odd_at_the_centers_of_pixels(corners):
    x, y = centers()
    inside, distance = np.zeros((H, W), bool), np.full((H, W), np.inf)
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        if y0 != y1:
            crosses = (y0 <= y) != (y1 <= y)
            inside ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
        length = max((x1 - x0) ** 2 + (y1 - y0) ** 2, 1e-12)
        t = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length, 0, 1)
        distance = np.minimum(distance, np.hypot(x - x0 - t * (x1 - x0), y - y0 - t * (y1 - y0)))
    clear = distance > 1e-6
    assert np.array_equal(polygon(corners, W, H)[clear], inside[clear])


@given(st.lists(places, min_size=1, max_size=6), st.floats(2, 15))
def test_stroke_is_what_is_near_the_line(points, radius):
    x, y = centers()
    distance = np.full((H, W), np.inf)
    for (x0, y0), (x1, y1) in zip(points, points[1:] + points[-1:], strict=True):
        length = max((x1 - x0) ** 2 + (y1 - y0) ** 2, 1e-12)
        t = np.clip(((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length, 0, 1)
        distance = np.minimum(distance, np.hypot(x - x0 - t * (x1 - x0), y - y0 - t * (y1 - y0)))
    drawn = stroke(points, radius, W, H)
    assert drawn[distance < radius - 1].all()
    assert not drawn[distance > radius + 1].any()


def test_outlines_go_around_what_is_covered():
    pixels = rectangle((5, 6), (20, 15), W, H)
    (line,) = outlines(pixels)
    assert line.min(axis=0).tolist() == [5.5, 6.5]
    assert line.max(axis=0).tolist() == [19.5, 14.5]

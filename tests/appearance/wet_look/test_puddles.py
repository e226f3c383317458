"""Puddles depend on the world position only, grow with wetness, and prefer low ground."""

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.water import standing_water


def field(x0=0.0, y0=0.0, n=200, step=0.1):
    x, y = np.meshgrid(x0 + step * np.arange(n), y0 + step * np.arange(n))
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def water(points, wetness=1.0, sunk=0.0, footprint=0.01, seed=0):
    size = points.shape[:2]
    return standing_water(points, np.full(size, footprint, np.float32), np.full(size, sunk, np.float32), wetness, seed)


def test_two_views_of_a_place_see_the_same_puddle():
    one, other = water(field()).puddle, water(field(x0=5.0, y0=3.0)).puddle
    np.testing.assert_allclose(one[30:, 50:], other[:-30, :-50], atol=2e-3)
    assert one[30:, 50:].std() > 0.1
    assert np.array_equal(one, water(field()).puddle)


def test_another_seed_is_another_road():
    assert np.abs(water(field()).puddle - water(field(), seed=1).puddle).mean() > 0.02


def test_as_much_of_an_even_road_is_under_water_as_was_asked_for():
    wide = field(n=600, step=0.5)
    cover = [float(water(wide, w).puddle.mean()) for w in (0.25, 0.5, 1.0)]
    assert cover == sorted(cover)
    assert cover[-1] == pytest.approx(0.12, abs=0.03)
    assert cover[0] < 0.6 * cover[-1]


def test_low_places_fill_first():
    covers = [float(water(field(n=400, step=0.25), sunk=s).puddle.mean()) for s in (-0.004, 0.0, 0.004)]
    assert covers[0] < 0.6 * covers[1] < 0.4 * covers[2]


def test_far_away_the_share_remains_and_nothing_flickers():
    wide = field(n=400, step=0.5)
    near, far = water(wide).puddle, water(wide, footprint=30.0).puddle
    assert far.std() < 0.2 * near.std()
    assert far.mean() == pytest.approx(near.mean(), abs=0.08)


def test_a_rim_is_around_every_puddle():
    made = water(field())
    assert (made.rim[made.puddle > 0.5] > 0.7).all()
    assert made.rim.mean() > made.puddle.mean()

"""Light: told from the ground of views, then overcast: shadows lifted, the sun lowered, a sky of cloud."""

from dataclasses import replace

import numpy as np
import pytest

from appearance.wet_look.dry_view import dry_view
from gsrain_engine.appearance.wet_look.illumination import (
    LUMINANCE,
    estimate_illumination,
    overcast_sky,
    overcast_surfaces,
)
from gsrain_engine.appearance.wet_look.masks import surfaces_of
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.scene.geometry import srgb_to_linear


def test_sun_and_shadow_are_separated():
    light = estimate_illumination([dry_view(shadow=0.8)])
    assert light.sun == 1
    # A display factor of 0.2^(1/2.2) is a little more than a fifth in linear light.
    assert 2.0 < light.sunlit_ev - light.shadow_ev < 2.5
    lit = np.log2(srgb_to_linear(np.array([0.5, 0.48, 0.45])) @ LUMINANCE)
    assert light.sunlit_ev == pytest.approx(lit, abs=0.05)
    even = estimate_illumination([dry_view()])
    assert even.sun == estimate_illumination([dry_view(shadow=0.3)]).sun == 0
    assert even.sunlit_tint_ev[0] > 0.05 and even.sunlit_tint_ev[2] < -0.05  # warm


LEFT, RIGHT = (slice(-8, None), slice(0, 24)), (slice(-8, None), slice(-24, None))


def overcast(view, **settings):
    return overcast_surfaces(view, estimate_illumination([view]), WetSettings(**settings), surfaces_of(view))


def level(light, where=RIGHT):
    return float(np.log2(light[where] @ LUMINANCE).mean())


def test_cast_shadow_nearly_vanishes():
    view = dry_view(shadow=0.8)
    before, flat, unchanged = (
        level(light) - level(light, LEFT)
        for light in (srgb_to_linear(view.image), overcast(view), overcast(view, sun_removal=0.0))
    )
    assert before > 2 and 0 <= flat < 0.25 * before and unchanged == pytest.approx(before, rel=0.1)


def test_exposure_is_given_in_stops():
    view = dry_view()
    assert level(overcast(view, exposure_ev=-1.0)) == pytest.approx(level(overcast(view)) - 1, abs=0.1)


def test_nothing_is_brighter_than_the_cloud():
    view = dry_view()
    view = replace(view, image=np.ones_like(view.image) * (1 - view.sky[..., None]))
    light = overcast(view, exposure_ev=2.0) @ LUMINANCE
    wall = (view.normals[..., 0] < -0.5) & (np.arange(64) < 24)[:, None]
    assert light.max() < srgb_to_linear(np.array(WetSettings().sky_brightness))
    assert light[wall].max() < 0.7 * light[RIGHT].max()


def test_the_sky_is_darker_and_bluer_above_and_evenly_gray_without_clouds():
    directions = np.array([[[1.0, 0, 0], [0.6, 0, 0.8], [0, 0.6, 0.8]]])
    horizon, above, aside = overcast_sky(directions, WetSettings(clouds=1.0))[0]
    assert horizon.sum() > 1.15 * above.sum() and (above != aside).any()
    assert all(each[2] > each[0] for each in (horizon, above, aside))
    _, above, aside = overcast_sky(directions, WetSettings(clouds=0.0))[0]
    np.testing.assert_allclose(above, aside, rtol=1e-6)

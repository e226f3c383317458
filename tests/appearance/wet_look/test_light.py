"""The light of a scene is told from the ground of its views."""

import numpy as np
import pytest

from appearance.wet_look.dry_view import dry_view
from gsrain_engine.appearance.wet_look.illumination import LUMINANCE, estimate_illumination
from gsrain_engine.scene.geometry import srgb_to_linear


def test_sun_and_shadow_are_told_apart():
    light = estimate_illumination([dry_view(shadow=0.8)])
    assert light.sun == 1
    # A display factor of 0.2^(1/2.2) is a little more than a fifth in linear light.
    assert 2.0 < light.sunlit_ev - light.shadow_ev < 2.5
    lit = np.log2(srgb_to_linear(np.array([0.5, 0.48, 0.45])) @ LUMINANCE)
    assert light.sunlit_ev == pytest.approx(lit, abs=0.05)


def test_even_light_has_no_sun():
    assert estimate_illumination([dry_view()]).sun == 0
    assert estimate_illumination([dry_view(shadow=0.3)]).sun == 0


def test_the_warm_light_is_told():
    red, _, blue = estimate_illumination([dry_view()]).sunlit_tint_ev
    assert red > 0.05
    assert blue < -0.05


def test_without_ground_nothing_is_told():
    view = dry_view()
    light = estimate_illumination(
        [type(view)("wall", view.camera, 0.0, view.image, 0 * view.depth, 0 * view.normals, view.sky, view.vehicles)]
    )
    assert light.sun == 0
    assert light.sunlit_ev == light.shadow_ev == light.level_ev
    assert light == estimate_illumination([])

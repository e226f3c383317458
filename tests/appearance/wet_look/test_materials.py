"""Wet materials: what soaks gets dark and colorful, paint gets gloss, lamps shine, far things fade."""

import numpy as np
import pytest

from appearance.wet_look.dry_view import dry_view
from gsrain_engine.appearance.normals import view_rays
from gsrain_engine.appearance.wet_look.illumination import overcast_sky
from gsrain_engine.appearance.wet_look.masks import surfaces_of
from gsrain_engine.appearance.wet_look.materials import apply_fog, wet_surfaces_color
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.water_surface import WATER_INDEX, reflectance, unshadowed, wet_albedo

PLAIN = WetSettings(streaks=0.0)
ROAD, WALL = (56, 48), (24, 48)

# Fresnel's law and Smith's shadowing against values known from elsewhere


@pytest.mark.parametrize(("degrees", "share"), [(0, 0.0204), (30, 0.0212), (60, 0.0597), (80, 0.3479), (90, 1.0)])
def test_water_mirrors_what_optics_tables_say(degrees, share):
    assert reflectance(np.cos(np.radians(degrees)), WATER_INDEX) == pytest.approx(share, abs=4e-4)


@pytest.mark.parametrize(("slope", "degrees"), [(0.3, 10), (0.2, 3), (0.2, 60)])
def test_smith_shadowing_is_that_of_a_random_profile(slope, degrees):
    """A ray at an elevation meets a Gaussian facet unhindered as often as Smith's integral over its slopes says.

    G1 is defined by this: the area of facets that a direction sees, weighted by how it sees them, is the area of the
    mean surface, so that the sum over slopes of pdf * (cos facet)+ * G1 is cos of the direction.
    """
    elevation, tilts = np.radians(degrees), np.linspace(-3, 3, 20001)
    weights = np.exp(-0.5 * (tilts / slope) ** 2) / (slope * np.sqrt(2 * np.pi)) * (tilts[1] - tilts[0])
    visible = np.sum(weights * np.maximum(np.sin(elevation) + tilts * np.cos(elevation), 0))
    assert visible * unshadowed(np.sin(elevation), slope) == pytest.approx(np.sin(elevation), rel=1e-4)
    assert unshadowed(0.5, 0.0) == 1


# Soaked surfaces


def test_albedo_under_water_is_lekners_and_dorfs():
    dry = np.array([0.0, 0.1, 0.2, 0.5, 1.0])
    light_in, back_down = 0.98, 0.55
    by_bounces = [sum(light_in * d * (back_down * d) ** n * (1 - back_down) for n in range(200)) for d in dry]
    grey = np.repeat(dry.astype(np.float32)[None, :, None], 3, axis=2)
    np.testing.assert_allclose(wet_albedo(grey)[0, :, 0], by_bounces, rtol=1e-5)
    assert by_bounces[2] == pytest.approx(0.0991, abs=1e-4)


def linear(view):
    return srgb_to_linear(view.image).astype(np.float32)


def test_ground_darkens_most_walls_less_vehicles_not():
    vehicles = np.zeros((64, 96))
    vehicles[20:30, 10:30] = 1
    view = dry_view(vehicles=vehicles)
    surfaces, dry = surfaces_of(view), linear(view)
    ratio = (wet_surfaces_color(dry, surfaces, PLAIN) / dry).mean(axis=-1)
    assert 0.4 < ratio[ROAD] < 0.6 < ratio[ROAD] + 0.2 < ratio[WALL] < 0.95
    assert ratio[25, 20] == pytest.approx(1, abs=1e-5)
    assert (wet_surfaces_color(dry, surfaces, WetSettings(darkening=0.0)) == dry).all()
    brown = np.broadcast_to(np.array([0.3, 0.2, 0.1], np.float32), view.image.shape).copy()
    wet = wet_surfaces_color(brown, surfaces, PLAIN)
    assert wet[ROAD][0] / wet[ROAD][2] > 1.1 * 3  # stronger colors


def test_mist_fades_to_the_horizon_by_distance():
    view, black = dry_view(), np.zeros((64, 96, 3), np.float32)
    rays = view_rays(view.camera)
    faded = apply_fog(black, view, rays, WetSettings(mist_km=10.0))
    distance = view.depth[WALL] * np.linalg.norm(rays[WALL])
    horizon = overcast_sky(np.array([[[1.0, 0.0, 0.0]]]), WetSettings(clouds=0.0))[0, 0]
    np.testing.assert_allclose(faded[WALL], (1 - np.exp(-0.01 * distance)) * horizon, rtol=0.05)
    assert faded[63, 48].max() < faded[WALL].min()
    assert faded[2, 2].max() == 0  # the sky has no distance
    np.testing.assert_array_equal(apply_fog(black, view, rays, WetSettings(mist_km=0.0)), black)

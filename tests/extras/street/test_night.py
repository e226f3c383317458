"""The street by night: light of its lanterns and rooms on surfaces, its lamps, and a dark sky."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.lamps import LANTERN_M2
from gsrain_engine.scene.rig import rig_camera
from gsrain_extras.street.build import quads_to_gaussians, scene_of, street_surfaces, wet_colors
from gsrain_extras.street.lamp_light import Windows, light_of_lamps
from gsrain_extras.street.layout import STREETS, StreetParameters
from gsrain_extras.street.mesh import Quads, panel
from gsrain_extras.street.night import lanterns

SMALL = StreetParameters(time_of_day="night", length_m=120.0, parked_share=0.3, tree_spacing_m=30.0)
NO_WINDOWS = Windows.of(Quads.joined([]))


@pytest.fixture(scope="module")
def surfaces():
    return street_surfaces(SMALL)


@pytest.fixture(scope="module")
def night(surfaces):
    return scene_of(surfaces)


def level_at(points):
    """Small level quads at points."""
    one = panel((-0.05, -0.05, 0), (1, 0, 0), (0, 1, 0), np.array([0, 0.1]), np.array([0, 0.1]), 1.0, Label.SIGN)
    return one.repeated(np.asarray(points, np.float64))


def test_light_below_a_lantern_falls_with_the_inverse_square(surfaces):
    layout = replace(surfaces.layout, trees=(), cars=(), trucks=(), lamps=surfaces.layout.lamps[2:3])
    (lamp,) = lanterns(layout)
    x, y, z = lamp.position
    heights = np.array([0.2, 1.5, 3.0, 4.5])
    points = np.stack(np.broadcast_arrays(x, y, heights), axis=1)
    light = light_of_lamps(layout, NO_WINDOWS, level_at(points), points)
    expected = LANTERN_M2 * np.array(lamp.color) / np.pi / (z - heights)[:, None] ** 2
    np.testing.assert_allclose(light, expected, rtol=1e-6)
    above = np.array([[x, y, z + 1.0]])
    assert light_of_lamps(layout, NO_WINDOWS, level_at(above), above).max() < 1e-3 * light.min()


def test_crowns_vehicles_and_houses_block_light(surfaces):
    layout = replace(surfaces.layout, lamps=surfaces.layout.lamps[2:3])
    bare = replace(layout, trees=(), cars=(), trucks=())
    (lamp,) = lanterns(layout)
    tree = min(layout.trees, key=lambda tree: np.hypot(tree.x - lamp.position[0], tree.y - lamp.position[1]))
    behind = np.array([[2 * tree.x - lamp.position[0], 2 * tree.y - lamp.position[1], 0.2]])
    vehicle = min((*layout.cars, *layout.trucks), key=lambda each: abs(each.x - lamp.position[0]))
    below = np.array([[vehicle.x, vehicle.y, 0.0]])
    indoors = np.array([[lamp.position[0], layout.parameters.front_y_m + 4.0, 1.0]])
    for point, share in ((behind, 0.6), (below, 0.05), (indoors, 0.05)):
        lit = [light_of_lamps(each, NO_WINDOWS, level_at(point), point).sum() for each in (layout, bare)]
        assert lit[0] < share * max(lit[1], 1e-2)


def test_lamps_are_where_the_lights_are(night, surfaces):
    furniture = surfaces.layers["furniture"]
    shining = furniture.centers[furniture.emission.sum(axis=1) > 0]
    fixed = night.lamps_at(0.0, [lamp for lamp in night.lamps if lamp.name.startswith("lantern")])
    assert len(fixed.positions_m) == len(surfaces.layout.lamps) == 5
    for layer, name, within in (("traffic lights", "signal", 0.05), ("parked buses", "bus", 0.12)):
        quads = surfaces.layers[layer]
        bright = quads.centers[quads.emission.max(axis=1) > 3]
        places = night.lamps_at(0.0, [lamp for lamp in night.lamps if lamp.name.startswith(name)]).positions_m
        assert len(places) == {"signal": 4, "bus": 2}[name]
        assert np.linalg.norm(bright - places[:, None], axis=2).min(axis=1).max() < within
    for place in fixed.positions_m:
        near = shining[np.linalg.norm(shining - place, axis=1) < 0.4]
        np.testing.assert_allclose(near.mean(axis=0), place, atol=0.06)
    rear = surfaces.lead.centers[(surfaces.lead.emission[:, 0] > 5 * surfaces.lead.emission[:, 2])]
    tails = [lamp for lamp in night.lamps if "tail" in lamp.name]
    assert len(tails) == 2
    for lamp in tails:
        assert np.linalg.norm(rear - np.array(lamp.position), axis=1).min() < 0.2
    for name in ("parked cars", "parked trucks"):
        assert not surfaces.layers[name].emission.any()


def test_some_rooms_are_lit_in_colors_of_their_own(surfaces):
    windows = Windows.of(surfaces.layers["houses"])
    light = windows.intensities / windows.areas_m2[:, None]
    assert 60 < len(light) < 1500
    assert np.unique(np.round(light[:, 2] / light[:, 0], 2)).size > 5
    glass = (surfaces.layers["houses"].gloss > 0.45).sum()
    lit = (surfaces.layers["houses"].emission.sum(axis=1) > 0).sum()
    assert 0.2 < lit / glass < 0.75


def test_days_do_not_depend_on_lamps(surfaces):
    """Lanterns and windows are the same surfaces by day, and their own light is off."""
    for name in ("houses", "furniture"):
        quads = surfaces.layers[name]
        quads = quads.take(np.flatnonzero(quads.emission.any(axis=1))[:200])
        assert len(quads) > 50
        sun, clouds = surfaces.light("sunny"), surfaces.light("overcast")
        by_day, switched_off = (quads_to_gaussians(each, sun).sh for each in (quads, quads.shining(0.0)))
        assert by_day.tobytes() == switched_off.tobytes()
        assert wet_colors(quads, clouds).tobytes() == wet_colors(quads.shining(0.0), clouds).tobytes()
        assert quads_to_gaussians(quads, surfaces.light()).sh[:, 0].mean() > by_day[:, 0].mean()
    for name in ("street:night", "street:overcast"):
        assert msgspec.structs.replace(STREETS[name], time_of_day="day") == STREETS["street"]


def test_the_sky_is_dark_dry_and_wet(night):
    found = sky_color(CpuRenderer(), night, rig_camera(night, "waymo_front3", "FRONT", 1.6))
    assert found.found and found.wet_light is not None
    for color in (*found.light, *found.wet_light):
        assert 0.001 < srgb_to_linear(np.array(color)).max() < 0.02
        assert color[2] > color[0]


def test_water_makes_matte_roads_darker(night, surfaces):
    road = night.member("layers/road")
    quads = surfaces.layers["road"]
    center = quads.centers
    lantern = np.array(lanterns(surfaces.layout)[2].position)
    pool = (np.abs(center[:, 0] - lantern[0]) < 3) & (np.abs(center[:, 1]) < 3) & (quads.labels == Label.ROAD)
    from_above = np.zeros(16)
    from_above[0] = SH_C0
    dry, wet = (np.einsum("k,nkc->nc", from_above, sh[pool]).mean() + 0.5 for sh in (road.gaussians.sh, road.wet_sh))
    assert 0.3 * dry < wet < 0.85 * dry

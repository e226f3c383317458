"""Roofs: bridges and canopies keep rain off, roads, walls, poles and floaters don't."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RegionBox, load_preset
from gsrain_engine.rain.shelter_map import CELL_M, ShelterMap, build_shelter_map, shelter_map_of
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.view import RenderView, rain_camera
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import DrawItem, Layer, Scene

UP = np.array([0.0, 0, 1])
SKY = SkyLight.uniform((0.8, 0.8, 0.8))
EYE = np.array([8.0, 0, 1.5])


def gray(means, scales):
    """Gray Gaussians of one size."""
    n, f = len(means), np.float32
    upright, color = np.tile(np.array([1, 0, 0, 0], f), (n, 1)), sh_from_color(np.full((n, 3), 0.3, f))
    return Gaussians(means.astype(f), np.tile(np.asarray(scales, f), (n, 1)), upright, np.full(n, 0.9, f), color)


def sheet(low, high, spacing=0.25, thickness=0.01):
    """Overlapping flat Gaussians on a rectangle that lies along two axes."""
    low, high = np.array(low, float), np.array(high, float)
    lines = [np.arange(a, b + 1e-9, spacing) if b > a else np.array([a]) for a, b in zip(low, high, strict=True)]
    means = np.stack([each.ravel() for each in np.meshgrid(*lines)], axis=1)
    return gray(means, np.where(high > low, 0.6 * spacing, thickness))


ROAD = sheet((-10, -10, 0), (30, 10, 0))
BRIDGE = sheet((10, -10, 5), (16, 10, 5))
WALL = sheet((-10, 7.1, 0), (30, 7.1, 8))
POLE = sheet((3, -3, 0), (3.2, -2.8, 6), 0.1)
HILL = gray(ROAD.means + np.array([0, 0, 0.3]) * ROAD.means[:, :1], ROAD.scales[0])
FLOATERS = gray(np.random.default_rng(4).uniform((-10, -10, 2.5), (30, 10, 9), (400, 3)), (0.15, 0.15, 0.15))


def scene(*sets):
    return Scene("test", tuple(Layer(str(number), each) for number, each in enumerate(sets)))


def roofs_of(*sets):
    return build_shelter_map([DrawItem(each, np.eye(4)) for each in sets])


def test_a_bridge_shelters_what_is_under_it_and_nothing_else():
    roofs = roofs_of(ROAD, BRIDGE)
    x, y = np.meshgrid(np.arange(-8, 28.1, 0.2), np.arange(-8, 8.1, 0.2))
    for height, expected in ((0.5, True), (4.5, True), (5.5, False)):
        places = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)
        under = (places[:, 0] > 10 + CELL_M) & (places[:, 0] < 16 - CELL_M)
        beside = (places[:, 0] < 10 - 2 * CELL_M) | (places[:, 0] > 16 + 2 * CELL_M)
        sheltered = roofs.shelter(places)
        assert np.all(sheltered[under] == expected)
        assert not np.any(sheltered[beside])
    assert not np.any(roofs.shelter(np.array([[500.0, 0, 1], [-500.0, 0, 1], [12.0, 700.0, 1]])))


@pytest.mark.parametrize(
    "sets", [(ROAD,), (ROAD, WALL), (ROAD, POLE), (HILL,), (ROAD, FLOATERS), (Gaussians.empty(),), ()]
)
def test_roads_walls_poles_and_floaters_are_no_roofs(sets):
    assert roofs_of(*sets) is None


def test_a_canopy_of_three_by_three_cells_is_a_roof_wherever_it_stands():
    """A bus stop's: seven of the nine cells around its middle. A narrower one is a lamp."""
    for x, y in ((0.0, 0.0), (5.25, 3.4), (11.1, -6.8)):
        canopy = sheet((x, y, 3), (x + 1.5, y + 1.5, 3), spacing=0.1, thickness=0.005)
        lamp = sheet((x, y, 3), (x + 0.3, y + 0.3, 3), spacing=0.1, thickness=0.005)
        assert roofs_of(ROAD, lamp) is None
        middle = np.array([[x + 0.75, y + 0.75, 1.0], [x + 0.75, y + 3.5, 1.0], [x - 2.5, y + 0.75, 1.0]])
        assert roofs_of(ROAD, canopy).shelter(middle).tolist() == [True, False, False]


@pytest.mark.parametrize(("opacity", "is_roof"), [(0.67, False), (0.71, True)])
def test_a_roof_takes_half_of_the_light_from_above(opacity, is_roof):
    """Four Gaussians a cell of 0.25 m2, 2 pi (0.1 m)^2 each: an optical depth of 1.005 opacities, ln 2 = 0.693."""
    g = sheet((10.125, -4.875, 5), (15.875, 4.875, 5))
    thin = replace(g, scales=np.full_like(g.scales, 0.1), opacities=np.full_like(g.opacities, opacity))
    assert (roofs_of(ROAD, thin) is not None) == is_roof


def test_a_roof_of_few_large_gaussians_is_one_too_and_holes_in_it_are_closed():
    coarse = sheet((10, -10, 5), (16, 10, 5), spacing=1.5)
    torn = BRIDGE.take(np.flatnonzero(~((abs(BRIDGE.means[:, 0] - 13) < 0.3) & (abs(BRIDGE.means[:, 1]) < 0.3))))
    assert len(torn) < len(BRIDGE)
    for bridge in (coarse, torn):
        roofs = roofs_of(ROAD, bridge)
        places = np.random.default_rng(0).uniform((11, -8, 1), (15, 8, 4), (500, 3))
        assert np.mean(roofs.shelter(places)) > 0.97
        columns = np.nonzero(np.isfinite(roofs.heights_m))[1]
        assert roofs.corner_m[0] + CELL_M * (columns.mean() + 0.5) == pytest.approx(13, abs=0.2)


def test_roofs_follow_the_scene_s_units_and_axes():
    """A scene in centimetres with y up: its own z is across."""
    to_file = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    turned = (Layer("x", gray(100 * g.means @ to_file.T, 100 * g.scales[0, [0, 2, 1]])) for g in (ROAD, BRIDGE))
    roofs = shelter_map_of(Scene("centimetres", tuple(turned), metres_per_unit=0.01, up=(0.0, 1.0, 0.0)))
    direct = shelter_map_of(scene(ROAD, BRIDGE))
    places = np.random.default_rng(1).uniform((-8, -8, 0.5), (28, 8, 7), (4000, 3))
    assert np.mean(roofs.shelter(places) == direct.shelter(places)) > 0.98


@pytest.mark.parametrize(
    "changes",
    [{"kind": "sky"}, {"visible": False}, {"marks": SelectionFlags(deleted=BitMask.all(len(BRIDGE)))}],
)
def test_what_is_no_background_or_not_there_is_no_roof(changes):
    assert shelter_map_of(Scene("test", (Layer("road", ROAD), Layer("bridge", BRIDGE, **changes)))) is None


def test_a_piece_covers_its_whole_circle_wherever_that_lies():
    random = np.random.default_rng(8)
    roofs = ShelterMap(random.uniform(1, 5, (20, 30)).astype(np.float32), (-7.0, -4.0), 0.5)
    for x, y, reach in random.uniform((-8, -5, 0.1), (9, 7, 3), (50, 3)).tolist():
        angle, radius = random.uniform(0, 2 * np.pi, 200), reach * np.sqrt(random.uniform(0, 1, 200))
        places = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(200, 0.5)], axis=1)
        piece, expected = roofs.around(x, y, reach), roofs.shelter(places)
        assert np.array_equal(np.zeros(200, bool) if piece is None else piece.shelter(places), expected)
        if piece is not None:
            assert max(piece.heights_m.shape) <= 2 * reach / 0.5 + 2  # no more than that


def camera(eye=EYE):
    return Camera.from_fov(160, 120, 50.0, look_at(eye, eye + [1.0, 0, 0], UP))


def frame(street, rainfall, shot):
    return rainfall.frame(shot.time_s, rain_camera(street, rainfall, shot), SKY)


def rain(**fields):
    return RainSimulation.start(msgspec.structs.replace(load_preset("12.0"), **fields))


@pytest.mark.parametrize("model", ["physical", "paper"])
def test_no_drop_and_no_haze_is_under_the_bridge(model):
    street = scene(ROAD, BRIDGE)
    region = RegionBox(minimum_m=(-1.0, -1.0, -1.5), maximum_m=(5.0, 1.0, 4.5))
    fields = {"model": model, "streak_region": region, "intensity_mm_h": 50.0}
    fields |= {"haze": "gaussians", "haze_opacity": 0.01}
    shot = RenderView(camera(), 3.0, focal_px=1000.0)
    open_air, kept_out = (frame(street, rain(roofs=on, **fields), shot) for on in (False, True))
    roofs = shelter_map_of(street)
    everywhere = open_air.visible_drops()
    under = roofs.shelter(everywhere.positions_m)
    assert 0.1 < np.mean(under) < 1
    np.testing.assert_array_equal(kept_out.visible_drops().numbers, everywhere.numbers[~under])
    wet = roofs.shelter(open_air.haze.means.astype(float))
    assert np.sum(wet) > 20
    np.testing.assert_array_equal(kept_out.haze.means, open_air.haze.means[~wet])

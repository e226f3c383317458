"""Splashes: threshold, crowns, droplets, and what of them a camera shows."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.passes.splashes import draw_splashes
from gsrain_engine.render.view import RenderView, rain_camera
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.water.impacts import GroundImpacts, LandedDrops, cells_around
from gsrain_engine.water.splashes import (
    SMALLEST_PX,
    crown_life_s,
    crown_size_m,
    droplets,
    splash_number,
    splash_threshold,
)
from small_scene import patch, small_scene

EYE = np.array([0.0, 0.0, 1.5])


def wet_scene(water=True):
    scene = small_scene()
    layers = tuple(replace(layer, wet_sh=layer.gaussians.sh) for layer in scene.layers)
    cover = np.zeros((24, 80, 2), np.uint8)
    cover[..., 0] = 200
    return replace(scene, layers=layers, water=GroundWater((-20.0, -6.0), 0.5, cover) if water else None)


def rainfall(**changes):
    return RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), **changes))


def shot(width=480, height=320, time_s=2.0, **changes):
    view = look_at(EYE, EYE + np.array([4.0, 0.0, -1.2]), np.array([0.0, 0.0, 1.0]))
    return RenderView(Camera.from_fov(width, height, 45.0, view), time_s, **changes)


def drawn(scene, at=None, **changes):
    at, rain = at or shot(), rainfall(**changes)
    return draw_splashes(scene, rain, rain.frame(at.time_s, rain_camera(scene, rain, at)))


def landed(found, at):
    """Places of splashes, which are drawn nearer by 0.75 m, and at most by 15 %."""
    away = found.means - at.camera.position
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    return at.camera.position + away * np.minimum(1 + 0.75 / distance, 1 / 0.85)


def picture(scene, at=None, renderer=None, **changes):
    renderer = renderer or CpuRenderer()
    draw(renderer, FrameInput.of(scene, rainfall(**changes), OVERCAST, at or shot()))
    return renderer.read().rgba


def test_drops_splash_above_the_published_threshold():
    """3.8 mm at 3.09 m/s, We = 497: K = 497 * 0.00193^-0.4, and 2100 + 5880 * 0.29^1.44, by hand."""
    d, v = np.array([3.8]), np.array([3.09])
    assert splash_number(d, v)[0] == pytest.approx(6.07e3, rel=0.02)
    assert splash_threshold(d, 0.29 * d)[0] == pytest.approx(2100 + 5880 * 0.1682, rel=1e-3)
    assert splash_threshold(d, 9 * d)[0] == 7980
    flux = GroundImpacts(rainfall()).flux_at(0.0)
    film = np.full(len(flux.diameters_mm), 0.5)
    splash = splash_number(flux.diameters_mm, flux.speeds_m_s) > splash_threshold(flux.diameters_mm, film)
    smallest = flux.diameters_mm[splash].min()
    assert 1.2 < smallest < 1.6 and splash[flux.diameters_mm > smallest].all()


def test_crowns_grow_with_the_root_of_time_and_fall_back():
    d, v, film = np.full(3, 2.0), np.full(3, 6.0), np.full(3, 0.5)
    life = crown_life_s(d)[0]
    assert 0.008 < life < 0.02
    radius, height = crown_size_m(np.array([0.25, 0.5, 1.0]) * life, d, v, film)
    assert radius[2] / radius[0] == pytest.approx(2.0)
    assert height[1] > height[0] > height[2] == pytest.approx(0, abs=1e-12)
    assert radius[2] > 4e-3 and 3e-3 < height[1] < 8e-3


def test_droplets_fly_up_and_come_down_on_their_own_paths():
    one = LandedDrops(
        np.zeros((1, 2)), np.zeros(1), np.array([2.5]), np.array([7.0]), np.ones(1), np.array([77], np.uint32)
    )
    places, film = np.zeros((1, 3)), np.array([0.5])
    times = np.linspace(0.01, 0.3, 60)
    flights = [droplets(one, t, places, film) for t in times]
    heights = np.array([each.positions_m[:, 2] for each in flights])
    there = flights[-1].is_aloft
    assert there.sum() >= 4 and not droplets(one, 0.0, places, film).is_aloft.any()
    assert (heights.max(axis=0)[there] > 0.02).all() and (heights.max(axis=0) < 0.6).all()
    step = times[1] - times[0]
    speeds = np.gradient(np.array([each.positions_m for each in flights]), step, axis=0)
    own = np.array([each.velocities_m_s for each in flights])
    np.testing.assert_allclose(speeds[1:-1, there], own[1:-1, there], atol=0.15)
    assert (flights[0].diameters_mm < 0.3 * 2.5).all()


def test_splashes_lie_on_the_ground_in_view_within_reach():
    scene, at = wet_scene(), shot()
    found = drawn(scene, at)
    away = np.linalg.norm(found.means - EYE, axis=1)
    assert 20 < len(found) < 3000 and away.max() < 20.5
    low = np.quantile(landed(found, at)[:, 2], [0, 0.9])
    assert low[0] > -0.005 and low[1] < 0.02
    x, _, z = (found.means @ at.camera.world_to_camera[:3, :3].T + at.camera.world_to_camera[:3, 3]).T
    assert (np.abs(x) < z * 240 / at.camera.fx + 2.5).all() and (z > -2).all()
    more = [len(drawn(scene, at, intensity_mm_h=rain)) for rain in (1.0, 8.5, 30.0)]
    assert more[0] < more[1]
    assert len(drawn(scene, shot(96, 64)) or ()) < len(found)  # those under a third of a pixel are left out
    assert SMALLEST_PX == 0.3


def test_a_raised_sidewalk_has_its_splashes_on_top_and_dry_ground_none():
    scene = wet_scene()
    walk = patch((0, 2, 0.12), np.array([40.0, 0, 0]), np.array([0, 4.0, 0]), 100, (0.5, 0.5, 0.5))
    flat = replace(walk, scales=walk.scales * np.array([1, 1, 0.02], np.float32))
    layers = *scene.layers, replace(scene.layers[0], name="walk", gaussians=flat, wet_sh=flat.sh)
    raised = landed(drawn(replace(scene, layers=layers)), shot())
    on_top = raised[:, 1] > 2.6
    assert on_top.sum() > 5 and (raised[on_top, 2] > 0.11).all()
    assert raised[raised[:, 1] < 1.4, 2].min() < 0.1
    cover = scene.water.cover.copy()
    cover[:12] = 0
    half = landed(drawn(replace(scene, water=replace(scene.water, cover=cover))), shot())
    assert (half[:, 1] > -0.7).all() and len(half) > 5
    assert drawn(wet_scene(water=False), shot()) is not None


def test_pictures_have_splashes_where_wet_colors_are_and_only_in_rain():
    scene, renderer = wet_scene(), CpuRenderer()
    with_them, without = picture(scene, renderer=renderer), picture(scene, splashes=False)
    assert (np.abs(with_them - without).max(axis=2) > 0.01).sum() > 10
    assert np.array_equal(with_them, picture(scene))
    picture(scene, shot(time_s=3.0), renderer)
    assert np.array_equal(with_them, picture(scene, renderer=renderer))  # any frame alone
    for changes in ({"intensity_mm_h": 0.0}, {"wetness": 0.0}):
        assert np.array_equal(picture(scene, **changes), picture(scene, splashes=False, **changes))
    assert np.array_equal(picture(small_scene()), picture(small_scene(), splashes=False))
    assert not load_preset("paper").splashes


def test_crowns_cover_as_much_as_rate_life_and_size_say():
    """Over 20 moments, on 7 m2 in front of the camera; the smallest, under a third of a pixel, are left out."""
    scene, at, rain = wet_scene(), shot(960, 640), {"intensity_mm_h": 20.0}
    covered = 0.0
    for k in range(20):
        found = drawn(scene, replace(at, time_s=2 + 0.37 * k), aperture_mm=0.0, **rain)
        places = landed(found, at)
        near = np.hypot(*(places[:, :2] - (4.0, 0.0)).T) < 1.5
        larger = (np.linalg.norm(places - EYE, axis=1) / np.linalg.norm(found.means - EYE, axis=1)) ** 2
        areas = 2 * np.pi * found.opacities * found.scales[:, 1] * found.scales[:, 2] * larger
        covered += areas[near].sum() / 20
    impacts = GroundImpacts(rainfall(**rain))
    cells = cells_around(np.array([2.0, -2.0]), np.array([5.99, 1.99]))
    drops = impacts.land(cells, 0.0, 1.0, 900.0)
    d, v = drops.diameters_mm, drops.speeds_m_s
    film = np.full(len(d), water_depth_mm(20.0))
    splashing = splash_number(d, v) > splash_threshold(d, film)
    d, v, film, life = d[splashing], v[splashing], film[splashing], crown_life_s(d[splashing])
    sizes = [crown_size_m(share * life, d, v, film) for share in (np.arange(20) + 0.5) / 20]
    mean = np.mean([2 * radius * height for radius, height in sizes], axis=0)
    expected = 0.5 * np.sum(life * mean) / len(cells) * np.pi * 1.5**2
    assert covered == pytest.approx(expected, rel=0.25)

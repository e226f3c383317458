"""Spray: mass, sizes, motion and decay of what tires throw; any frame alone; on panes, along rays and in pictures."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
import scipy

from gsrain_engine.rain.air import profile
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Actor, Layer, Scene
from gsrain_engine.simulation.agents.base import NOTHING
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from gsrain_engine.water import spray
from gsrain_engine.water.glass import CameraMotion, GlassHistory
from gsrain_engine.water.pane import pane_of
from gsrain_engine.water.spray import SprayParcels, depths_along, displaced_mm, pane_flux_m_s, spray_parcels
from simulation.small_drive import box_actor, in_other_units, lead, scenario, scene_with_box, track

CALM = RainSettings(intensity_mm_h=8.5, wind_speed_m_s=0.0)
FILM_MM = 0.1


def road(speed_m_s, kind="car", size=(4.6, 1.85, 1.45), **fields):
    """A vehicle that drives along +x and is at the origin at 0 s."""
    way = track([-10.0, 10.0], [(-10 * speed_m_s, 0, 0), (10 * speed_m_s, 0, 0)])
    return Scene("road", actors=(Actor("one", kind, size, Gaussians.empty(), way),), **fields)


def thrown_kg(scene, seconds, rain=CALM, time_s=0.0):
    """Mass that the tires of a scene threw within the last seconds, and how much of it floats."""
    cells = np.arange(int(np.floor((time_s - seconds) / spray.STEP_S)), int(np.floor(time_s / spray.STEP_S)) + 2)
    edges = np.minimum(cells * spray.STEP_S, time_s)
    (motion,) = spray.vehicle_motions(scene, edges)
    return spray.emissions_of(motion, cells, edges, FILM_MM, rain.seed, time_s).thrown_kg.sum()


@pytest.mark.parametrize(("kind", "size", "tires_m"), [("car", (4.6, 1.85, 1.45), 0.4), ("truck", (9, 2.5, 3.5), 1.0)])
def test_tires_throw_the_water_that_they_displace(kind, size, tires_m):
    """Film x width x way, also at moments inside a step; what merges later keeps its mass."""
    for v in (20.0, 27.3):
        for time_s in (0.0, 0.0137):
            seconds = 0.4 + time_s  # before coarse drops have settled
            way_m = v * seconds
            assert thrown_kg(road(v, kind, size), seconds, time_s=time_s) == pytest.approx(
                998e-3 * FILM_MM * tires_m * way_m, rel=0.01
            )
    weights = spray.merged_weight(np.arange(400), np.full(400, 0.9))
    assert weights.mean() == pytest.approx(1) and weights.min() == 0
    ages = np.linspace(0, 3, 400)
    assert np.mean([spray.merged_weight(np.arange(400), np.full(400, each)).mean() for each in ages]) == pytest.approx(
        1
    )


def test_tires_end_within_the_sides_of_their_vehicle():
    for kind, size, tire_m in (
        ("car", (4.6, 1.85, 1.45), 0.2),
        ("car", (6, 2.1, 2.9), 0.5),
        ("bus", (9, 2.5, 2.7), 0.5),
    ):
        wheels = spray.wheels_of(kind, size)
        assert wheels.width_m == tire_m
        assert max(wheels.tracks_m) + tire_m / 2 == pytest.approx(size[1] / 2 - 0.05)
        assert min(wheels.tracks_m) == -max(wheels.tracks_m)
    assert spray.wheels_of("bicycle", (1.8, 0.6, 1.7)).tracks_m == (0.0,)
    assert spray.wheels_of("train", (20, 3, 4)) is None and spray.wheels_of("person", (0.5, 0.6, 1.8)) is None


def test_slow_tires_throw_nothing_and_fast_ones_finer_drops():
    assert len(spray_parcels(road(10.9), CALM, FILM_MM, 0.0)) == 0
    clouds = [spray_parcels(road(v), CALM, FILM_MM, 0.0).extinction_m2.sum() for v in (12.0, 14.0, 17.0, 22.0, 28.0)]
    assert np.all(np.diff(clouds) > 0) and clouds[0] < 0.02 * clouds[3]
    assert spray.mean_diameter_mm(np.sqrt(2700 * 0.0728 / 998 / 0.008) * 4) == pytest.approx(0.2)
    for v in (14.0, 28.0):
        classes = spray.size_classes(v)
        sauter_mm = spray.mean_diameter_mm(v) * np.exp(2 * spray.SPREAD**2)  # of a log-normal distribution
        assert sum(each.share / each.diameter_mm for each in classes) == pytest.approx(1 / sauter_mm, rel=1e-6)
        assert np.all(np.diff([each.fall_m_s for each in classes]) > 0)
    assert spray.terminal_speed_m_s(np.array([0.1, 0.5, 1.0, 2.0])) == pytest.approx([0.27, 2.06, 4.03, 6.49], rel=0.1)


def test_displaced_water_is_the_mean_depth_over_the_texture():
    depths = np.random.default_rng(1).normal(0.5, 0.25, 1_000_000)
    for film in (0.1, 0.5, 0.95, 2.0):
        assert displaced_mm(film) == pytest.approx(np.maximum(film - depths, 0).mean(), rel=0.02, abs=1e-4)


def test_any_moment_is_the_same_alone_and_flows_into_the_next():
    """Matched by nothing but their place in the lattice: no parcel appears or jumps."""
    scene = road(25.0)
    once, other = spray_parcels(scene, CALM, FILM_MM, 1.0), spray_parcels(scene, CALM, FILM_MM, -3.0)
    again = spray_parcels(scene, CALM, FILM_MM, 1.0)
    assert all(np.array_equal(*pair) for pair in zip(once, again, strict=True))
    seeded = spray_parcels(scene, msgspec.structs.replace(CALM, seed=1), FILM_MM, 1.0)
    assert len(other) > 100 and not np.array_equal(seeded.centers_m[:50], once.centers_m[:50])
    totals = [spray_parcels(scene, CALM, FILM_MM, t).extinction_m2.sum() for t in np.arange(0, 0.2, 0.004)]
    assert np.ptp(totals) < 0.03 * np.mean(totals)
    assert np.abs(np.diff(totals)).max() < 0.01 * np.mean(totals)


def test_the_wake_grows_settles_and_ends_within_tens_of_meters():
    cloud = spray_parcels(road(27.8), CALM, FILM_MM, 0.0)
    behind = -cloud.centers_m[:, 0]
    per_m, _ = np.histogram(behind, (-3, 5, 15, 30, 60, 90), weights=cloud.extinction_m2)
    per_m = per_m / (8, 10, 15, 30, 30)
    assert per_m[1] > per_m[2] > 1.5 * per_m[3] > 0 and per_m[4] < 0.1 * per_m[1]
    near, far = cloud.sigmas_m[behind < 3].mean(), cloud.sigmas_m[behind > 30].mean()
    assert far > 1.5 * near and cloud.centers_m[:, 2].min() >= 0 and cloud.centers_m[:, 2].max() < 2.5
    fine, coarse = (cloud.diameters_mm < 0.15, cloud.diameters_mm > 0.5)
    assert behind[fine].max() > 2 * behind[coarse].max()


def test_wind_carries_parcels():
    east = msgspec.structs.replace(CALM, wind_speed_m_s=8.0, wind_from_deg=180.0)  # blows along +y
    calm, windy = (spray_parcels(road(25.0), each, FILM_MM, 0.0) for each in (CALM, east))
    age = -calm.centers_m[:, 0] / 25.0
    share = float(profile(np.array([spray.DRIFT_HEIGHT_M]), east.roughness_m)[0])
    shift = windy.centers_m[:, 1] - calm.centers_m[:, 1]
    old = age > 1.0
    assert shift[old] == pytest.approx(8.0 * share * age[old], rel=0.35)
    assert np.ptp(windy.velocities_m_s[:, 1]) == 0 and windy.velocities_m_s[0, 1] == pytest.approx(8.0 * share)


def test_the_ego_vehicle_throws_spray_behind_itself_only():
    way = track([-10.0, 10.0], [(-250, 0, 1.5), (250, 0, 1.5)])
    cloud = spray_parcels(Scene("road", ego=way), CALM, FILM_MM, 0.0)
    assert len(cloud) > 300 and cloud.centers_m[:, 0].max() < 1.3  # ahead of its rear axle only what the wake carries
    parked = spray_parcels(Scene("road", ego=track([0.0], [(0, 0, 1.5)])), CALM, FILM_MM, 0.0)
    assert len(parked) == 0


def test_units_and_axes_of_a_scene_do_not_matter():
    scene = Scene("road", actors=(box_actor(times=(0.0, 4.0), positions=((0, 3.0, 0), (100, 3.0, 0))),), ground_m=0.0)
    one, other = (spray_parcels(each, CALM, FILM_MM, 3.0) for each in (scene, in_other_units(scene)))
    assert len(one) > 300
    np.testing.assert_allclose(other.centers_m, one.centers_m, atol=1e-6)
    np.testing.assert_allclose(other.masses_kg, one.masses_kg, rtol=1e-6)


# On panes and along rays


def single(center=(10.0, 0.5, 1.0), sigma=0.4, area=0.3, mass=2e-3, velocity=(1.0, 0.0, 0.0)):
    ones = np.ones(1)
    return SprayParcels(np.array([center]), sigma * ones, area * ones, mass * ones, 0.2 * ones, np.array([velocity]))


def test_rays_meet_the_integral_of_a_cloud():
    rng = np.random.default_rng(2)
    cloud, origin = single(), np.array([0.3, -0.2, 1.5])
    directions = rng.normal((10, 0.6, -0.5), (0.5, 0.3, 0.3), (40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    depths = depths_along(cloud, origin, directions, 0.75, 20)
    s = np.linspace(0, 15, 6001)
    for ray, found in zip(directions, depths, strict=True):
        away = np.sum((origin + s[:, None] * ray - cloud.centers_m[0]) ** 2, axis=1)
        density = 0.3 / (2 * np.pi * 0.16) ** 1.5 * np.exp(-away / 0.32)
        assert found.sum() == pytest.approx(scipy.integrate.trapezoid(density, s), abs=1e-4)
        assert found[:13].sum() == pytest.approx(scipy.integrate.trapezoid(density[s <= 9.75], s[s <= 9.75]), abs=2e-3)


def test_a_pane_collects_what_it_sweeps():
    """All of a cloud lands on a wide pane that drives through it."""
    cloud, forward, v = single(velocity=(2.0, 0.0, 0.0)), np.array([1.0, 0, 0]), 22.0
    x, y, z = (np.linspace(c - 2.4, c + 2.4, 25) for c in cloud.centers_m[0])
    depth = sum(pane_flux_m_s(cloud, np.array([a, b, c]), forward, v * forward) for a in x for b in y for c in z)
    seconds, area = 0.2 / (v - 2.0), 0.2**2  # the cloud moves on meanwhile
    assert depth * seconds * area * 998 == pytest.approx(2e-3, rel=0.01)
    assert pane_flux_m_s(cloud, cloud.centers_m[0], -forward, v * forward) == 0


def test_the_glass_of_a_follower_gets_wetter_the_nearer_it_follows():
    cloud = spray_parcels(road(25.0), CALM, FILM_MM, 0.0)
    normal = np.array([np.sin(0.6), 0.0, np.cos(0.6)])
    flux = [pane_flux_m_s(cloud, np.array([-x, 0.0, 1.2]), normal, np.array([25.0, 0, 0])) for x in (10.0, 20.0, 45.0)]
    assert flux[0] > flux[1] > flux[2] >= 0 and 3.6e6 * flux[1] > 8.5 / 10  # in mm/h


# In drives and pictures


def test_spray_of_a_drive_is_that_of_its_playback_and_of_a_track():
    """Road users of a drive have thrown spray before it begins, and do at each of its steps."""
    user = lead(ahead_m=15.0, speed_m_s=25.0, behaviour={"kind": "constant-velocity"})
    scene = replace(scene_with_box(), ego=track([0.0, 10.0], [(0, 0, 1.5), (300, 0, 1.5)]))
    simulation = Simulation(scenario(speed_m_s=25.0, road_users=[user], leave_m=1000.0, start_s=0.5), scene, NOTHING)
    simulation.reset()
    (there,) = simulation.observation().road_users
    way = track([-10.0, 20.0], [(there.x_m - 25 * 10.5, there.y_m, 0), (there.x_m + 25 * 19.5, there.y_m, 0)])
    alone = Scene("road", actors=(Actor("lead", "car", there.size_lwh, Gaussians.empty(), way),))
    expected = {}
    for step in range(4):
        time_s = 0.25 * step
        expected[time_s] = spray_parcels(alone, CALM, FILM_MM, 0.5 + time_s).centers_m
        found = spray_parcels(replace(simulation.scene_now, ego=None), CALM, FILM_MM, 0.5 + time_s)
        np.testing.assert_allclose(found.centers_m, expected[time_s], atol=0.02)  # the road is not quite even
        np.testing.assert_allclose(found.centers_m[:, :2], expected[time_s][:, :2], atol=1e-6)
        simulation.advance(Control(0.0, 0.0))
    playback = RolloutPlayback(simulation.rollout("none"), scene)
    for time_s, centers in expected.items():
        found = spray_parcels(replace(playback.scene(time_s), ego=None), CALM, FILM_MM, 0.5 + time_s)
        np.testing.assert_allclose(found.centers_m[:, :2], centers[:, :2], atol=1e-6)


def street(speed_m_s=25.0, wet=True):
    """A dark wet road with a red block that drives ahead, 9 m from the camera at 2 s."""
    x, y = np.meshgrid(np.arange(0.5, 60, 0.5), np.arange(-12, 12.1, 0.5))
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)
    n = len(ground)
    scales = np.tile(np.array([0.5, 0.5, 0.004], np.float32), (n, 1))
    upright = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    colors = sh_from_color(np.full((n, 3), 0.2, np.float32))
    floor = Gaussians(ground, scales, upright, np.full(n, 0.99, np.float32), colors)
    car = box_actor(times=(0.0, 4.0), positions=[(9 + speed_m_s * t, 0, 0) for t in (-2, 2)])
    layers = (Layer("road", floor, wet_sh=floor.sh.copy() if wet else None),)
    return Scene("street", layers, (car,), ground_m=0.0)


EYE = np.array([0.0, 0.0, 1.5])
VIEW = RenderView(Camera.from_fov(160, 100, 50.0, look_at(EYE, EYE + [1, 0, -0.12], np.array([0.0, 0, 1]))), 2.0)


def picture(scene, renderer=None, **changes):
    rain = msgspec.structs.replace(load_preset("12.0"), **{"streaks": False} | changes)
    renderer = renderer or CpuRenderer()
    draw(renderer, FrameInput.of(scene, RainSimulation.start(rain), OVERCAST, VIEW))
    return renderer.read().rgba[..., :3]


def test_spray_veils_the_lower_half_of_the_car_ahead_in_gray():
    clear, veiled = (picture(street(), spray=on) for on in (False, True))
    light = np.abs(veiled - clear).max(axis=2)
    red = np.argwhere(clear[..., 0] > clear[..., 1] + 0.2)
    top, bottom = red[:, 0].min(), red[:, 0].max()
    middle = (top + bottom) // 2
    columns = slice(red[:, 1].min(), red[:, 1].max())
    upper, lower = light[top:middle, columns].mean(), light[middle:bottom, columns].mean()
    assert lower > 0.1 and lower > 1.5 * upper and light[: top - 5].max() < 0.05
    saturation = [np.ptp(each[middle:bottom, columns], axis=2).mean() for each in (clear, veiled)]
    assert saturation[1] < 0.75 * saturation[0]
    assert veiled[middle:bottom, columns].max() < 0.8  # darker than the overcast sky: half of its light is the road's


@pytest.mark.parametrize("scene", [street(10.0), street(wet=False)], ids=["slow", "without wet colors"])
def test_pictures_without_spray_are_the_same_bytes(scene):
    assert picture(scene).tobytes() == picture(scene, spray=False).tobytes()
    assert picture(street(), wetness=0).tobytes() == picture(street(), wetness=0, spray=False).tobytes()


def test_depth_is_that_of_the_scene():
    camera, sky = VIEW.camera, SkyColor(OVERCAST, found=True)
    sequence = FrameSequence(
        street(), RainSimulation.start(load_preset("12.0")), camera, camera.width, camera.height, start_s=2.0
    )
    with_depth, dry = (sequence.frame(CpuRenderer(), 0, each, with_depth=True) for each in (sky, None))
    np.testing.assert_array_equal(with_depth.depth, dry.depth)
    assert with_depth.rgba.tobytes() == sequence.frame(CpuRenderer(), 0, sky).rgba.tobytes()


def test_lamps_light_spray_by_night():
    headlight = Lamp(position=(0.5, 0.0, 0.8), direction=(1.0, 0.0, 0.0), intensity_m2=300.0)
    dark = SkyLight.uniform((0.02, 0.02, 0.02))
    scene = replace(street(), lamps=(headlight,))
    light = {}
    for name, one in (("lit", scene), ("dark", street())):
        draws = []
        for on in (True, False):
            rain = msgspec.structs.replace(load_preset("12.0"), streaks=False, spray=on, haze="none")
            renderer = CpuRenderer()
            draw(renderer, FrameInput.of(one, RainSimulation.start(rain), dark, VIEW))
            draws.append(renderer.read().rgba[..., :3])
        light[name] = (draws[0] - draws[1]).max()
    assert light["lit"] > 0.02 > light["dark"]


def followed(distance_m=15.0, wiper="off"):
    """Windshield of a car that follows another at 25 m/s."""
    scene = road(25.0)
    pose = look_at(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    camera = Camera.from_fov(960, 640, 40.0, pose)

    def past(time_s):
        place = np.array([25.0 * time_s - distance_m, 0.0, 1.3])
        return CameraMotion(camera.camera_to_world[:3, :3], np.array([25.0, 0.0, 0.0]), place)

    rain = RainSimulation.start(CALM)
    glass = GlassHistory(pane_of("windshield", camera), rain, past, contact_angle_deg=50.0, wet_s=2.0, wiper=wiper)
    glass.spray = lambda time_s: spray_parcels(scene, CALM, FILM_MM, time_s)
    return glass


@pytest.mark.parametrize("wiper", ["off", "high"])
def test_spray_lands_on_the_glass_of_a_follower(wiper):
    """More water than rain brings; none is lost, any time alone has the same film, and it is less farther behind."""
    glass = followed(wiper=wiper)
    state = glass.at(0.5)
    drops, rained = glass.drops, state.expected_impacts / state.area_m2 * np.mean(glass.impacts.volumes_m3)
    assert drops.landed_m3 > 2 * rained * state.area_m2
    assert abs(drops.landed_m3 - drops.left_m3 - drops.stored_m3) < 1e-5 * drops.landed_m3
    alone = followed(wiper=wiper)
    for time_s in (-1.0, 0.13, 0.5):
        alone.at(time_s)
    assert alone.drops.film_m.tobytes() == drops.film_m.tobytes()
    far = followed(60.0, wiper)
    far.at(0.5)
    assert far.drops.film_m.mean() < 0.2 * drops.film_m.mean()

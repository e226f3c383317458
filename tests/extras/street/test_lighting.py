"""The street under clouds: CIE's sky, soft light, and wet surfaces, darker, stronger in color and not veiled."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.scene.gaussians import SH_C0, evaluate_sh
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.skies import overcast_luminance, overcast_share, overcast_sky_display, sky_display
from gsrain_extras.street.build import quads_to_gaussians
from gsrain_extras.street.lighting import canyon_share
from gsrain_extras.street.models import LIBRARY
from gsrain_extras.street.wet_surfaces import puddles, reflecting, wet_materials

from .built_street import SHORT, street_of, surfaces_of

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@pytest.fixture(scope="module")
def surfaces():
    return surfaces_of(SHORT)


@pytest.fixture(scope="module")
def street():
    return street_of(SHORT)


@pytest.fixture(scope="module")
def dry_under_clouds(surfaces, street):
    """The street in the same light without water, by which wet materials and light are told apart."""
    scene = street
    for name, quads in surfaces.layers.items():
        gaussians = quads_to_gaussians(quads, surfaces.light("overcast"))
        scene = scene.with_member(f"layers/{name}", gaussians=gaussians, wet_sh=None)
    return scene


def front(scene, time_s=3.0):
    return rig_camera(scene, "waymo_front3", "FRONT", time_s).resized(240, 160)


def picture(scene, wetness, time_s=3.0):
    renderer = CpuRenderer()
    renderer.draw(scene.parts(time_s, wetness=wetness), front(scene, time_s), with_depth=True)
    frame = renderer.read()
    return frame.rgba[..., :3].astype(np.float64), frame.depth


def masks(scene, time_s=3.0):
    """Mask of each layer's own pixels."""
    renderer, shares = CpuRenderer(), []
    for own in scene.layers:
        layers = tuple(
            replace(
                each, wet_sh=None,
                gaussians=each.gaussians.with_sh(
                    np.full((len(each.gaussians), 1, 3), (0.5 if each is own else -0.5) / SH_C0, np.float32)
                ),
            )
            for each in scene.layers
        )  # fmt: skip
        renderer.draw(replace(scene, layers=layers, actors=()).parts(time_s), front(scene, time_s))
        shares.append(renderer.read().rgba[..., 0])
    return {layer.name: share > 0.9 for layer, share in zip(scene.layers, shares, strict=True)}


def weber(image, mask):
    """Mean local contrast: standard deviation over mean in windows of 7 pixels."""
    gray = image @ LUMINANCE
    mean = cv2.blur(gray, (7, 7))
    deviation = np.sqrt(np.maximum(cv2.blur(gray * gray, (7, 7)) - mean**2, 0))
    return float((deviation / np.maximum(mean, 0.02))[mask].mean())


def saturation(colors):
    return (colors.max(axis=-1) - colors.min(axis=-1)) / np.maximum(colors.max(axis=-1), 1e-6)


def test_clouds_light_surfaces_as_cie_says():
    """Level 1, a wall 0.396 (3 pi + 8 over 14 pi), nothing from below; the horizon a third of the zenith."""
    tilts = np.array([1.0, 0.0, -1.0])
    np.testing.assert_allclose(overcast_share(tilts), [1, (3 * np.pi + 8) / (14 * np.pi), 0], atol=2e-3)
    np.testing.assert_allclose(overcast_luminance(np.array([0.0, 0.5, 1.0])), [1 / 3, 2 / 3, 1])


def test_the_overcast_sky_is_gray_brighter_above_and_without_a_sun(surfaces):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(4000, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sun = surfaces.light().sun
    colors = overcast_sky_display(directions, sun, 7)
    assert saturation(colors).max() < 0.03
    np.testing.assert_array_equal(colors, overcast_sky_display(directions, -sun, 7))
    low, high = (colors[mask].mean() for mask in (directions[:, 2] < 0.1, directions[:, 2] > 0.8))
    assert 0.6 < low < high - 0.1 and high < 0.97
    assert 0.002 < colors[directions[:, 2] > 0.9].std() < 0.06  # clouds


def test_clouds_of_a_clear_sky_are_white_at_their_edges_and_gray_in_their_middle(surfaces):
    directions = np.random.default_rng(1).normal(size=(8000, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.3
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sun = surfaces.light().sun
    colors = sky_display(directions, sun, 7)[directions @ sun < 0.3]
    clouds = colors[colors[:, 2] - colors[:, 0] < 0.1].mean(axis=1)
    assert len(clouds) > 100 and clouds.min() < 0.84 and clouds.max() > 0.87


def test_nothing_under_clouds_has_a_sunny_side(surfaces):
    """Sunlit and shaded road differ by more than twice under the sun, and hardly under clouds."""
    quads = surfaces.layers["road"]
    lane = quads.take((np.abs(quads.centers[:, 1]) < 3) & (quads.labels == Label.ROAD) & (quads.opacity > 0.9))
    sunny, overcast = (surfaces.light(name).light_on(lane, lane.centers) @ LUMINANCE for name in ("sunny", "overcast"))
    assert np.percentile(sunny, 95) > 2 * np.percentile(sunny, 5)
    assert np.percentile(overcast, 95) < 1.45 * np.percentile(overcast, 5)


def test_a_wall_sees_more_sky_above(surfaces):
    heights = np.array([1.0, 6.0, 12.9])
    points = np.stack([np.full(3, 40.0), np.full(3, surfaces.layout.parameters.front_y_m), heights], axis=1)
    share = canyon_share(surfaces.layout, points, np.tile([0.0, -1.0, 0.0], (3, 1)))
    assert 0.2 < share[0] < share[1] - 0.1 < share[2] - 0.2


def test_the_light_between_houses_is_that_of_a_long_canyon(surfaces):
    """Level ground has the mean cosine of both eaves, a wall what the eaves opposite leave, others a mixture."""
    front, x, eaves = surfaces.layout.parameters.front_y_m, 40.0, 13.0
    y, z = 0.5 * front, 3.0
    level = 0.5 * sum(np.cos(np.arctan2(eaves - z, away)) for away in (front - y, front + y))
    to_left, to_right = (1 - np.sin(np.arctan2(eaves - z, away)) for away in (front - y, front + y))
    half = np.sqrt(0.5)
    rows = [
        ((x, y, z), (0, 0, 1), level),
        ((x, y, z), (0, 1, 0), to_left),
        ((x, y, z), (0, -1, 0), to_right),
        ((x, y, z), (0, half, half), (to_left + level) / 2),
        ((x, y, eaves + 1), (0, 0, 1), 1),
        ((surfaces.layout.parameters.end_x_m + 1, y, z), (0, 0, 1), 1),
        ((x, front + 1, z), (0, 0, 1), 1),
    ]
    points, normals, expected = (np.array(column, np.float64) for column in zip(*rows, strict=True))
    np.testing.assert_allclose(canyon_share(surfaces.layout, points, normals), expected, rtol=1e-9)


def test_wet_materials_are_darker_and_stronger_in_color_and_paint_is_not(surfaces):
    for name, label in (("houses", Label.BUILDING), ("trees", Label.VEGETATION), ("road", Label.ROAD)):
        dry = surfaces.layers[name]
        dry = dry.take((dry.labels == label) & (dry.gloss < 0.03) & (dry.opacity > 0.9))
        wet = wet_materials(dry)
        darker = wet.albedo.mean() / dry.albedo.mean()
        assert 0.35 < darker < 0.85
        assert saturation(wet.albedo).mean() > saturation(dry.albedo).mean()
    brick = surfaces.layers["houses"]
    brick = brick.take((brick.gloss == 0) & (brick.albedo[:, 0] > 1.8 * brick.albedo[:, 1]))
    assert saturation(wet_materials(brick).albedo).mean() > saturation(brick.albedo).mean() + 0.01
    cars = surfaces.layers["parked cars"]
    painted = cars.take(cars.labels == Label.CAR)
    np.testing.assert_array_equal(wet_materials(painted).albedo, painted.albedo)
    assert wet_materials(painted).gloss.mean() > painted.gloss.mean()


def test_puddles_lie_in_wheel_tracks_and_along_curbs(surfaces):
    layout = surfaces.layout
    x = np.arange(-20, 140, 0.2)
    across = {"middle": 1.7, "track": 1.7 + 0.75, "gutter": layout.parameters.curb_y_m - 0.05}
    shares = {
        name: puddles(layout, np.stack([x, np.full_like(x, y), 0 * x], axis=1)).mean() for name, y in across.items()
    }
    assert 0.02 < shares["middle"] < shares["track"] - 0.05 < shares["gutter"]
    assert shares["track"] < 0.6


def test_wet_ground_mirrors_the_sky_at_small_angles_only(street, surfaces):
    """From 1.5 m high along the street: far brighter 40 m ahead than at one's feet; dry it is as bright."""
    layer = street.layers[0]
    road = surfaces.layers["road"]
    lane = reflecting(road) & (road.labels == Label.ROAD) & (np.abs(road.centers[:, 1] + 1.7) < 1.5)
    inside = lane & (road.centers[:, 0] > 20) & (road.centers[:, 0] < 100)

    def brightness(sh, away_m):
        direction = np.array([away_m, 0, -1.5]) / np.hypot(away_m, 1.5)
        colors = evaluate_sh(sh[inside], np.tile(direction.astype(np.float32), (inside.sum(), 1)))
        return float((srgb_to_linear(np.clip(colors, 0, 1)) @ LUMINANCE).mean())

    assert layer.wet_sh is not None
    assert brightness(layer.wet_sh, 40.0) > 1.5 * brightness(layer.wet_sh, 2.0)
    assert brightness(layer.gaussians.sh, 40.0) == pytest.approx(brightness(layer.gaussians.sh, 2.0), rel=0.02)
    assert brightness(layer.wet_sh, 2.0) < 0.75 * brightness(layer.gaussians.sh, 2.0)


def test_the_wet_street_is_no_veil(street, dry_under_clouds):
    """Against the same clouds over the dry street: darker, nothing lifted, near contrasts there, colors stronger."""
    dry, depth = picture(dry_under_clouds, 0.0)
    wet, _ = picture(street, 1.0)
    of = masks(street)
    near = (depth > 0) & (depth < 30)
    solid = ~of["sky"]
    assert wet[solid].mean() < 0.97 * dry[solid].mean()
    assert np.percentile(wet[solid] @ LUMINANCE, 1) <= np.percentile(dry[solid] @ LUMINANCE, 1) + 1 / 255
    for name in ("road", "houses", "trees", "parked cars", "parked trucks"):
        assert weber(wet, of[name] & near) > 0.8 * weber(dry, of[name] & near), name
    for name in ("houses", "trees"):
        assert saturation(wet[of[name]]).mean() > saturation(dry[of[name]]).mean()
        assert wet[of[name]].mean() < dry[of[name]].mean()


def test_the_light_of_rain_is_gray_and_the_rest_stays_as_lit(street):
    """The airlight of the sunny street is blue, that of the overcast one gray; --preset paper and 0 mm/h stay sunny."""
    renderer = CpuRenderer()
    sky = sky_color(renderer, street, front(street))
    assert sky.wet_light is not None
    for sunny, overcast in zip(sky.at(0.0), sky.at(1.0), strict=True):  # drops and airlight
        assert sunny[2] > sunny[0] + 0.05
        assert max(overcast) - min(overcast) < 0.02
    assert max(sky.at(1.0).airlight) < min(sky.at(1.0).drops)  # CIE's overcast sky is darkest at the horizon
    sunny, _ = picture(street, 0.0)

    def drawn(rain, **fields):
        sequence = FrameSequence(street, RainSimulation.start(rain), front(street), 240, 160, start_s=3.0, **fields)
        return sequence.frame(renderer, 0, sky).rgba[..., :3]

    quiet = {"streaks": False, "haze": "none"}
    np.testing.assert_array_equal(drawn(RainSettings()), sunny.astype(np.float32))
    np.testing.assert_array_equal(drawn(RainSettings(intensity_mm_h=0.3, **quiet)), sunny.astype(np.float32))
    np.testing.assert_array_equal(drawn(load_preset("paper"), falls=False), sunny.astype(np.float32))
    light = drawn(RainSettings(intensity_mm_h=1.0, **quiet))
    above = masks(street)["sky"]
    assert saturation(sunny[above]).mean() > 0.15 and saturation(light[above]).mean() < 0.03


def test_the_overcast_twin_is_the_rain_without_drops_and_medium(street):
    renderer = CpuRenderer()
    sky = sky_color(renderer, street, front(street))
    rain = RainSimulation.start(RainSettings(intensity_mm_h=25.0))
    sequence = FrameSequence(street, rain, front(street), 240, 160, start_s=3.0)
    rainy, twin = (each.frame(renderer, 0, sky).rgba for each in (sequence, replace(sequence, falls=False)))
    bare = RainSimulation.start(RainSettings(intensity_mm_h=25.0, streaks=False, haze="none", splashes=False))
    np.testing.assert_array_equal(twin, replace(sequence, rainfall=bare).frame(renderer, 0, sky).rgba)
    assert np.abs(rainy - twin).mean() > 0.01


def test_vehicles_of_the_traffic_get_wet_with_lit_lamps():
    model = LIBRARY.build("saloon", "", "day")
    assert model is not None and model.wet_sh is not None
    assert model.wet_sh.shape == model.gaussians.sh.shape
    clear, wet = (np.clip(sh[:, 0] * SH_C0 + 0.5, 0, 1) for sh in (model.gaussians.sh, model.wet_sh))
    lamps = (clear[:, 0] > 2.5 * clear[:, 1]) & (model.gaussians.means[:, 0] < -1.5)
    assert lamps.sum() > 20 and np.percentile(wet[lamps, 0], 90) > np.percentile(clear[lamps, 0], 90) + 0.1

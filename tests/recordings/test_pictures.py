"""Photographs in rain: haze by known distances, streaks through a lens, the light of their sky."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.capture_photos import has_distances, photo_sky
from gsrain_engine.datasets.capture import Capture, CaptureFrame, Lens
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.recordings.pictures import PhotoRain, ScenePictures
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.photograph import Distances
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import Scene
from small_capture import small_capture
from training.small_street import small_street

LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
SKY, WALL = 200, 60
BENT = Lens("opencv", (-0.25, 0.06, 0.001, -0.002, 0.0))


def wall(depth_m, lens=None):
    """A capture of one picture: the sky over a dark wall that faces the camera."""
    photo = np.full((60, 90, 3), WALL, np.uint8)
    photo[:20] = SKY
    depth = np.where(np.arange(60)[:, None] < 20, 0, np.full((60, 90), depth_m)).astype(np.float32)
    view = CaptureFrame(
        "view", Camera(90, 60, 80.0, 80.0, 45.0, 30.0, LEVEL), photo, lens=lens, depth_source=depth,
        sky_source=depth == 0,
    )  # fmt: skip
    return Capture("wall", (view,))


@pytest.mark.parametrize("depth_m", [30.0, 300.0])
def test_a_wall_fades_by_the_extinction_of_its_distance(depth_m):
    capture, rain = wall(depth_m), RainSettings(intensity_mm_h=50, streaks=False)
    pictures = PhotoRain(CpuRenderer(), capture, rain)
    rainy = pictures.rainy(capture[0], capture[0].image)
    assert has_distances(capture) and (pictures.written, pictures.with_distances) == (1, 1)
    beta = RainSimulation.start(rain).state.extinction_per_m
    kept = np.exp(-beta * depth_m)  # in the middle, where the ray is the axis
    air, dark = srgb_to_linear(np.array([SKY, WALL]) / 255)
    expected = 255 * linear_to_srgb(np.array([kept * dark + (1 - kept) * air]))[0]
    assert rainy[50, 45].tolist() == pytest.approx([expected] * 3, abs=2)
    assert rainy[2, 45].tolist() == pytest.approx([SKY] * 3, abs=2)  # the sky is the airlight


def test_without_distances_or_rain():
    capture = wall(30.0)
    far = replace(capture, views=(replace(capture[0], depth_source=None),))
    assert not has_distances(far)
    photo = capture[0].image
    pictures = PhotoRain(CpuRenderer(), far, RainSettings(intensity_mm_h=0))
    assert pictures.rainy(far[0], photo) is photo


def test_the_light_of_drops_is_that_of_the_sky_in_the_pictures():
    day = wall(30.0)[0].image
    np.testing.assert_allclose(photo_sky(day).drops, SKY / 255, atol=0.01)
    assert max(photo_sky((day * 0.05).astype(np.uint8)).drops) < 0.06


def test_a_photograph_by_night_is_the_same_among_photographs_by_day():
    day = wall(30.0)
    night = replace(day[0], name="night", image_source=(day[0].image * 0.05).astype(np.uint8))
    rain = RainSettings(intensity_mm_h=25)
    alone, among = (PhotoRain(CpuRenderer(), replace(day, views=views), rain) for views in ((night,), (day[0], night)))
    for view in (day[0], night):
        picture = among.rainy(view, view.image)
        if view is night:
            assert picture.tobytes() == alone.rainy(night, night.image).tobytes()


def test_without_distances_the_medium_is_that_of_a_level_road():
    capture = wall(30.0)
    view = replace(capture[0], depth_source=None, sky_source=None)
    rain = RainSettings(intensity_mm_h=50, streaks=False)
    pictures = PhotoRain(CpuRenderer(), replace(capture, views=(view,)), rain)
    rainy = pictures.rainy(view, view.image).astype(float)
    assert (pictures.written, pictures.with_distances) == (1, 0)
    beta = RainSimulation.start(rain).state.extinction_per_m
    air, dark = srgb_to_linear(np.array([SKY, WALL]) / 255)
    for row in (50, 34, 25):  # on the road, far on it, and above the horizon
        fall = (row + 0.5 - 30) / 80
        away_m = min(1.5 * np.hypot(1, fall) / fall, 60.0) if fall > 0 else 60.0
        kept = np.exp(-beta * away_m)
        expected = 255 * linear_to_srgb(np.array([kept * dark + (1 - kept) * air]))[0]
        assert rainy[row, 45].mean() == pytest.approx(expected, abs=6)  # smoothed along edges
    assert rainy[2, 45].mean() == pytest.approx(SKY, abs=2)


def test_a_photograph_behind_glass_has_drops():
    capture = wall(30.0)
    rain = RainSettings(intensity_mm_h=25, streaks=False, haze="none", glass="windshield")
    rainy = PhotoRain(CpuRenderer(), capture, rain).rainy(capture[0], capture[0].image)
    changed = np.abs(rainy.astype(int) - capture[0].image).max(axis=2) > 4
    assert 0.01 < changed.mean() < 0.9 and rainy.max() <= SKY + 2  # drops show the photograph itself
    assert PhotoRain(CpuRenderer(), capture, rain).rainy(capture[0], capture[0].image).tobytes() == rainy.tobytes()


@pytest.mark.parametrize("lens", [None, BENT])
def test_a_scene_of_the_recording_gives_the_pictures(lens):
    capture = small_capture(2)
    view = replace(capture[1], lens=lens)
    dry, rainy = (
        ScenePictures(CpuRenderer(), small_street(degree=0), capture, RainSettings(intensity_mm_h=rain))
        for rain in (0.0, 50.0)
    )
    assert rainy.rainy(view, view.image).shape == view.image.shape
    if lens is None:
        assert np.abs(dry.rainy(view, view.image).astype(int) - view.image).mean() < 4


@pytest.mark.parametrize("scale", [1, 4])
def test_what_is_near_keeps_its_distance_where_that_is_measured(scale):
    """A sign at 20 m before a wall at 200 m, whose completed distances leave out its rim."""
    camera = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, LEVEL)
    photo = np.full((64, 96, 3), 150, np.uint8)
    photo[20:44, 30:54] = 120
    depth, measured = np.full((64, 96), 200.0, np.float32), np.zeros((64, 96), bool)
    depth[24:40, 34:50] = 20.0
    measured[22:44:4, 32:54:4] = measured[2:64:8, 2:28:8] = True
    depth[measured & (np.arange(96) >= 30)] = 20.0
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=50, streaks=False))
    falling = FrameInput.of(Scene("none"), rainfall, OVERCAST, RenderView(camera)).falling
    large = Camera(96 * scale, 64 * scale, 80.0 * scale, 80.0 * scale, 48.0 * scale, 32.0 * scale, LEVEL)
    photo, middle = np.repeat(np.repeat(photo, scale, axis=0), scale, axis=1), slice(scale // 2, None, scale)

    def transmittance(known):
        return Distances(camera, depth, known).transmittance(falling.medium, large, photo)[middle, middle]

    kept, alone = transmittance(measured), transmittance(np.zeros_like(measured))
    beta = rainfall.state.extinction_per_m
    sign = measured & (np.arange(96) >= 30)
    assert np.abs(kept[sign] - np.exp(-beta * 20)).max() < 0.1
    assert (kept[sign] > alone[sign]).all() and (kept >= alone - 1e-6).all()
    assert kept[32, 90] == pytest.approx(np.exp(-beta * 200 * np.hypot(1, 42 / 80)), abs=0.03)

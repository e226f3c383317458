"""The rain gauge reads the rate that was set from frames alone; single drops give width, length and area."""

import cv2
import numpy as np
import pytest

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_extras.real_rain import rain_gauge
from gsrain_extras.real_rain.photograph import render_rain_frames
from gsrain_extras.real_rain.rain_gauge import GaugedStreaks, light_residuals, measure_rain_rate

WIDTH, HEIGHT, FOCAL_PX = 960, 600, 960.0
SHUTTER_S, SKY = 0.002, 215.0
EYE = np.array([0.0, 0.0, 1.5])
CAMERA = Camera.from_fov(
    WIDTH,
    HEIGHT,
    2 * np.degrees(np.arctan(HEIGHT / 2 / FOCAL_PX)),
    look_at(EYE, EYE + [1, 0, 0], np.array([0, 0, 1.0])),
)
FALL_SPEED = load_calibration("published").velocity


def backdrop():
    """Overcast sky over dark walls with windows, in gray levels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.where(y < HEIGHT // 4, SKY, 40 + 25 * ((x // 40 + y // 60) % 3)).astype(np.uint8)


def reading(frames, horizon_px=HEIGHT):
    """Reading in front of the backdrop, which has no ground; the law of falling drops is the one of the rain."""
    return measure_rain_rate(frames, FOCAL_PX, SHUTTER_S, FALL_SPEED, horizon_px)


def rain_frames(number, **rain):
    falling = RainSimulation.start(RainSettings(exposure_s=SHUTTER_S, haze="none", **rain))
    noise = np.full((HEIGHT, WIDTH), 0.8, np.float32)
    times = [0.2 * k for k in range(number)]
    return np.stack(list(render_rain_frames(backdrop(), noise, CAMERA, falling, times, SKY)))


@pytest.fixture(scope="module")
def frames():
    return rain_frames(12, intensity_mm_h=10.0, aperture_mm=3.0, focus_distance_m=1000.0)


def test_open_areas_count_the_places_of_a_box():
    usable = np.ones((40, 60), bool)
    usable[10:18, 20:30] = False
    areas = rain_gauge._OpenAreas(usable)
    centers = np.stack(np.meshgrid(np.arange(60.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    for half in ((1, 1), (3, 7), (8, 2), (30, 3)):
        assert areas.area_px2(*half) == areas.are_open(centers, np.full((len(centers), 2), half, float)).sum()
    assert areas.area_px2(3, 7) > 0 == areas.area_px2(30, 3)


@pytest.mark.parametrize("rate", [10.0, 40.0])
def test_the_rate_that_was_set_is_read(rate, frames):
    found = reading(frames if rate == 10 else rain_frames(12, intensity_mm_h=rate, aperture_mm=0.0))
    assert found.intensity_mm_h == pytest.approx(rate, rel=0.25)
    assert found.streaks > 100
    assert found.drop_light == pytest.approx(float(srgb_to_linear(np.array(SKY / 255))), rel=0.08)
    assert found.intensity_mm_h / np.sqrt(found.streaks) < found.error_mm_h < 0.2 * found.intensity_mm_h


def test_splashes_below_the_horizon_are_not_rain(frames):
    without = frames[:6]
    splashed = without.copy()
    random = np.random.default_rng(0)
    for frame in splashed:
        for x, y in random.integers((20, HEIGHT // 2 + 20), (WIDTH - 20, HEIGHT - 40), (300, 2)):
            frame[y : y + 14, x : x + 3] = SKY
    assert reading(splashed, horizon_px=None) == reading(without, horizon_px=None)


def test_color_reads_as_gray_does(frames):
    """The reading depends on what the residuals are."""
    gray, color = (light_residuals(each) for each in (frames[:5], np.repeat(frames[:5, ..., None], 3, axis=3)))
    for name in ("background", "values", "sigma"):
        np.testing.assert_allclose(getattr(color, name), getattr(gray, name), rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(color.still, gray.still)


def test_without_rain_there_is_no_reading():
    with pytest.raises(ValueError, match="streaks: too few"):
        reading(rain_frames(5, intensity_mm_h=0.0))


def test_frames_of_dark_walls_alone_or_too_few_are_refused(frames):
    with pytest.raises(ValueError, match="dark and bright"):
        reading(frames[:5, HEIGHT // 2 :])
    with pytest.raises(ValueError, match="4 frames"):
        light_residuals(frames[:4])


def test_blur_of_the_lens_is_not_taken_as_length():
    """A disk of 12 px blurs a streak of 4 x 40 px; the gauge's own figures give back its length."""
    light = np.zeros((160, 120), np.float32)
    light[60:100, 58:62] = 0.1
    y, x = np.mgrid[-6:7, -6:7]
    disk = (x**2 + y**2 <= 36).astype(np.float32)
    blurred = cv2.filter2D(light, -1, disk / disk.sum())
    frames = np.repeat(srgb_levels(0.02 + np.zeros_like(light))[None], 9, axis=0)
    frames[4] = srgb_levels(0.02 + blurred)
    found = light_residuals(frames)
    streaks = GaugedStreaks.of(found.values[4], found)
    assert len(streaks.fall_px) == 1
    assert streaks.light_px2[0] == pytest.approx(16, rel=0.1)
    assert 8 < streaks.across_px[0] < 14
    assert streaks.fall_px[0] == pytest.approx(40, rel=0.15)


def srgb_levels(linear):
    return np.rint(255 * linear_to_srgb(linear)).astype(np.uint8)

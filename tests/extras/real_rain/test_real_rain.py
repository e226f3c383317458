"""Rain in front of photographs: its light, noise and tone curve; conditions of real sequences, and their report."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from given_rain import STILL
from gsrain_engine.datasets.rainsense import RainSequence
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.camera_response import display_noise, light_of_display, tone_curve
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.sensor import Sensor
from gsrain_extras.real_rain import rain_free
from gsrain_extras.real_rain.camera_noise import CHROMA_LAGS, LUMA_LAGS, CameraNoise, fitted_sensor, noise_statistics
from gsrain_extras.real_rain.comparison import (
    DROP_SHARE,
    MeasuredFrames,
    RealRainComparison,
    evenly_chosen,
    light_of_drops,
    load_conditions,
    simulated_frames,
    slow_light,
)
from gsrain_extras.real_rain.drop_light import drop_rays, light_before
from gsrain_extras.real_rain.photograph import cropped_camera, photographed, rain_over, render_rain_frames
from gsrain_extras.real_rain.rain_free import below_black, rain_free_frames
from gsrain_extras.real_rain.report import MEASURES, estimate, markdown
from gsrain_extras.real_rain.streaks import find_streaks, median_residuals

SKY = 220.0


def narrow_camera():
    eye, shape = np.array([0.0, 0.0, 1.5]), (240, 400)
    pose = look_at(eye, eye + [1.0, 0.0, 0.0], np.array([0.0, 0.0, 1.0]))
    return cropped_camera(Camera(1920, 1080, 1916.0, 1916.0, 960.0, 540.0, pose), (600, 200, *shape[::-1]))


def rendered(noise=1.0, **rain):
    """Gray frames of rain in front of gray 45."""
    camera, shape = narrow_camera(), (240, 400)
    background, noises = np.full(shape, 45, np.uint8), np.full(shape, noise, np.float32)
    rainfall = RainSimulation.start(RainSettings(haze="none", sensor="pinhole", **rain))
    return np.stack(list(render_rain_frames(background, noises, camera, rainfall, [0.1 * k for k in range(9)], SKY)))


@pytest.mark.parametrize("exposure_s", [0.004, 0.008])
def test_exposure_of_simulated_rain_is_estimated(exposure_s):
    table = find_streaks(median_residuals(rendered(intensity_mm_h=2.0, exposure_s=exposure_s, **STILL)), SKY)
    assert len(table) > 30
    # Four Gaussians a streak spread like a box that is 1.3 times as long.
    assert np.median(table.exposure_s) == pytest.approx(1.3 * exposure_s, rel=0.25)
    assert abs(np.median(table.angle_deg)) < 2


def test_display_mixing_is_fainter_on_dark_backgrounds():
    rain = {"noise": 0, "intensity_mm_h": 2.0, "exposure_s": 0.008}
    linear, display = (rendered(model=model, **rain).astype(float) - 45 for model in ("physical", "paper"))
    assert linear.min() >= 0 and (rendered(noise=0) == 45).all()  # no rain: the background
    assert 2 < linear.mean() / display.mean() < 8


@pytest.mark.parametrize(
    ("pictures", "spacing_s", "count", "chosen"),
    [
        (20, 0.1, 5, [5, 7, 9, 11, 13]),  # 0.2 s apart, not the possible 0.4 s
        (20, 0.04, 5, [1, 5, 9, 13, 17]),  # 0.16 s, each fourth
        (7, 1.0, 3, [2, 3, 4]),  # a second apart: farther than allowed
        (7, 0.13, 3, [1, 3, 5]),  # 0.2 s are 1.5 frames, rounded to two
        (4, 0.1, 9, [0, 1, 2, 3]),
        (3, 0.0, 3, [0, 1, 2]),
        (1, 0.0, 5, [0]),
    ],
)
def test_frames_are_chosen_around_the_middle(pictures, spacing_s, count, chosen):
    times = tuple(3.0 + spacing_s * k for k in range(pictures))
    camera = Camera.from_fov(64, 48, 60.0, np.eye(4))
    sequence = RainSequence("made up", 5.0, camera, np.zeros(5), (Path("a.png"),) * pictures, times)
    assert evenly_chosen(sequence, count) == chosen
    assert evenly_chosen(sequence, 1) == [(pictures - 1) // 2]


def test_a_tone_curve_is_inverted_and_darkens_rain_before_black():
    light = np.linspace(0, 1, 200)
    np.testing.assert_allclose(light_of_display(tone_curve(light, "crushed"), "crushed"), light, atol=3e-4)
    share = np.full((40, 50), 0.02, np.float32)

    def rise(background, curve):
        behind = np.full((40, 50), background, np.float32)
        return float(rain_over(behind, share, SKY, RainSettings(), Sensor(tone_curve=curve)).mean())

    drop, dark = (float(light_of_display(np.array([each / 255]), "crushed")[0]) for each in (SKY, 8))
    by_hand = 255 * float(tone_curve(np.array([dark + 0.02 * (drop - dark)]), "crushed")[0]) - 8
    assert rise(8.0, "crushed") == pytest.approx(by_hand, abs=0.3)
    assert rise(8.0, "crushed") < 0.5 * rise(8.0, "srgb")
    dark_over_gray = [rise(8.0, curve) / rise(48.0, curve) for curve in ("crushed", "srgb")]
    assert dark_over_gray[0] < 0.7 * dark_over_gray[1]


def test_rain_over_color_is_that_over_each_channel():
    random = np.random.default_rng(2)
    color = random.uniform(10, 200, (20, 30, 3)).astype(np.float32)
    share = random.uniform(0, 0.3, (20, 30)).astype(np.float32)
    drop = np.array([210.0, 220.0, 230.0])
    together = rain_over(color, share, drop, RainSettings(), None)
    for channel in range(3):
        alone = rain_over(np.ascontiguousarray(color[..., channel]), share, float(drop[channel]), RainSettings(), None)
        np.testing.assert_allclose(together[..., channel], alone, atol=0.05)


def test_a_drop_has_the_light_that_it_refracts_and_reflects():
    """Integrate over the disk of a drop 8 degrees above the horizon (CIE overcast sky, ground of 0.25 of it)."""
    r, turn = np.meshgrid(np.sqrt((np.arange(400) + 0.5) / 400), 2 * np.pi * (np.arange(240) + 0.5) / 240)
    into, inside = np.arcsin(r), np.arcsin(r / 1.333)
    across = ((np.cos(into) - 1.333 * np.cos(inside)) / (np.cos(into) + 1.333 * np.cos(inside))) ** 2
    along = ((1.333 * np.cos(into) - np.cos(inside)) / (1.333 * np.cos(into) + np.cos(inside))) ** 2
    reflected = (across + along) / 2

    def light(deviation):
        elevation = np.arcsin(np.clip(np.sin(deviation) * np.sin(turn), -1, 1)) + np.radians(8)
        sky = (1 + 2 * np.sin(np.clip(elevation, 0, None))) / (1 + 2 * np.sin(np.radians(8)))
        return np.where(elevation > 0, sky, 0.25)

    share = (1 - reflected) ** 2 * light(2 * (into - inside)) + reflected * light(np.pi - 2 * into)
    assert share.mean() == pytest.approx(DROP_SHARE, abs=0.03)
    sky = np.array([215.0, 220.0, 225.0])
    linear = [light_of_display(each / 255, "crushed") for each in (light_of_drops(sky, "rainsense"), sky)]
    np.testing.assert_allclose(linear[0] / linear[1], DROP_SHARE, atol=2e-3)


def test_a_drop_has_the_light_that_surrounds_it():
    """An even picture under a sky of its own color; one half red and one half green, before which drops differ."""
    camera = replace(narrow_camera(), width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
    rays, shares = drop_rays()
    forward = np.degrees(np.arccos(rays[:, 2])) < 26
    assert 0.45 < shares[forward].sum() / shares.sum() < 0.55  # half of the light is from less than 26 degrees
    dark = light_before(np.zeros((240, 320, 3), np.float32), np.zeros(3), camera, "srgb")
    assert (dark == 0).all()
    halves = np.zeros((240, 320, 3), np.float32)
    halves[:, :160, 0] = halves[:, 160:, 1] = 120
    made = light_before(halves, np.full(3, 220.0), camera, "srgb")
    left, right = made[120, 20], made[120, 300]
    assert left[0] > right[0] + 5 and right[1] > left[1] + 5
    assert (made[40] > made[200]).all()  # more of the sky


CAMERA = Sensor(
    full_well_e=600.0, read_noise_e=2.0, demosaic_px=0.6, noise_reduction=1.2, noise_reduction_px=1.2,
    sharpening=0.5, chroma_blur_px=(1.5, 1.0), jpeg_quality=95,
)  # fmt: skip


def plain_and_detailed(number=10, sensor=CAMERA):
    """Color frames without rain: half of each even, half with stripes."""
    background = np.full((120, 200, 3), 90, np.float32)
    background[:, 100:] += 30 * (np.arange(100) // 4 % 2)[None, :, None]
    noise = display_noise(sensor, 1280)[background[..., 1].astype(np.uint8)]
    random, still = np.random.default_rng(5), np.zeros_like(background)
    return [photographed(background, still, noise, sensor, random) for _ in range(number)]


def test_a_photograph_without_signal_is_its_background():
    background = np.random.default_rng(1).uniform(0, 255, (40, 56, 3)).astype(np.float32)
    still = np.zeros_like(background)
    sensor = msgspec.structs.replace(CAMERA, jpeg_quality=None)
    made = photographed(background, still, still[..., 0], sensor, np.random.default_rng(0))
    assert np.array_equal(made.color, np.rint(background).astype(np.uint8))


def test_the_sensor_of_a_cameras_noise_is_found(monkeypatch):
    monkeypatch.setattr("gsrain_extras.real_rain.camera_noise.MIN_PIXELS", 400)
    noise = CameraNoise.of([each.color for each in plain_and_detailed()])
    assert len(noise.classes) >= 2
    assert noise.difference(CAMERA, 1280) < 0.05
    other = msgspec.structs.replace(CAMERA, gain=2.5, noise_reduction=0.4)
    trials = []
    found = fitted_sensor(noise, other, 1280, lambda: trials.append(1), 40)
    assert len(trials) <= 44
    assert noise.difference(found, 1280) < 0.4 * noise.difference(other, 1280)


def test_noise_is_correlated_between_pixels_of_the_class_alone():
    pixels = np.zeros((30, 40), bool)
    pixels[8:20, 9:33] = True
    residuals = np.where(pixels, 2.0, -3.0)[None, ..., None].repeat(3, axis=0).repeat(3, axis=3).astype(np.float32)
    deviations = np.full(3, np.log(2.0))
    correlations = np.ones(len(LUMA_LAGS)), np.ones(len(CHROMA_LAGS))
    expected = np.concatenate([deviations[:1], correlations[0], deviations[1:], correlations[1]])
    np.testing.assert_allclose(noise_statistics(residuals, pixels), expected, atol=1e-5)


def test_slow_light_leaves_streaks_out():
    values = np.zeros((1, 160, 240), np.float32)
    values[0] = np.linspace(-6, 6, 240)[None, :]
    lit = values.copy()
    lit[0, 60:100, 100:106] += 30
    slow = slow_light(lit)
    assert np.abs(slow - values)[0, 24:-24, 24:-24].max() < 0.6


def noisy_frames(sigma, number=12, shape=(240, 400), seed=4):
    random = np.random.default_rng(seed)
    frames = np.clip(np.rint(120 + sigma * random.standard_normal((number, *shape))), 0, 255)
    return median_residuals(frames.astype(np.uint8))


def test_simulated_frames_have_the_noise_and_light_of_real_ones():
    real = noisy_frames(2.0)
    darker = replace(real, values=real.values + 3 * np.sin(np.arange(12))[:, None, None].astype(np.float32))
    rain = RainSettings(haze="none", sensor="rainsense", intensity_mm_h=0.0, exposure_s=0.008)
    colors = [np.full((240, 400, 3), 120, np.uint8)] * 12
    shares = [np.zeros((240, 400), np.float32)] * 12
    made = simulated_frames(darker, colors, shares, RainSimulation.start(rain), np.full(3, SKY), 1080)
    lumas = np.stack([each.luma for each in made])
    assert np.std(lumas.mean(axis=(1, 2))) == pytest.approx(3 / np.sqrt(2), rel=0.1)
    assert median_residuals(lumas).sigma.mean() == pytest.approx(real.sigma.mean(), rel=0.2)


def test_shipped_conditions():
    shipped = load_conditions("rainsense")
    assert [each.intensity_mm_h for each in shipped.sequences] == [1.376, 2.654, 4.75, 9.245]
    assert all(each.shutter_s is not None for each in shipped.sequences)
    assert shipped.of(4.75).rain("pinhole").turbulence_m_s == shipped.of(4.75).turbulence_m_s
    assert shipped.of(3.0).rain("pinhole") == RainSettings(intensity_mm_h=3.0, sensor="pinhole")


def test_frames_around_a_given_one():
    times = tuple(0.1 * k for k in range(40))
    camera = Camera.from_fov(64, 48, 60.0, np.eye(4))
    sequence = RainSequence("made up", 5.0, camera, np.zeros(5), (Path("a.png"),) * 40, times)
    assert evenly_chosen(sequence, 5, 30) == [26, 28, 30, 32, 34]
    assert evenly_chosen(sequence, 5, 39) == [31, 33, 35, 37, 39]


# Report


def measured(seed, streaks_per_frame, rise):
    """Frames with upright streaks of 30 px and 4 px before gray 45."""
    random = np.random.default_rng(seed)
    levels = np.full((12, 160, 240), 45.0)
    for k, frame in enumerate(levels):
        for j in range(streaks_per_frame):
            x = 12 + 24 * ((3 * k + j * (1 + streaks_per_frame)) % 9) + int(random.integers(5))
            y = int(random.integers(20, 100))
            frame[y : y + 30, x : x + 4] = 45 + rise
    frames = np.clip(np.rint(levels + 1.2 * random.standard_normal(levels.shape)), 0, 255).astype(np.uint8)
    colors = [np.repeat(frame[..., None], 3, axis=2) for frame in frames]
    return MeasuredFrames.of(frames, median_residuals(frames), SKY, 0.008, colors=colors)


def comparison():
    real, ours = measured(1, 2, 14), measured(2, 1, 14)
    return RealRainComparison(
        sequence="light", labelled_mm_h=2.5, rendered_mm_h=2.5, window=(0, 0, 240, 160), numbers=tuple(range(12)),
        sky_levels=SKY, real=real, ours=(ours,),
    )  # fmt: skip


def test_estimates_have_intervals():
    real = measured(1, 2, 14)
    density = estimate(real, MEASURES["Streaks per megapixel"])
    assert density.value == pytest.approx(2e6 / (160 * 240), rel=0.15)
    assert density.low <= density.value <= density.high
    length = estimate(real, MEASURES["Length, px"])
    assert length.value == pytest.approx(30, rel=0.12) and length.high - length.low < 6
    assert np.isnan(estimate(real, MEASURES["Rise before gray 0 to 16"]).value)
    assert estimate(real, MEASURES["Clouds, gray levels"]).value < 0.3
    assert estimate(real, MEASURES["Deviation of the residual, gray levels"]).value == pytest.approx(
        float(np.sqrt((real.found.values[:, real.found.still] ** 2).mean())), rel=0.05
    )


def test_the_report_is_a_table_with_goals():
    lines = markdown([comparison()]).splitlines()
    assert "|  | 2.5 mm/h, real | 2.5 mm/h, ours |" in lines
    (row,) = (line for line in lines if line.startswith("| Streaks per megapixel"))
    assert row.count("..") == 1  # each real frame has as many streaks: that figure has no width
    (goal,) = (line for line in lines if line.startswith("| Number of streaks"))
    assert "missed" in goal and "0.4" in goal
    (black,) = (line for line in lines if line.startswith("| Rise before gray 0 to 16 within"))
    assert "too few streaks" in black


# Frames without rain


def test_streaks_are_replaced_and_noise_remains():
    random = np.random.default_rng(3)
    levels = 60 + 2.0 * random.standard_normal((8, 120, 200))
    for k in range(8):
        levels[k, 30:70, 20 * k + 15 : 20 * k + 18] += 25
    gray = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    colors = [np.repeat(each[..., None], 3, axis=2) for each in gray]
    found = median_residuals(gray)
    made = np.stack(rain_free_frames(colors, found, np.zeros(gray.shape, np.float32), range(8)))[..., 0].astype(float)
    for k in range(8):
        streak = (slice(30, 70), slice(20 * k + 15, 20 * k + 18))
        assert levels[k][streak].mean() > 80 and made[k][streak].mean() == pytest.approx(60, abs=1)
    assert made.std() == pytest.approx(2.0, rel=0.1)


def test_rain_is_marked_alike_at_a_third_of_the_scale(monkeypatch):
    residual = np.random.default_rng(2).standard_normal((60, 80)).astype(np.float32)
    larger, masks = np.kron(residual, np.ones((3, 3), np.float32)), []
    for scale, values in ((1, residual), (3, larger)):
        monkeypatch.setattr(rain_free, "_SCALES", (scale,))
        masks.append(rain_free.rain_mask(values, np.ones_like(values)))
    expected = np.kron(masks[0], np.ones((3, 3), bool))
    assert 0.1 < expected.mean() < 0.9
    assert not (masks[1] & ~expected).any() and masks[1].sum() > 0.7 * expected.sum()  # a margin is a pixel of either


@pytest.mark.parametrize("below", [-1.0, -3.0, -6.0])
def test_the_levels_below_black_follow_from_the_noise(below):
    """Of a normal law with a deviation of 4, values below 0 have this mean."""
    noise = below + 4 * np.random.default_rng(1).standard_normal((60, 40, 40, 3))
    colors = list(np.clip(np.rint(noise), 0, 255).astype(np.uint8))
    assert np.median(below_black(colors)) == pytest.approx(noise[noise < 0].mean(), abs=0.8)

"""Streaks of known angle, length, width and alpha come back; noise, edges and what moves all the time give none."""

from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.rainsense import RainSequence
from gsrain_engine.evaluation.streaks import (
    BANDS,
    FALL_BY_DIAMETER_S,
    RESTLESS_LEVELS,
    StreakTable,
    coverage,
    cropped_camera,
    evenly_chosen,
    find_streaks,
    median_residuals,
    render_rain_frames,
    residual_statistics,
    streak_statistics,
)
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear

SHAPE = (160, 200)
SKY = 220.0
SAMPLES = 8
FRAMES = 9
NOTHING = np.zeros(SHAPE)
ALPHA = 0.03
RISE_LEVELS = 16.2
"""Rise of gray 45 by 0.03 of the light of gray 220."""


def box(center, angle_deg, length, width, shape=SHAPE):
    """Share of each pixel that a box covers; the angle is from the vertical, lower end to the right."""
    side = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    y = (np.arange(shape[0])[:, None] + side).ravel()[:, None] - center[1]
    x = (np.arange(shape[1])[:, None] + side).ravel()[None] - center[0]
    sine, cosine = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    inside = (np.abs(x * sine + y * cosine) <= length / 2) & (np.abs(x * cosine - y * sine) <= width / 2)
    return inside.reshape(shape[0], SAMPLES, shape[1], SAMPLES).mean(axis=(1, 3))


def frames(alphas, background=45.0, noise=1.5, seed=3):
    """One frame for each alpha image: the light of the sky added in linear light, then noise and whole levels."""
    random = np.random.default_rng(seed)
    behind, light = srgb_to_linear(np.array([background, SKY]) / 255)
    lit = [255 * linear_to_srgb((1 - a) * behind + a * light) + noise * random.standard_normal(a.shape) for a in alphas]
    return np.stack([np.clip(np.rint(each), 0, 255) for each in lit]).astype(np.uint8)


def with_streaks(*streaks, number=4, **options):
    """FRAMES frames, one of which has boxes (center, angle, length, width, alpha)."""
    alphas = [NOTHING] * FRAMES
    alphas[number] = sum(alpha * box(*shape) for *shape, alpha in streaks)
    return median_residuals(frames(alphas, **options))


@pytest.mark.parametrize("angle", [-20, 0, 8, 33, 75])
@pytest.mark.parametrize(("length", "width"), [(24, 3), (50, 5), (70, 9)])
def test_a_known_streak_comes_back(angle, length, width):
    found = with_streaks(((101.3, 80.6), angle, length, width, ALPHA))
    table = find_streaks(found, SKY)
    assert len(table) == 1
    assert table.frame[0] == 4
    np.testing.assert_allclose(table.center_px[0], (101.3, 80.6), atol=1.0)
    assert table.angle_deg[0] == pytest.approx(angle, abs=2.5)
    assert table.length_px[0] == pytest.approx(length, rel=0.12)
    assert table.width_px[0] == pytest.approx(width, abs=1.1)
    assert table.background_levels[0] == pytest.approx(45, abs=1)
    assert table.coverage_px2[0] == pytest.approx(ALPHA * length * width, rel=0.15)
    assert table.opacity[0] == pytest.approx(ALPHA, rel=0.3)
    assert table.rise_levels[0] == pytest.approx(RISE_LEVELS, rel=0.25)


def test_exposure_is_estimated_at_any_distance():
    """Near and far drops of one shutter: length and width shrink alike, the exposure stays."""
    aspect, estimates = 10.0, []
    for length in (30.0, 60.0):
        width = length / aspect
        # A disc of diameter w, smeared over length L: coverage pi/4 w^2, alpha w/L pi/4.
        found = with_streaks(((100, 80), 5, length, width, np.pi / 4 / aspect))
        estimates.append(find_streaks(found, SKY).exposure_s[0])
    np.testing.assert_allclose(estimates, FALL_BY_DIAMETER_S * aspect, rtol=0.1)


def test_opacity_and_exposure_of_measured_sizes():
    """Worked out by hand: 13^2 - 5^2 = 12^2, and a coverage of 9 pi px^2; then one that is all blur."""
    sizes = {"length_px": [13.0, 4.0], "width_px": [5.0, 5.0], "coverage_px2": [9 * np.pi, 1.0]}
    others = {name: np.zeros(2) for name in ("angle_deg", "rise_levels", "background_levels")}
    table = StreakTable(
        frame=np.zeros(2, np.int64), center_px=np.zeros((2, 2)), **others,
        **{name: np.array(values) for name, values in sizes.items()},
    )  # fmt: skip
    assert table.exposure_s == pytest.approx([FALL_BY_DIAMETER_S * 12 / 6, 0])
    assert table.opacity == pytest.approx([9 * np.pi / 65, 1 / 20])


@pytest.mark.parametrize("streak", [((100, 8), 0, 40, 4, 0.03), ((100, 80), 0, 12, 12, 0.05)], ids=["cut off", "round"])
def test_what_the_edge_cuts_off_and_what_is_round_is_no_streak(streak):
    assert len(find_streaks(with_streaks(streak), SKY)) == 0


def test_noise_alone_gives_no_streaks():
    found = median_residuals(frames([NOTHING] * 30, noise=2.5))
    assert len(find_streaks(found, SKY)) + len(find_streaks(found, SKY, darker=True)) <= 1


def test_two_streaks_stay_two_and_dark_ones_are_apart():
    found = with_streaks(((60, 70), 0, 40, 4, 0.03), ((140, 90), 0, 40, 4, 0.03))
    assert len(find_streaks(found, SKY)) == 2
    assert len(find_streaks(found, SKY, darker=True)) == 0
    darker = with_streaks(((60, 70), 0, 40, 4, -0.013))
    assert len(find_streaks(darker, SKY)) == 0
    table = find_streaks(darker, SKY, darker=True)
    assert len(table) == 1
    assert table.coverage_px2[0] == pytest.approx(0.013 * 160, rel=0.2)


def test_what_moves_all_the_time_counts_nowhere():
    random = np.random.default_rng(5)
    alphas = [random.uniform(0, 0.2) * box((50, 80), 0, 60, 30) for _ in range(FRAMES)]
    found = median_residuals(frames(alphas))
    assert not found.still[80, 50]
    assert found.still[80, 150]
    assert len(find_streaks(found, SKY)) == 0
    statistics = residual_statistics(found)
    assert statistics.still_share == pytest.approx(found.still.mean())
    assert statistics.std_levels == pytest.approx(1.5, abs=0.15)
    assert statistics.share_above < 1e-3


def test_residual_statistics_of_known_rain():
    found = with_streaks(((100, 80), 0, 80, 10, 0.03))
    statistics = residual_statistics(found)
    assert statistics.frames == FRAMES
    assert statistics.background_levels == 45
    assert statistics.noise_levels == pytest.approx(1.5, abs=0.3)
    assert statistics.share_above == pytest.approx(800 / (FRAMES * NOTHING.size), rel=0.1)
    assert statistics.share_below < 1e-4


def test_automatic_exposure_is_removed_and_too_few_or_restless_frames_are_refused():
    exposed = frames([NOTHING] * FRAMES)
    exposed[2:6] += 12
    assert residual_statistics(median_residuals(exposed)).share_above < 1e-3
    with pytest.raises(ValueError, match="4 frames"):
        median_residuals(frames([NOTHING] * 4))
    restless = median_residuals(np.random.default_rng(1).integers(0, 255, (7, 40, 50)).astype(np.uint8))
    assert RESTLESS_LEVELS < 60 and not restless.still.any()
    with pytest.raises(ValueError, match="no pixel"):
        residual_statistics(restless)


def test_statistics_count_what_the_band_holds():
    found = with_streaks(((60, 70), 10, 40, 4, 0.03), ((140, 90), 10, 25, 4, 0.03), ((100, 130), 85, 40, 4, 0.03))
    bright, darker = find_streaks(found, SKY), find_streaks(found, SKY, darker=True)
    assert len(bright) == 3
    statistics = streak_statistics(bright, darker, found)
    assert (statistics.streaks, statistics.darker) == (2, 0)  # one lies flat
    assert statistics.megapixels == pytest.approx(FRAMES * NOTHING.size * 1e-6)
    assert statistics.per_megapixel == pytest.approx(2 / statistics.megapixels)
    assert sum(statistics.length_histogram) == sum(statistics.angle_histogram) == 2
    assert statistics.length_histogram[2] == 1  # 20..30 px
    assert statistics.angle_deg[1] == pytest.approx(10, abs=2.5)
    assert [0, *(high for _, high in BANDS[:-1])] == [low for low, _ in BANDS]  # each pixel is in one of them
    halves = [streak_statistics(bright, darker, found, band).megapixels for band in ((32, 45), (45, 64))]
    assert sum(halves) == pytest.approx(statistics.megapixels) and min(halves) > 0
    brighter = streak_statistics(bright, darker, found, (64, 96))
    assert brighter.streaks == brighter.per_megapixel == 0
    assert np.isnan(brighter.length_px).all()


def test_coverage_undoes_linear_mixing():
    lit = frames([np.full(SHAPE, 0.4)], noise=0).astype(np.float32)
    np.testing.assert_allclose(coverage(np.full((1, *SHAPE), 45, np.float32), lit - 45, SKY), 0.4, rtol=0.02)


def standing_camera():
    eye = np.array([0.0, 0.0, 1.5])
    pose = look_at(eye, eye + [1.0, 0.0, 0.0], np.array([0.0, 0.0, 1.0]))
    return cropped_camera(Camera(1920, 1080, 1916.0, 1916.0, 960.0, 540.0, pose), (600, 200, 400, 240))


def rendered(rain, noise=1.0, background=45):
    shape = (240, 400)
    times = 0.1 * np.arange(FRAMES)
    made = render_rain_frames(
        np.full(shape, background, np.uint8), np.full(shape, noise, np.float32), standing_camera(),
        RainSimulation.start(rain), list(times), SKY,
    )  # fmt: skip
    return np.stack(list(made))


@pytest.mark.parametrize("exposure_s", [0.004, 0.008])
def test_our_rain_tells_the_exposure_it_was_rendered_with(exposure_s):
    found = median_residuals(rendered(RainSettings(intensity_mm_h=2.0, exposure_s=exposure_s, haze=False)))
    table = find_streaks(found, SKY)
    assert len(table) > 30
    # Four Gaussians a streak spread like a box that is 1.3 times as long.
    assert np.median(table.exposure_s) == pytest.approx(1.3 * exposure_s, rel=0.25)
    assert abs(np.median(table.angle_deg)) < 2


def test_display_mixing_is_fainter_before_dark():
    rain = {"intensity_mm_h": 2.0, "exposure_s": 0.008, "haze": False}
    linear, display = (
        rendered(RainSettings(**rain, rain_light=light), noise=0).astype(float) - 45 for light in ("linear", "display")
    )
    assert linear.min() >= 0 and (rendered(RainSettings(), noise=0) == 45).all()  # no rain: the background
    assert 2 < linear.mean() / display.mean() < 8


@pytest.mark.parametrize(
    ("pictures", "spacing_s", "count", "chosen"),
    [
        (20, 0.1, 5, [5, 7, 9, 11, 13]),  # 0.2 s apart around the middle, not the 0.4 s that there is room for
        (20, 0.04, 5, [1, 5, 9, 13, 17]),  # room for 4 pictures, 0.16 s
        (7, 1.0, 3, [2, 3, 4]),  # a second apart: farther than allowed, one by one
        (7, 0.13, 3, [1, 3, 5]),  # 0.2 s are 1.5 of these: two
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

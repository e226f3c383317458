"""Streaks of known angle, length, width and alpha are measured; noise, edges and moving objects are not."""

import numpy as np
import pytest

from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_extras.real_rain.streaks import (
    BANDS,
    FALL_BY_DIAMETER_S,
    StreakTable,
    coverage,
    find_streaks,
    median_residuals,
    residual_statistics,
    streak_statistics,
)

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
def test_known_streaks_are_measured(angle, length, width):
    table = find_streaks(with_streaks(((101.3, 80.6), angle, length, width, ALPHA)), SKY)
    assert table.frame.tolist() == [4]
    np.testing.assert_allclose(table.center_px[0], (101.3, 80.6), atol=1.0)
    assert table.angle_deg[0] == pytest.approx(angle, abs=2.5)
    assert table.length_px[0] == pytest.approx(length, rel=0.12)
    assert table.width_px[0] == pytest.approx(width, abs=1.1)
    assert table.background_levels[0] == pytest.approx(45, abs=1)
    assert table.coverage_px2[0] == pytest.approx(ALPHA * length * width, rel=0.15)
    assert table.opacity[0] == pytest.approx(ALPHA, rel=0.3)
    assert table.rise_levels[0] == pytest.approx(RISE_LEVELS, rel=0.25)


def test_opacity_and_exposure_of_known_sizes():
    """By hand: 13^2 - 5^2 = 12^2, and a coverage of 9 pi px^2; then a streak that is all blur."""
    zeros = np.zeros(2)
    table = StreakTable(
        frame=np.zeros(2, np.int64), center_px=np.zeros((2, 2)), angle_deg=zeros, length_px=np.array([13.0, 4.0]),
        width_px=np.array([5.0, 5.0]), rise_levels=zeros, background_levels=zeros,
        coverage_px2=np.array([9 * np.pi, 1.0]),
    )  # fmt: skip
    assert table.exposure_s == pytest.approx([FALL_BY_DIAMETER_S * 12 / 6, 0])
    assert table.opacity == pytest.approx([9 * np.pi / 65, 1 / 20])


@pytest.mark.parametrize(
    ("streaks", "bright", "darker"),
    [
        ([((100, 8), 0, 40, 4, 0.03)], 0, 0),  # cut off by the edge
        ([((100, 80), 0, 12, 12, 0.05)], 0, 0),  # round
        ([((60, 70), 0, 40, 4, 0.03), ((140, 90), 0, 40, 4, 0.03)], 2, 0),
        ([((60, 70), 0, 40, 4, -0.013)], 0, 1),
    ],
)
def test_streaks_are_counted(streaks, bright, darker):
    found = with_streaks(*streaks)
    table = find_streaks(found, SKY, darker=True)
    assert (len(find_streaks(found, SKY)), len(table)) == (bright, darker)
    assert table.coverage_px2 == pytest.approx(np.full(darker, 0.013 * 160), rel=0.2)


def test_noise_alone_has_no_streaks():
    found = median_residuals(frames([NOTHING] * 30, noise=2.5))
    assert len(find_streaks(found, SKY)) + len(find_streaks(found, SKY, darker=True)) <= 1


def test_restless_pixels_are_excluded():
    random = np.random.default_rng(5)
    found = median_residuals(frames([random.uniform(0, 0.2) * box((50, 80), 0, 60, 30) for _ in range(FRAMES)]))
    assert (found.still[80, 50], found.still[80, 150]) == (False, True)
    assert len(find_streaks(found, SKY)) == 0
    statistics = residual_statistics(found)
    assert statistics.still_share == pytest.approx(found.still.mean())
    assert statistics.std_levels == pytest.approx(1.5, abs=0.15)
    assert statistics.share_above < 1e-3
    restless = median_residuals(np.random.default_rng(1).integers(0, 255, (7, 40, 50)).astype(np.uint8))
    with pytest.raises(ValueError, match="no pixel"):
        residual_statistics(restless)


def test_residual_statistics_of_known_rain():
    statistics = residual_statistics(with_streaks(((100, 80), 0, 80, 10, 0.03)))
    assert (statistics.frames, statistics.background_levels) == (FRAMES, 45)
    assert statistics.noise_levels == pytest.approx(1.5, abs=0.3)
    assert statistics.share_above == pytest.approx(800 / (FRAMES * NOTHING.size), rel=0.1)
    assert statistics.share_below < 1e-4
    levels = np.full((FRAMES, 40, 50), 45, np.uint8)
    levels[4, :4] += np.array([[9], [8], [-8 % 256], [-9 % 256]], np.uint8)  # rows of 50 px; more than 8 is visible
    changed = residual_statistics(median_residuals(levels))
    assert (changed.share_above, changed.share_below) == pytest.approx((50 / levels.size, 50 / levels.size))


def test_automatic_exposure_is_removed():
    exposed = frames([NOTHING] * FRAMES)
    exposed[2:6] += 12
    assert residual_statistics(median_residuals(exposed)).share_above < 1e-3
    with pytest.raises(ValueError, match="4 frames"):
        median_residuals(exposed[:4])


def test_streak_statistics_of_a_band():
    found = with_streaks(((60, 70), 12, 35, 4, 0.03), ((140, 90), 12, 25, 4, 0.03), ((100, 130), 85, 40, 4, 0.03))
    bright, darker = find_streaks(found, SKY), find_streaks(found, SKY, darker=True)
    statistics = streak_statistics(bright, darker, found)
    assert (len(bright), statistics.streaks, statistics.darker) == (3, 2, 0)  # one is too far from the vertical
    assert statistics.megapixels == pytest.approx(FRAMES * NOTHING.size * 1e-6)
    assert statistics.per_megapixel == pytest.approx(2 / statistics.megapixels)
    assert statistics.length_histogram == (0, 0, 1, 1, 0, 0, 0, 0, 0, 0)  # 20..30 and 30..40 px
    assert statistics.angle_histogram == tuple(2 * (low == 10) for low in range(-45, 45, 5))
    assert statistics.angle_deg[1] == pytest.approx(12, abs=2.5)
    assert [0, *(high for _, high in BANDS[:-1])] == [low for low, _ in BANDS]
    halves = [streak_statistics(bright, darker, found, band).megapixels for band in ((32, 45), (45, 64))]
    assert sum(halves) == pytest.approx(statistics.megapixels) and min(halves) > 0
    brighter = streak_statistics(bright, darker, found, (64, 96))
    assert brighter.streaks == brighter.per_megapixel == 0
    assert np.isnan(brighter.length_px).all()


def test_coverage_inverts_linear_mixing():
    lit = frames([np.full(SHAPE, 0.4)], noise=0).astype(np.float32)
    np.testing.assert_allclose(coverage(np.full((1, *SHAPE), 45, np.float32), lit - 45, SKY), 0.4, rtol=0.02)

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.viewport.options import FULL_QUALITY, LEVELS, SETTLED_S, AdaptiveQuality, QualityLevel


def cost_ms(detail, by_gaussians_ms, by_pixels_ms, fixed_ms=2.0):
    return fixed_ms + by_gaussians_ms * detail.gaussians + by_pixels_ms * detail.scale**2


def drive(budget, cost, frames):
    """Move for so many frames; returns what each one was drawn with."""
    details = []
    for _ in range(frames):
        detail = budget.observe(moving=True, real_s=0.03)
        budget.measured(detail, cost(detail))
        details.append(detail)
    return details


@given(st.floats(0, 2000), st.floats(0, 300), st.floats(10, 100))
def test_holds_the_target_where_any_level_can(by_gaussians, by_pixels, target):
    budget = AdaptiveQuality(target_ms=target)

    def cost(detail):
        return cost_ms(detail, by_gaussians, by_pixels)

    details = drive(budget, cost, 200)
    fastest = min(cost(level) for level in LEVELS)
    late = [cost(each) for each in details[8:]]
    slow = sum(ms > 1.16 * max(target, fastest) for ms in late)
    assert slow <= 1 + len(late) // 40  # but for a try of the finer level now and then


@given(st.floats(0, 2000), st.floats(0, 300))
def test_does_not_flicker(by_gaussians, by_pixels):
    details = drive(AdaptiveQuality(), lambda each: cost_ms(each, by_gaussians, by_pixels), 200)[8:]
    changes = sum(a != b for a, b in pairwise(details))
    assert changes <= 2 * (len(details) // 40 + 1)


def test_a_fast_scene_is_always_exact():
    assert set(drive(AdaptiveQuality(), lambda _: 20.0, 50)) == {FULL_QUALITY}


def test_fewer_gaussians_come_before_fewer_pixels():
    assert [level.scale for level in LEVELS[:4]] == [1.0] * 4
    assert sorted(LEVELS, reverse=True) == list(LEVELS)
    details = drive(AdaptiveQuality(), lambda each: 100.0 * each.gaussians, 20)
    assert details[-1] == QualityLevel(1 / 4, 1.0)


def test_the_exact_picture_comes_back_after_a_rest_and_not_before():
    budget = AdaptiveQuality()
    drive(budget, lambda each: 200 * each.gaussians * each.scale, 10)
    coarse = budget.detail
    assert not coarse.is_exact
    assert budget.observe(moving=False, real_s=0.6 * SETTLED_S) == coarse
    assert budget.is_settling
    assert budget.observe(moving=False, real_s=0.6 * SETTLED_S) == FULL_QUALITY
    assert not budget.is_settling
    assert budget.observe(moving=True, real_s=0.01) == coarse  # and goes on where it was


def test_exact_frames_at_rest_teach_it_too():
    budget = AdaptiveQuality()
    budget.measured(budget.observe(moving=False, real_s=1.0), 132.0)
    assert budget.observe(moving=True, real_s=0.01) == QualityLevel(1 / 4, 1.0)


def test_switched_off_it_draws_everything():
    assert set(drive(AdaptiveQuality(enabled=False), lambda _: 900.0, 20)) == {FULL_QUALITY}


@pytest.mark.parametrize(
    ("detail", "words"),
    [
        (FULL_QUALITY, ""), (QualityLevel(1 / 4, 1.0), "1/4 of the Gaussians"),
        (QualityLevel(1 / 8, 1 / 2), "1/8 of the Gaussians, 50% resolution"),
    ],
)  # fmt: skip
def test_says_what_it_leaves_out(detail, words):
    assert str(detail) == words

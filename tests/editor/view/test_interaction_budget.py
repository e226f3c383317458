from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.editor.viewport.options import FULL_QUALITY, LEVELS, SETTLED_S, AdaptiveQuality


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

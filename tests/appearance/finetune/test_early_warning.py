"""The early warning speaks when it should, and only then."""

import numpy as np
import pytest

from gsrain_engine.appearance.finetune.loss_log import CHANCE, CollapseMonitor, color_distance, distance_sample

_GAN = 0.5


def _losses(change: float, judged: float = 1.0) -> dict[str, float]:
    """Losses of an iteration; `judged` is the discriminators' loss as a share of chance."""
    return {"change": change} | {
        f"judge_{look}_{kind}": 0.5 * _GAN * CHANCE * judged for look in ("rainy", "clear") for kind in ("made", "real")
    }


def _warned(distance: float, change: float, judged: float = 1.0, step: int = 500) -> str | None:
    warning = CollapseMonitor(distance, _GAN, warned_after=500)
    for _ in range(10):
        warning.add(_losses(change, judged))
    return warning.verdict(step).warning


def test_a_model_that_gives_back_what_it_gets_is_named() -> None:
    said = _warned(distance=0.2, change=0.01)
    assert said is not None and "only reconstructs" in said and "1.0% of the range, 5%" in said and "losses.gan" in said
    said = _warned(distance=0.2, change=0.01, judged=0.02)
    assert said is not None and "tell everything apart" in said


def test_a_discriminator_that_has_won_is_named() -> None:
    said = _warned(distance=0.2, change=0.15, judged=0.05)
    assert said is not None and "5% of chance" in said and "reconstructs" not in said


def test_it_is_silent_early_and_when_all_is_well() -> None:
    assert _warned(distance=0.2, change=0.01, step=499) is None
    assert _warned(distance=0.2, change=0.15) is None
    assert CollapseMonitor(0.2, _GAN, 1).verdict(1).warning is None


def test_only_recent_iterations_count() -> None:
    warning = CollapseMonitor(0.2, _GAN, warned_after=1)
    for change in [0.0] * 200 + [0.2] * 100:
        warning.add(_losses(change))
    assert warning.verdict(300).share == pytest.approx(1.0)


def test_the_distance_is_what_any_translation_must_change() -> None:
    """Of a shift it is the shift, whatever the pictures show; no change of pictures into the others is smaller."""
    random = np.random.default_rng(1)
    clear = [random.uniform(0.3, 0.9, (8, 9, 3)).astype(np.float32) for _ in range(20)]
    shifted = [(each - np.float32(0.2)) for each in clear]
    assert color_distance(clear, shifted[::-1]) == pytest.approx(0.2, abs=2e-3)
    assert color_distance(clear, clear) == 0
    other = [random.uniform(0, 1, (8, 9, 3)).astype(np.float32) ** 2 for _ in range(20)]
    change = float(np.mean([np.abs(a - b).mean() for a, b in zip(clear, other, strict=True)]))
    assert 0.05 < color_distance(clear, other) < change


def test_pictures_are_counted_evenly() -> None:
    assert distance_sample(range(3)) == [0, 1, 2]
    assert len(distance_sample(range(1000))) == 64 and distance_sample(range(1000))[-1] == 999

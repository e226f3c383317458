"""Masks of transient objects, which other images of the training contradict."""

import pytest

torch = pytest.importorskip("torch")

from gsrain_engine.training.settings import (  # noqa: E402
    TrainingSchedule,
    TrainingSettings,
)
from gsrain_engine.training.step import robust_mask  # noqa: E402


def test_a_patch_that_contradicts_is_left_out_and_noise_is_not() -> None:
    truth = torch.rand(60, 100, 3, generator=torch.Generator().manual_seed(0)) * 0.1
    shown = truth + 0.01
    shown[20:30, 40:55] += 0.5
    counts = robust_mask(shown, truth, None, max_share=0.2)
    assert not counts[22:28, 42:53].any()
    assert counts[:15].all() and counts[:, 70:].all()
    assert robust_mask(truth + 0.05, truth, None, max_share=0.2).all()


def test_no_more_is_left_out_than_allowed_and_masks_stay() -> None:
    truth, mask = torch.zeros(60, 100, 3), torch.ones(60, 100, dtype=torch.bool)
    mask[:5] = False
    shown = truth.clone()
    shown[:40, :60] = 1.0
    counts = robust_mask(shown, truth, mask, max_share=0.1)
    assert not counts[:5].any()
    assert float(counts.sum()) >= 0.89 * float(mask.sum())
    assert not robust_mask(shown, truth, torch.zeros_like(mask), max_share=0.1).any()


def test_transients_wait_until_the_scene_is_there() -> None:
    schedule = TrainingSchedule(TrainingSettings(steps=101, transients=0.1), 1.0)
    assert not schedule.leaves_out(0) and schedule.leaves_out(100)
    assert not TrainingSchedule(TrainingSettings(steps=101, transients=0.0), 1.0).leaves_out(100)

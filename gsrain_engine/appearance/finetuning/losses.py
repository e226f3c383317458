"""The losses of CycleGAN-Turbo (Parmar et al. 2024): adversarial at several levels, and pictures against pictures."""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Tensor = Any

Perceptual = Callable[[Tensor, Tensor], Tensor]
"""Distance of two batches (b, 3, h, w) of values -1..1 as eyes see it, a scalar; LPIPS is one."""


def adversarial(logits: Sequence[Tensor], real: bool) -> Tensor:
    """Sum over the levels of the mean cross-entropy of logits with "real" or "made" (multilevel sigmoid loss).

    A generator minimizes it with `real` for what it made.
    """
    losses = [torch.nn.functional.softplus(-each if real else each).mean() for each in logits]
    return torch.stack(losses).sum()


def difference(
    shown: Tensor, truth: Tensor, weight: float, perceptual_weight: float, perceptual: Perceptual | None
) -> Tensor:
    """Weighted mean absolute difference of pictures of values -1..1, plus the weighted perceptual one, if any."""
    loss = weight * (shown - truth).abs().mean()
    if perceptual is not None and perceptual_weight > 0:
        loss = loss + perceptual_weight * perceptual(shown, truth)
    return loss

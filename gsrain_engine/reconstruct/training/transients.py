"""Leaves out what contradicts the rest: things that moved, in captures that have no boxes of them."""

from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Tensor = Any

_WINDOW = 0.03
"""Side of the window that differences are averaged over, in widths of the picture: single pixels prove nothing."""
_LEAST, _TIMES = 0.08, 4.0
"""Difference of colour (0..1) below which nothing is left out, and how many medians it must have."""


def agreeing(shown: Tensor, truth: Tensor, mask: Tensor | None, most: float) -> Tensor:
    """(h, w) bool: the pixels of a mask without the patches where render and picture differ far more than elsewhere.

    Robust losses for scenes with distractors do it like this (Sabour et al. 2023, section 3.2), with a quantile; here
    that is only a bound, so that nothing is left out of a picture that is learned well all over.

    Args:
        shown: (h, w, 3) render.
        truth: (h, w, 3) photograph.
        mask: (h, w) bool, pixels that count; None means all.
        most: Share of them that may be left out.
    """
    with torch.no_grad():
        counts = torch.ones(truth.shape[:2], dtype=torch.bool, device=truth.device) if mask is None else mask
        if not counts.any():
            return counts
        difference = torch.where(counts, (shown - truth).abs().mean(dim=2), 0)
        reach = max(round(_WINDOW * truth.shape[1] / 2), 1)
        both = torch.stack([difference, counts.to(difference.dtype)])[None]
        mean, part = torch.nn.functional.avg_pool2d(both, 2 * reach + 1, 1, reach)[0]
        mean = mean / part.clamp_min(1e-6)
        ordered = mean[counts].sort().values
        bound = ordered[min(int((1 - most) * len(ordered)), len(ordered) - 1)]
        limit = torch.maximum(bound, (_TIMES * ordered[len(ordered) // 2]).clamp_min(_LEAST))
        return counts & (mean <= limit)

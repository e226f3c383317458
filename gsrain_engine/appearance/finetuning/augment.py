"""Differentiable augmentation of what a discriminator sees (Zhao et al. 2020), in plain torch."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Tensor = Any

_SHIFT = 1 / 8
"""Farthest translation, as a share of the side."""
_HOLE = 1 / 2
"""Side of the hole, as a share of the picture's side."""


def augmented(pictures: Tensor, kinds: Sequence[str], generator: Any) -> Tensor:
    """Change pictures (b, 3, h, w) of values -1..1 at random, each in its own way; gradients go through.

    `kinds` are "color", "translation" and "cutout", done in this order. `generator` is torch's, on the CPU, so that
    the same seed draws the same on every device. What a shift uncovers and a hole leaves is 0, the middle grey.
    """
    for kind in ("color", "translation", "cutout"):
        if kind in kinds:
            pictures = _KINDS[kind](pictures, generator)
    return pictures


def _color(pictures: Tensor, generator: Any) -> Tensor:
    """Brightness by up to half the range, saturation 0 to 2, contrast a half to one and a half."""
    draws = torch.rand(3, len(pictures), 1, 1, 1, generator=generator).to(pictures)
    pictures = pictures + (draws[0] - 0.5)
    grey = pictures.mean(1, keepdim=True)
    pictures = grey + (pictures - grey) * (2 * draws[1])
    middle = pictures.mean((1, 2, 3), keepdim=True)
    return middle + (pictures - middle) * (draws[2] + 0.5)


def _translation(pictures: Tensor, generator: Any) -> Tensor:
    count, _, height, width = pictures.shape
    most = [int(side * _SHIFT + 0.5) for side in (height, width)]
    down, right = (torch.randint(-by, by + 1, (count,), generator=generator).tolist() for by in most)
    padded = torch.nn.functional.pad(pictures, (most[1], most[1], most[0], most[0]))
    cuts = [
        each[:, most[0] - dy : most[0] - dy + height, most[1] - dx : most[1] - dx + width]
        for each, dy, dx in zip(padded, down, right, strict=True)
    ]
    return torch.stack(cuts)


def _cutout(pictures: Tensor, generator: Any) -> Tensor:
    """A hole whose middle lies anywhere in the picture: at its rim less is cut out."""
    count, _, height, width = pictures.shape
    kept = torch.ones(count, 1, height, width)
    sides = [int(side * _HOLE + 0.5) for side in (height, width)]
    middles = [torch.randint(0, side + 1, (count,), generator=generator).tolist() for side in (height, width)]
    for i, (y, x) in enumerate(zip(*middles, strict=True)):
        top, left = y - sides[0] // 2, x - sides[1] // 2
        kept[i, :, max(top, 0) : max(top + sides[0], 0), max(left, 0) : max(left + sides[1], 0)] = 0
    return pictures * kept.to(pictures)


_KINDS: dict[str, Any] = {"color": _color, "translation": _translation, "cutout": _cutout}

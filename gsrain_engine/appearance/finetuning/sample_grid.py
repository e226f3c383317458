"""Pictures to judge a fine-tuning by: the same clear ones every time, translated and back again."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import UInt8

from .iteration import Training
from .pictures.picture import Picture

torch: Any = import_module("torch")

Tensor = Any

_GAP_PX = 4


def sampled(pictures: Sequence[Picture], count: int) -> tuple[Picture, ...]:
    """Choose the pictures that are shown: so many, evenly spread."""
    places = np.unique(np.linspace(0, len(pictures) - 1, min(count, len(pictures))).round().astype(int))
    return tuple(pictures[int(i)] for i in places)


def sample_grid(training: Training, pictures: tuple[Picture, ...]) -> UInt8[np.ndarray, "h w 3"]:
    """A row a picture: clear, made rainy, made clear again."""
    rows = [_row(training, each) for each in pictures]
    gap = np.full((_GAP_PX, rows[0].shape[1], 3), 255, np.uint8)
    return np.concatenate([part for row in rows for part in (row, gap)][:-1])


def beside(*pictures: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    """Put (1, 3, h, w) pictures of values -1..1 side by side."""
    shown = [_pixels(each) for each in pictures]
    gap = np.full((shown[0].shape[0], _GAP_PX, 3), 255, np.uint8)
    return np.concatenate([part for each in shown for part in (each, gap)][:-1], axis=1)


def _row(training: Training, picture: Picture) -> UInt8[np.ndarray, "h w 3"]:
    clear, guide = training.order.read(picture)
    rainy = training.translated(clear, guide, "a2b")
    return beside(clear, rainy, training.translated(rainy, guide, "b2a"))


def _pixels(picture: Tensor) -> UInt8[np.ndarray, "h w 3"]:
    scaled = (picture[0].detach().float().permute(1, 2, 0) * 127.5 + 128).clamp(0, 255)
    return scaled.to(torch.uint8).cpu().numpy()

"""Folders of pictures for commands that compare them."""

from pathlib import Path

import numpy as np
from PIL import Image


def write_pictures(folder: Path, count: int, seed: int, darker: float = 1.0, noise: float = 0.0) -> Path:
    """Blocks of random colors; the same seed gives the same blocks, darker or with noise."""
    random, extra = np.random.default_rng(seed), np.random.default_rng(seed + 1000)
    folder.mkdir(parents=True)
    for k in range(count):
        values = np.kron(random.integers(30, 226, (6, 8, 3)) * darker, np.ones((8, 8, 1)))
        values = np.clip(values + noise * extra.standard_normal(values.shape), 0, 255)
        Image.fromarray(values.astype(np.uint8)).save(folder / f"{k:03}.png")
    return folder

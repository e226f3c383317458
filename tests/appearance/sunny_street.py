"""A gray street with shadows under a blue sky, and the same street under clouds, as captures of small photographs."""

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.scene.camera import Camera

WIDTH, HEIGHT, HORIZON = 240, 160, 70
LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(WIDTH, HEIGHT, 200.0, 200.0, WIDTH / 2, float(HORIZON), LEVEL)
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
SKY = ROWS < HORIZON - 10
WALL = ~SKY & (ROWS < HORIZON + 8)
ROAD = ROWS >= HORIZON + 8
SHADOW = ROAD & ((COLUMNS // 40) % 2 == 0) & (ROWS < HEIGHT - 12)
LINE = ROAD & (np.abs(COLUMNS - 60) < 3)
"""A road marking in the sun."""
DEPTH = np.where(SKY, 0, np.where(WALL, 40.0, 1.5 * 200.0 / np.maximum(ROWS + 0.5 - HORIZON, 1))).astype(np.float32)


def street_photo(*, sunny=True, seed=0):
    """A gray road with shadows of trees under a blue sky, or the same road and a gray sky."""
    photo = np.zeros((HEIGHT, WIDTH, 3))
    photo[SKY] = (110, 160, 225) if sunny else (205, 208, 212)
    photo[WALL] = (120, 110, 100)
    photo[ROAD] = 175 if sunny else 110
    if sunny:
        photo[SHADOW] = (60, 62, 66)
    photo[LINE] = np.where(SHADOW[LINE][:, None], 100, 240) if sunny else 190
    photo[~SKY] += np.random.default_rng(seed).normal(0, 3, photo[~SKY].shape)
    return np.clip(photo, 0, 255).astype(np.uint8)


def capture_of(*photos, depth=DEPTH, sky=SKY, lens=None):
    views = (
        CaptureFrame(
            f"view {i}", CAMERA, photo, time_s=float(i), lens=lens, depth_source=depth,
            sky_source=sky if depth is not None else None,
        )
        for i, photo in enumerate(photos)
    )  # fmt: skip
    return Capture("street", tuple(views))

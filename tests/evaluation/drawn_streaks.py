"""Frames with known streaks: boxes of a given angle, length, width and alpha, drawn with 8 samples a pixel side."""

import numpy as np

from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear

SHAPE = (160, 200)
SKY = 220.0
SAMPLES = 8


def box(center, angle_deg, length, width, shape=SHAPE):
    """Share of each pixel that a box covers; the angle is from the vertical, lower end to the right."""
    side = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    y = (np.arange(shape[0])[:, None] + side).ravel()[:, None] - center[1]
    x = (np.arange(shape[1])[:, None] + side).ravel()[None] - center[0]
    sine, cosine = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    inside = (np.abs(x * sine + y * cosine) <= length / 2) & (np.abs(x * cosine - y * sine) <= width / 2)
    return inside.reshape(shape[0], SAMPLES, shape[1], SAMPLES).mean(axis=(1, 3))


def frames(alphas, background=45.0, noise=1.5, seed=3):
    """One frame for each alpha image: the light of the sky added in linear light, then noise and whole levels."""
    random = np.random.default_rng(seed)
    behind, light = srgb_to_linear(np.array([background, SKY]) / 255)
    shown = [
        255 * linear_to_srgb((1 - a) * behind + a * light) + noise * random.standard_normal(a.shape) for a in alphas
    ]
    return np.stack([np.clip(np.rint(each), 0, 255) for each in shown]).astype(np.uint8)

"""Colours for numbers, and for layers; common_heat.glsl's twin."""

import colorsys

import numpy as np
from jaxtyping import Float32

_COEFFICIENTS = np.array(
    [
        [0.13572138, 0.09140261, 0.10667330],
        [4.61539260, 2.19418839, 12.64194608],
        [-42.66032258, 4.84296658, -60.58204836],
        [132.13108234, -14.18503333, 110.36276771],
        [-152.94239396, 4.27729857, -89.90310912],
        [59.28637943, 2.82956604, 27.34824973],
    ],
    np.float32,
)


def heat_colors(numbers: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n 3"]:
    """Colour map "turbo" of numbers in 0..1 (Mikhailov 2019), a polynomial of degree 5 a channel."""
    t = np.clip(numbers, 0, 1)[..., None]
    color = np.broadcast_to(_COEFFICIENTS[-1], (*numbers.shape, 3))
    for coefficients in _COEFFICIENTS[-2::-1]:
        color = color * t + coefficients
    return np.clip(color, 0, 1)


def layer_color(number: int) -> tuple[float, float, float]:
    """Colour of layer or actor 0, 1, 2...: hues a golden angle apart, bright and darker in turn."""
    return colorsys.hsv_to_rgb((0.6 + number * 0.61803399) % 1.0, 0.65, (0.95, 0.75, 0.55)[number % 3])

"""Where water stands on the ground: a function of place in the world, so that all views agree. Metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.special import ndtri

from .bumps import bumps
from .smoothstep import smoothstep

_OCTAVES = ((4.3, 0.8), (2.1, 0.9), (1.0, 0.5), (0.47, 0.25), (0.23, 0.13), (0.11, 0.07))
"""Size of a bump in metres, and its height relative to the first: the finest frays the shores."""
_PATCHES = (0.0, 1.0, 1.0, 0.9, 0.6, 0.6)
"""Strength of each in the film's thickness."""
_TURN = 2.39996
"""Radians from one octave's axes to the next one's (the golden angle): no direction repeats."""
_HEIGHT_M = 0.006
"""Standard deviation of the ground's unevenness that no capture can tell: a road of middling quality."""
_STANDING = 0.12
"""Share of an even road under standing water when it is soaked."""
_SHORE, _RIM = 0.35, 1.3
"""Widths, in standard deviations of height, of the shore and of the damp rim about it."""
_UNSEEN = 3.4
"""Width of the smooth step that is nearest to a normal distribution's, in its standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class StandingWater:
    """What stands on the ground; each map is 0..1."""

    puddle: Float32[np.ndarray, "h w"]
    """Share of each pixel under standing water."""
    rim: Float32[np.ndarray, "h w"]
    """How near to it: 1 in the puddle, falling to 0."""
    patches: Float32[np.ndarray, "h w"]
    """How the film's thickness differs from place to place: 0.5 on average."""


def standing_water(
    points_m: Float64[np.ndarray, "h w 3"],
    footprint_m: Float32[np.ndarray, "h w"],
    sunk_m: Float32[np.ndarray, "h w"],
    wetness: float,
    seed: int,
) -> StandingWater:
    """Tell where water stands.

    The ground is uneven by a sum of random bumps of halving size, and by `sunk_m`, how far each place is known to lie
    under its surroundings. Water fills what lies lowest, up to the level under which the share of an even road that the
    wetness asks for lies. Bumps smaller than a pixel's `footprint_m` are not drawn: there the share of the pixel under
    water is returned, so nothing flickers far away.
    """
    low = np.zeros(points_m.shape[:-1], np.float32)
    hidden = np.zeros_like(low)
    patches = np.zeros_like(low)
    total = float(np.sum([height**2 for _, height in _OCTAVES]))
    for k, (size, height) in enumerate(_OCTAVES):
        share = 1 / (1 + np.square(np.square(np.minimum(footprint_m / (0.6 * size), 1e3))))
        height_there = share * bumps(points_m, size, k * _TURN, seed * 31 + k)
        low += np.float32(height / np.sqrt(total)) * height_there
        hidden += np.float32(height**2 / total) * (1 - share**2)
        patches += np.float32(_PATCHES[k]) * height_there
    low += sunk_m / np.float32(_HEIGHT_M)
    level = ndtri(1 - _STANDING * wetness)
    depth = low - np.float32(level)
    blur = _SHORE + _UNSEEN * np.sqrt(hidden)
    return StandingWater(
        smoothstep(-0.5, 0.5, depth / blur), smoothstep(-_RIM, 0.1, depth), smoothstep(-2.6, 2.6, patches)
    )

"""The light that a scene was seen in, told from all its views at once: what sun and shadow look like in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.scene.srgb import srgb_to_linear

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of linear sRGB (IEC 61966-2-1)."""
DARKEST_EV = -10.0
"""Stops below white at which a pixel counts as black."""

MOST_CONTRAST_EV = 3.0
"""Sun and clear sky together over the sky alone: seven or eight to one. What is darker is dark by itself."""

_VIEWS, _STRIDE = 8, 4
"""So many views are looked at, spread evenly, and every so many-th pixel of each, both ways."""
_GREY = 0.35
"""Largest saturation (spread over maximum, linear) of ground that the light can be told from."""
_NEAR_M, _FAR_M = 1.5, 60.0
_BINS = 80
_UNTOLD_EV = -3.0
"""Ground where none is seen: a grey of 0.125."""


@dataclass(frozen=True, slots=True)
class SceneLight:
    """Light on level grey ground. Brightness in stops (EV) over white, linear light."""

    sun: float
    """How surely there are two kinds of ground, sunlit and shadowed: 0 to 1."""
    shadow_ev: float
    sunlit_ev: float
    """Mean brightness of both; equal where there is one kind only."""
    level_ev: float
    """Mean brightness of all ground."""
    shadow_tint_ev: tuple[float, float, float]
    sunlit_tint_ev: tuple[float, float, float]
    """Colour of both: stops of red, green and blue over their luminance."""


def scene_light(views: Sequence[ClearView]) -> SceneLight:
    """Tell the light from at most eight views of a sequence; each is asked for once."""
    chosen = sorted({round(i) for i in np.linspace(0, len(views) - 1, min(len(views), _VIEWS))})
    samples = [_ground_samples(views[i]) for i in chosen]
    colors = np.concatenate([np.zeros((0, 3), np.float32), *(each[0] for each in samples)])
    weights = np.concatenate([np.zeros(0, np.float32), *(each[1] for each in samples)])
    if len(colors) < 100:
        return SceneLight(0.0, _UNTOLD_EV, _UNTOLD_EV, _UNTOLD_EV, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    levels = np.log2(np.maximum(colors @ LUMINANCE, 2**DARKEST_EV))
    return _two_kinds(colors, levels, weights)


def _ground_samples(view: ClearView) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Colours (linear) of level grey ground, and what area of it each stands for."""
    every = (slice(None, None, _STRIDE), slice(None, None, _STRIDE))
    light = srgb_to_linear(view.image[every])
    depth, brightest = view.depth[every], light.max(axis=-1)
    is_grey = light.max(axis=-1) - light.min(axis=-1) <= _GREY * np.maximum(brightest, 1e-4)
    is_free = (view.sky[every] < 0.05) & (view.vehicles[every] < 0.1)
    is_ground = (view.normals[every][..., 2] > 0.7) & (depth > _NEAR_M) & (depth < _FAR_M) & is_grey & is_free
    return light[is_ground].astype(np.float32), (depth[is_ground] ** 2).astype(np.float32)


def _two_kinds(
    colors: Float[np.ndarray, "n 3"], levels: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> SceneLight:
    """Part brightness in two where the variance between both parts is largest (Otsu 1979)."""
    counts, edges = np.histogram(levels, _BINS, (DARKEST_EV, 0.0), weights=weights)
    share = counts / counts.sum()
    middle = (edges[1:] + edges[:-1]) / 2
    below, mean = np.cumsum(share), float(share @ middle)
    spread = np.maximum(below * (1 - below), 1e-9)
    between = np.where(spread > 1e-6, (mean * below - np.cumsum(share * middle)) ** 2 / spread, 0)
    cut = int(np.argmax(between))
    is_sunlit = levels > edges[cut + 1]
    parts = [_mean(colors, levels, weights * which) for which in (~is_sunlit, is_sunlit)]
    (dark, dark_tint), (bright, bright_tint) = parts
    rarer = min(float(below[cut]), 1 - float(below[cut]))
    dark = max(dark, bright - MOST_CONTRAST_EV)
    sun = _ramp(0.8, 1.6, bright - dark) * _ramp(0.01, 0.04, rarer)
    _, tint = _mean(colors, levels, weights)
    dark_tint, bright_tint = (_between(tint, each, sun) for each in (dark_tint, bright_tint))
    return SceneLight(sun, mean + sun * (dark - mean), mean + sun * (bright - mean), mean, dark_tint, bright_tint)


def _mean(
    colors: Float[np.ndarray, "n 3"], levels: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> tuple[float, tuple[float, float, float]]:
    total = max(float(weights.sum()), 1e-9)
    color = np.maximum(weights @ colors / total, 2**DARKEST_EV)
    red, green, blue = (float(each) for each in np.log2(color / (color @ LUMINANCE)))
    return float(weights @ levels) / total, (red, green, blue)


def _between(
    start: tuple[float, float, float], end: tuple[float, float, float], share: float
) -> tuple[float, float, float]:
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(start, end, strict=True))
    return red, green, blue


def _ramp(low: float, high: float, value: float) -> float:
    return float(np.clip((value - low) / (high - low), 0, 1))

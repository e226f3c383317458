"""Damp air: what is far fades into the light of the cloudy horizon."""

import cv2
import numpy as np
from jaxtyping import Float, Float32

from gsrain_engine.appearance.clear_view import ClearView

from .guided import guided
from .settings import WetSettings
from .sky import overcast_sky

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]


_FILL_SHARE, _EDGE_SHARE, _EDGE2 = 0.02, 0.012, 0.002
"""Sizes over which an unknown distance is taken from around it, and over which distances keep to the picture's edges,
as shares of its width; variance of display brightness from which something is an edge."""
_ENCLOSED = 0.5
"""Share of known distances around a gap from which it is filled: what lies beyond them may be near or far."""


def in_mist(surface: Image, view: ClearView, rays: Float[np.ndarray, "h w 3"], settings: WetSettings) -> Image:
    """Fade by exp(-extinction * distance) (Koschmieder 1924), linear light in and out; the sky stays as it is.

    `rays` are world directions a metre of view depth long.
    """
    if settings.mist_km == 0:
        return surface
    through = np.exp(-settings.mist_km / 1000 * view.depth * np.linalg.norm(rays, axis=-1)).astype(np.float32)
    left = _even(through, view)[..., None]
    level = rays * (1, 1, 0)
    level /= np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9)
    return (left * surface + (1 - left) * overcast_sky(level, settings)).astype(np.float32)


def _even(through: Plane, view: ClearView) -> Plane:
    """Give unknown places what is around them, and let steps be only where the picture has edges too."""
    width = view.camera.width
    known = (view.depth > 0).astype(np.float32)
    sigma = max(1.0, _FILL_SHARE * width)
    around = cv2.GaussianBlur(known, (0, 0), sigma)
    mean = cv2.GaussianBlur(known * through, (0, 0), sigma) / np.maximum(around, 1e-6)
    filled = np.where(known > 0, through, np.where((around > _ENCLOSED) & (view.sky < 1), mean, 1)).astype(np.float32)
    guide = np.ascontiguousarray(view.image.mean(axis=-1))
    return np.clip(guided(filled, guide, max(1, round(_EDGE_SHARE * width)), _EDGE2), 0, 1)

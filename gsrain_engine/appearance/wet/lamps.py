"""Lamps, lit signs and traffic lights: as bright as ever under a dimmer sky, with a soft glow around them."""

import cv2
import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.scene.srgb import srgb_to_linear

from .smoothstep import smoothstep
from .surfaces import Surfaces

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]

_AROUND_SHARE = 0.025
"""A lamp is small: it outshines the mean over this share of the picture's width."""
_GLOW_SHARES, _GLOW_STRENGTHS = (0.004, 0.014), (0.25, 0.12)
"""Spread of the glow's core and skirt as shares of the picture's width, and how strong they are."""
BRIGHTENING = 2.0
"""Of lamps over their clear look: the camera opens up under cloud, lamps don't dim."""


def lamp_share(view: ClearView, surfaces: Surfaces, tail_lamps: bool = True) -> Plane:
    """How surely each pixel is a light of its own, 0 to 1: bright, colourful, small, neither sky nor ground.

    With `tail_lamps` also what is red on a vehicle and redder than what is around it.
    """
    light = srgb_to_linear(view.image).astype(np.float32)
    brightest = light.max(axis=-1)
    colorful = 1 - light.min(axis=-1) / np.maximum(brightest, 1e-4)
    is_lit = smoothstep(0.45, 0.75, brightest) * smoothstep(0.6, 0.8, colorful)
    red, green, blue = (light[..., i] for i in range(3))
    is_red_to_green = (green >= 0.9 * blue) | (red > 2 * blue)
    size = 2 * max(2, round(_AROUND_SHARE * view.camera.width)) + 1
    outshines = smoothstep(2.0, 4.0, brightest / (cv2.blur(brightest, (size, size)) + 0.02))
    own = is_lit * is_red_to_green * outshines
    if tail_lamps and surfaces.vehicles.any():
        redness = np.maximum(red - np.maximum(green, blue), 0)
        redder = smoothstep(1.5, 2.5, redness / (cv2.blur(redness, (size, size)) + 0.02))
        own = np.maximum(own, smoothstep(0.15, 0.4, redness) * redder * surfaces.vehicles)
    return (own * (1 - view.sky) * (1 - surfaces.ground)).astype(np.float32)


def with_lamps(surface: Image, view: ClearView, share: Plane, glow: float) -> Image:
    """Put lamps back at their own brightness, and light around them. Linear light in and out."""
    if not share.any():
        return surface
    own = BRIGHTENING * srgb_to_linear(view.image).astype(np.float32)
    lit = surface + share[..., None] * (np.maximum(own, surface) - surface)
    emitted = share[..., None] * own
    for size, strength in zip(_GLOW_SHARES, _GLOW_STRENGTHS, strict=True):
        lit = lit + glow * strength * cv2.GaussianBlur(emitted, (0, 0), max(0.8, size * view.camera.width))
    return lit.astype(np.float32)

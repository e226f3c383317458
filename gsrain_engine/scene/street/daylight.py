"""Daylight baked into the street: one sun with shadows, the sky's ambient light, light from the ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from ..srgb import linear_to_srgb
from .labels import Label
from .layout import StreetLayout
from .parameters import StreetParameters
from .quads import Quads
from .shadows import ground_occlusion, sun_visibility
from .sky import sky_display

_SUN_LIGHT = np.array([3.05, 2.72, 2.18])
_SKY_LIGHT = np.array([0.50, 0.62, 0.82])
_GROUND_LIGHT = np.array([0.30, 0.27, 0.22])
_EXPOSURE = 1.18
_MIRRORED = np.array([0.36, 0.40, 0.45])
"""Display colour that a mirror shows when it reflects the horizon."""
_MIRRORED_UP = np.array([0.30, 0.37, 0.48])
"""What is added where it reflects the zenith, and taken away where it reflects the road."""
_MIRRORED_SUN = np.array([0.16, 0.15, 0.12])
_HAZE = np.array([0.70, 0.78, 0.86])
_HAZE_LENGTH_M = 1400.0


@dataclass(frozen=True, slots=True)
class Daylight:
    """Where the sun stands and what stands in its way; without a layout the object stands in the open."""

    sun: Float64[np.ndarray, "3"]
    """Unit vector towards the sun."""
    layout: StreetLayout | None = None
    seed: int = 0

    @classmethod
    def over(cls, parameters: StreetParameters, layout: StreetLayout | None = None) -> "Daylight":
        azimuth, elevation = np.radians(parameters.sun_azimuth_deg), np.radians(parameters.sun_elevation_deg)
        sun = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        return cls(sun, layout, parameters.seed)

    def display_colors(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Matte display colour (0..1) of each quad, lit as at `points` (its centre, or one of its corners)."""
        if len(quads) and quads.labels[0] == Label.SKY:
            return self._sky(points)
        normals = quads.normals.astype(np.float64)
        facing = np.maximum(normals @ self.sun, 0)
        leaf = quads.labels == Label.VEGETATION  # leaves glow when the sun is behind them
        facing = np.where(leaf, 0.30 + 0.62 * facing, facing)
        visible = quads.sun_access.astype(np.float64)
        ambient = quads.sky_access.astype(np.float64)
        if self.layout is not None:
            lit = (facing * visible) > 1e-3
            visible[lit] *= sun_visibility(self.layout, self.sun, points[lit], leaf[lit])
            ambient = ambient * ground_occlusion(self.layout, points, normals)
        up = 0.5 + 0.5 * normals[:, 2]
        light = (facing * visible)[:, None] * _SUN_LIGHT
        light += ambient[:, None] * (up[:, None] * _SKY_LIGHT + (1 - up)[:, None] * _GROUND_LIGHT)
        radiance = 1 - np.exp(-_EXPOSURE * light * quads.albedo)
        return self._hazy(linear_to_srgb(radiance), points)

    def gloss_of(
        self, normals: Float[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "n 3 3"]]:
        """Return what a mirror adds to the display colour: a constant, and a linear form of the viewing direction.

        The mirrored direction d - 2 (d.n) n is linear in d, and so is a smooth sky seen in it: that is spherical
        harmonics of degree 1. The form has shape (n, direction, colour).
        """
        n = normals.astype(np.float64)
        flip = np.eye(3) - 2 * n[:, :, None] * n[:, None, :]
        return _MIRRORED, flip[:, :, 2:] * _MIRRORED_UP + (flip @ self.sun)[:, :, None] * _MIRRORED_SUN

    def _sky(self, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        middle = 0.0
        if self.layout is not None:
            p = self.layout.parameters
            middle = 0.5 * (p.start_x_m + p.end_x_m)
        away = points - np.array([middle, 0, 0])
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return sky_display(away, self.sun, self.seed).astype(np.float32)

    def _hazy(self, colors: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Let far things fade into the air; only hills are far enough to show it."""
        if self.layout is None:
            return colors.astype(np.float32)
        p = self.layout.parameters
        x = np.clip(points[:, 0], p.start_x_m, p.end_x_m)
        far = np.hypot(points[:, 0] - x, points[:, 1])
        part = 1 - np.exp(-np.maximum(far - 60, 0) / (0.45 * _HAZE_LENGTH_M))
        return (colors + (_HAZE - colors) * part[:, None]).astype(np.float32)

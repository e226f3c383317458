"""Lighting of the street: a table of skies, and the display colors of its surfaces under one of them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.skies import SUNNY, Lighting, LightingName, TimeOfDay, overcast_share

from .lamp_light import Windows, light_of_lamps
from .layout import StreetLayout, StreetParameters
from .mesh import Quads
from .night import light_on_traffic
from .shadows import ground_occlusion, sun_visibility

LIGHT_OF: dict[TimeOfDay, tuple[LightingName, LightingName]] = {
    "day": ("sunny", "overcast"),
    "overcast": ("overcast", "overcast"),
    "dusk": ("dusk", "dusk"),
    "night": ("night", "night"),
}
"""Lighting in dry weather, and in rain."""


@dataclass(frozen=True, slots=True)
class Illumination:
    """A lighting with the direction of the sun, and the layout that occludes both; without a layout nothing does."""

    sun: Float64[np.ndarray, "3"]
    """Unit vector towards the sun."""
    layout: StreetLayout | None = None
    seed: int = 0
    lighting: Lighting = SUNNY
    windows: Windows | None = None
    """Lit windows, by night."""

    @classmethod
    def over(
        cls,
        parameters: StreetParameters,
        layout: StreetLayout | None = None,
        lighting: Lighting = SUNNY,
        windows: Windows | None = None,
    ) -> "Illumination":
        azimuth, elevation = np.radians(parameters.sun_azimuth_deg), np.radians(parameters.sun_elevation_deg)
        sun = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        return cls(sun, layout, parameters.seed, lighting, windows)

    def display_colors(
        self, quads: Quads, points: Float[np.ndarray, "n 3"], arriving: Float64[np.ndarray, "n 3"] | None = None
    ) -> Float32[np.ndarray, "n 3"]:
        """Matte display color (0..1) of each quad, lit as at `points` (its center, or one of its corners).

        `arriving` is the light on them, if it is known.
        """
        if len(quads) and quads.labels[0] == Label.SKY:
            return self._sky(points)
        light = self.light_on(quads, points) if arriving is None else arriving
        if self.lighting.lamps:
            return self._hazy(self.lighting.display(light * quads.albedo + quads.emission), points)
        return self._hazy(self.lighting.display(light, quads.albedo), points)

    def light_on(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Light on each quad at `points`: times its albedo, it is the light towards the camera.

        A long street is lit in sections, each with the trees and vehicles that can shade it.
        """
        if len(quads) and quads.labels[0] == Label.SKY:
            return np.zeros((len(quads), 3))
        if self.layout is not None and self.layout.parameters.length_m > _SECTION_M:
            light = np.empty((len(quads), 3))
            section = np.floor(points[:, 0] / _SECTION_M).astype(np.int64)
            for number in np.unique(section).tolist():
                own = np.flatnonzero(section == number)
                light[own] = self._section(number * _SECTION_M)._light_on(quads.take(own), points[own])
            return light
        return self._light_on(quads, points)

    def sun_reaching(self, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Fraction of the sun that houses, crowns and parked vehicles leave at points."""
        if self.layout is None:
            return np.ones(len(points))
        solid = np.zeros(len(points), np.bool_)
        if self.layout.parameters.length_m <= _SECTION_M:
            return sun_visibility(self.layout, self.sun, points, solid)
        visible, section = np.empty(len(points)), np.floor(points[:, 0] / _SECTION_M).astype(np.int64)
        for number in np.unique(section).tolist():
            own, part = np.flatnonzero(section == number), self._section(number * _SECTION_M).layout
            assert part is not None
            visible[own] = sun_visibility(part, self.sun, points[own], solid[own])
        return visible

    def _section(self, start_m: float) -> "Illumination":
        """Light on the section of a long street that begins at x = `start_m`."""
        assert self.layout is not None
        low, high = start_m - _SHADE_M, start_m + _SECTION_M + _SHADE_M
        trees = tuple(each for each in self.layout.trees if low < each.x < high)
        cars = tuple(each for each in self.layout.cars if low < each.x < high)
        trucks = tuple(each for each in self.layout.trucks if low < each.x < high)
        buses = tuple(each for each in self.layout.buses if low < each.x < high)
        pedestrians = tuple(each for each in self.layout.pedestrians if low < each.x < high)
        cyclists = tuple(each for each in self.layout.cyclists if low < each.x < high)
        near = replace(
            self.layout, trees=trees, cars=cars, trucks=trucks, buses=buses, pedestrians=pedestrians, cyclists=cyclists
        )
        return replace(self, layout=near)

    def _light_on(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        if self.lighting.diffuse == "overcast":
            light = self._overcast_light(quads, points)
            return light + self._light_of_lamps(quads, points) if self.lighting.lamps else light
        normals = quads.normals.astype(np.float64)
        facing = np.maximum(normals @ self.sun, 0)
        leaf = quads.labels == Label.VEGETATION  # light transmitted by leaves
        facing = np.where(leaf, 0.30 + 0.62 * facing, facing)
        visible = quads.sun_access.astype(np.float64)
        ambient = quads.sky_access.astype(np.float64)
        if self.layout is not None:
            lit = (facing * visible) > 1e-3
            visible[lit] *= sun_visibility(self.layout, self.sun, points[lit], leaf[lit])
            ambient = ambient * ground_occlusion(self.layout, points, normals)
        up = 0.5 + 0.5 * normals[:, 2]
        light = (facing * visible)[:, None] * self.lighting.sun
        light += ambient[:, None] * (up[:, None] * self.lighting.sky + (1 - up)[:, None] * self.lighting.ground)
        return light

    def _overcast_light(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Light of the clouds that houses, trees and vehicles leave, and of walls and ground around."""
        normals, lighting = quads.normals.astype(np.float64), self.lighting
        tilt = normals[:, 2]
        sky = overcast_share(tilt)
        leaf = quads.labels == Label.VEGETATION
        sky = np.where(leaf, (1 - _THROUGH_LEAVES) * sky + _THROUGH_LEAVES, sky)
        access = quads.sky_access.astype(np.float64)
        visible = np.full(len(quads), _OPEN_STREET)
        if self.layout is not None:
            access = access * ground_occlusion(self.layout, points, normals, canyon=False)
            visible = canyon_share(self.layout, points, normals)
        sky = visible * sky + (1 - visible) * _WALLS_AROUND
        below = 0.5 - 0.5 * tilt
        return access[:, None] * (sky[:, None] * lighting.sky + below[:, None] * lighting.ground)

    def _light_of_lamps(self, quads: Quads, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        if self.layout is None or self.windows is None:
            return light_on_traffic(quads.normals.astype(np.float64), quads.sky_access)
        return light_of_lamps(self.layout, self.windows, quads, points)

    def gloss_of(
        self, normals: Float[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "n 3 3"]]:
        """Mirror reflection added to the display color: a constant, and a linear form of the viewing direction.

        The mirrored direction d - 2 (d.n) n is linear in d, and so is the reflection of a smooth sky: these are
        spherical harmonics of degree 1. The form has shape (n, direction, color).
        """
        n, own = normals.astype(np.float64), self.lighting
        flip = np.eye(3) - 2 * n[:, :, None] * n[:, None, :]
        return own.mirrored, flip[:, :, 2:] * own.mirrored_up + (flip @ self.sun)[:, :, None] * own.mirrored_sun

    def _sky(self, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        p = None if self.layout is None else self.layout.parameters
        away = points - np.array([0.0 if p is None else 0.5 * (p.start_x_m + p.end_x_m), 0, 0])
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return self.lighting.sky_display(away, self.sun, self.seed).astype(np.float32)

    def _hazy(self, colors: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
        """Blend distant surfaces into haze; only the hills are far enough to show it."""
        if self.layout is None:
            return colors.astype(np.float32)
        p = self.layout.parameters
        x = np.clip(points[:, 0], p.start_x_m, p.end_x_m)
        far = np.hypot(points[:, 0] - x, points[:, 1])
        part = 1 - np.exp(-np.maximum(far - 60, 0) / (0.45 * _HAZE_LENGTH_M))
        return (colors + (self.lighting.haze - colors) * part[:, None]).astype(np.float32)


_SECTION_M = 260.0  # maximum length of a street that is lit in one piece
_SHADE_M = 30.0  # maximum distance of a shadow from the tree or vehicle that casts it
_HAZE_LENGTH_M = 1400.0

# Overcast sky

_THROUGH_LEAVES = 0.22
"""Share of the light on a leaf that comes through it from above, whatever its own tilt."""
_WALLS_AROUND = 0.14
"""Light of walls that occlude the sky, relative to the open sky on level ground."""
_OPEN_STREET = 0.62  # share of the sky that a moving vehicle's surfaces see between the houses
_EAVES_M = 13.0  # height of houses that occlude the sky, on average


def canyon_share(
    layout: StreetLayout, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Share of the sky's light that rows of houses on both sides leave, 0..1; 1 outside of the street.

    Between two long walls a level surface has (cos a + cos b)/2 of a uniform sky, a and b the elevations of both eaves;
    a wall has 1 - sin g, g the elevation of the eaves opposite (view factors of a long street canyon, Oke 1987).
    """
    p, n, a = points.astype(np.float64), normals.astype(np.float64), layout.parameters
    over = np.maximum(_EAVES_M - p[:, 2], 0)
    left, right = (np.maximum(a.front_y_m - side * p[:, 1], 0.05) for side in (1, -1))
    level = 0.5 * (left / np.hypot(left, over) + right / np.hypot(right, over))
    ahead = np.where(n[:, 1] > 0, left, right)
    wall = 1 - over / np.hypot(ahead, over)
    share = n[:, 1] ** 2 * wall + (1 - n[:, 1] ** 2) * level
    inside = (p[:, 0] > a.start_x_m) & (p[:, 0] < a.end_x_m) & (np.abs(p[:, 1]) < a.front_y_m + 0.5)
    return np.where(inside, share, 1.0)

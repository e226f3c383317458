"""Rain frame: drops and haze at one time for one camera."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, sh_from_color
from ..scene.geometry import srgb_to_linear
from ..scene.lamps import LitLamps
from ..scene.lens import ViewBounds, view_bounds
from .drop_field import DropCulling, DropPhases, Drops, place_drops, search_drops
from .haze import make_haze
from .lamp_light import LampLight, light_of_drops, make_lamp_light
from .medium import NO_STREAKS, RainMedium, make_medium, streak_depths
from .phase import fog_phase, rain_phase
from .settings import RainSettings
from .shelter_map import ShelterMap
from .streaks import ShutterModel, sh_of, streak_gaussians


@dataclass(frozen=True, eq=False)
class RainCamera:
    """Camera and surroundings for which rain is computed. World frame, meters."""

    camera: Camera
    anchor_to_world: Float64[np.ndarray, "4 4"]
    """Frame of the rain regions: x forward, y left, z up, without tilt."""
    velocity_m_s: Float64[np.ndarray, "3"]
    focal_px: float | None = None
    """Focal length of the output image; None uses the camera's own."""
    roofs: ShelterMap | None = None
    """Map of sheltered areas; None if rain reaches everything."""
    exposure_share: float = 1.0
    """Fraction of the shutter time, for one of several sub-frames that share it."""
    ground_m: float | None = None
    """Height of the ground in the world, above which the wind grows; None if it is the streak region's lower face."""
    floor_m: float | None = None
    """Height of the ground below the camera in the world, where rays of its medium end; None if it is unknown."""


class SkyLight(NamedTuple):
    """Light of the sky in rain, as display colors."""

    drops: tuple[float, float, float]
    """Mean of the sky: a drop refracts almost all of it (paper, eq. 3)."""
    airlight: tuple[float, float, float]
    """Color that distant things fade into: that of the sky just above the horizon."""

    def at(self, overcast: float) -> "SkyLight":
        """Light at a share of the overcast sky: the same at any."""
        return self

    @classmethod
    def uniform(cls, color: tuple[float, float, float]) -> "SkyLight":
        """Light of a sky that has one color."""
        return cls(color, color)

    def mixed(self, other: "SkyLight", share: float) -> "SkyLight":
        """Linear mix of display values with a share (0..1) of another sky."""
        pairs = zip(self, other, strict=True)
        (r, g, b), (s, t, u) = ([(1 - share) * c + share * w for c, w in zip(*pair, strict=True)] for pair in pairs)
        return SkyLight((r, g, b), (s, t, u))


class FallingDrops(NamedTuple):
    """Drops at one time. World frame, meters."""

    numbers: Int64[np.ndarray, " m"]
    """Rising."""
    class_index: Int64[np.ndarray, " m"]
    positions_m: Float64[np.ndarray, "m 3"]
    diameters_mm: Float64[np.ndarray, " m"]
    velocities_m_s: Float64[np.ndarray, "m 3"]

    def only(self, mask: Bool[np.ndarray, " m"]) -> "FallingDrops":
        return FallingDrops(*(each[mask] for each in self))


@dataclass(frozen=True, eq=False)
class RainFrame:
    """Drops and haze at one time for one camera, to be sorted and composited with the scene's Gaussians.

    World frame, meters, z up. Drops fill a periodic cell around the camera; kernels and shaders find the visible ones
    and turn them into streaks. Renderers apply the dilation compensation and draw down to an alpha of 1/65536.
    """

    rain: RainSettings
    """Settings at this time."""
    time_s: float
    view: RainCamera
    color: Float64[np.ndarray, "3"]
    """Display color of a drop."""
    airlight: Float64[np.ndarray, "3"]
    """Display color of the medium."""
    haze_count: int
    """M: number of haze Gaussians at full opacity within the haze region."""
    extinction_per_m: float
    """beta: extinction coefficient of all drops, times the haze gain, and of fog."""
    fog_extinction_per_m: float
    """Part of beta that is fog."""
    count: int
    """Number of drops in the cell; drops have the numbers 0 to `count` - 1."""
    find_drops: Callable[[], tuple[DropPhases, DropCulling]]
    """Returns `where` and `culling`: they cost more than all else here, and medium and light do without them."""
    period_m: Float64[np.ndarray, "3"]
    """Edge lengths of the cell."""
    axes: Float64[np.ndarray, "3 3"]
    """Cell to world, a rotation."""
    center_m: Float64[np.ndarray, "3"]
    """Center of the cell, and of the streak region, in the world."""
    diameters_mm: Float64[np.ndarray, " classes"]
    fall_speed_m_s: Float64[np.ndarray, " classes"]
    shutter: ShutterModel
    roofs: ShelterMap | None = None
    """Sheltered areas over the cell; None without any."""
    lamps: LitLamps | None = None
    """Lamps that light drops and medium, in the world; None without any."""
    splashes: Gaussians | None = None
    """Splashes of drops that have landed; None without any."""

    @property
    def where(self) -> DropPhases:
        """Places of the drops in the cell."""
        return self.find_drops()[0]

    @property
    def culling(self) -> DropCulling:
        """Visibility tests of the drops."""
        return self.find_drops()[1]

    @property
    def is_clear(self) -> bool:
        """True without rain and fog."""
        return self.rain.intensity_mm_h == 0 and self.extinction_per_m == 0

    @property
    def draws_drops(self) -> bool:
        """True if there are drops, and they are drawn one by one."""
        return self.rain.streaks and self.count > 0

    @property
    def has_haze(self) -> bool:
        """True if there is a medium, or haze of Gaussians."""
        far = self.rain.haze
        return far == "gaussians" or (self.extinction_per_m if far == "medium" else self.fog_extinction_per_m) > 0

    @property
    def is_linear(self) -> bool:
        """True if drops are blended in linear light, false if as display colors (the paper's form)."""
        return not self.rain.is_paper

    @property
    def airlight_linear(self) -> Float32[np.ndarray, "3"]:
        """Color of the medium in linear light."""
        return srgb_to_linear(self.airlight).astype(np.float32)

    @property
    def light_linear(self) -> Float32[np.ndarray, "3"]:
        """Color of a drop in linear light."""
        return srgb_to_linear(self.color).astype(np.float32)

    def visible_drops(self, *, in_view: bool = True, smallest_class: int = 0) -> FallingDrops:
        """Find the drops in the open that may be visible to the camera; without `in_view` all in the streak region.

        Drops of classes below `smallest_class` are left out.
        """
        count = self.count if self.rain.streaks or not in_view else 0
        if count == 0:
            none = np.zeros(0, np.int64)
            return FallingDrops(none, none, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
        camera = self.view.camera
        bounds = None if camera.is_pinhole else view_bounds(camera)
        everywhere = not in_view or (bounds is not None and bounds.slopes is None)
        numbers = search_drops(
            count, self.rain.seed, self.where, self.culling, self.period_m,
            everywhere=everywhere, smallest_class=smallest_class,
        )  # fmt: skip
        falling = self.falling(place_drops(numbers, self.rain.seed, self.where))
        if bounds is not None and in_view:
            falling = self._within_view(falling, bounds)
        return falling if self.roofs is None else falling.only(~self.roofs.shelter(falling.positions_m))

    def _within_view(self, falling: FallingDrops, bounds: ViewBounds) -> FallingDrops:
        """Drops up to the distance at which their class ends, in the cone of a lens's view."""
        camera = self.view.camera
        points = (falling.positions_m - camera.position) @ camera.world_to_camera[:3, :3].T
        distances = np.linalg.norm(points, axis=1)
        margins = self.culling.class_margin_m[falling.class_index]
        outside = np.hypot(points[:, 0], points[:, 1]) * np.cos(bounds.angle_rad)
        outside -= points[:, 2] * np.sin(bounds.angle_rad)
        seen = (outside <= margins) | (distances <= margins) | (bounds.angle_rad >= np.pi)
        ends = distances if camera.lens is not None else points[:, 2]
        return falling.only(seen & (ends <= self.culling.class_far_m[falling.class_index]))

    def falling(self, drops: Drops) -> FallingDrops:
        """Positions, sizes and velocities of drops in the world."""
        c = drops.class_index
        positions = drops.positions(self.period_m) @ self.axes.T + self.center_m
        velocities = np.empty((len(c), 3))
        velocities[:, :2] = drops.air_velocity_m_s
        velocities[:, 2] = -self.fall_speed_m_s[c]
        return FallingDrops(drops.numbers, c, positions, self.diameters_mm[c], velocities)

    @cached_property
    def max_drops(self) -> int:
        """Upper bound on the number of visible drops, exceeded with a chance of one in millions; sizes GPU buffers."""
        left, right, top, bottom = np.abs(self.culling.slopes)
        wide, high, far, margin = left + right, top + bottom, self.culling.class_far_m, self.culling.class_margin_m
        volume = wide * high * far**3 / 3 + margin * (wide + high) * far**2 + 4 * margin**2 * far
        expected = self.count * float(np.mean(np.minimum(volume / np.prod(self.period_m), 1.0)))
        return min(self.count, int(1.1 * expected + 10 * np.sqrt(expected)) + 64)

    @cached_property
    def drops(self) -> FallingDrops:
        """Drops that may be visible to the camera."""
        return self.visible_drops()

    @cached_property
    def streaks(self) -> Gaussians:
        """Streak Gaussians of the visible drops."""
        if not self.draws_drops:
            return Gaussians.empty()
        drops = self.drops
        return streak_gaussians(
            drops.positions_m, drops.diameters_mm, drops.velocities_m_s, self.shutter, self.rain, self.color
        )

    @cached_property
    def lit_streaks(self) -> Gaussians:
        """Streak Gaussians that have the light of lamps as their color, in linear light."""
        if self.lamp_light is None or not self.is_linear or not len(self.streaks):
            return self.streaks
        light = light_of_drops(self.lamp_light, self.streaks.means, self.view.camera)
        return replace(self.streaks, sh=sh_from_color(light))

    @cached_property
    def lamp_light(self) -> LampLight | None:
        """Light of lamps on drops and medium; None without lamps."""
        if self.lamps is None or not len(self.lamps.positions_m):
            return None
        rain = rain_phase(self.rain.intensity_mm_h)
        medium = self.medium
        fog = self.fog_extinction_per_m / medium.extinction_per_m if medium is not None else 0.0
        phase = (1 - fog) * rain + fog * fog_phase()
        return make_lamp_light(self.lamps, self.view.camera, medium, phase, rain)

    @cached_property
    def haze(self) -> Gaussians:
        """Haze Gaussians in the open."""
        if self.rain.haze != "gaussians":
            return Gaussians.empty()
        view = self.view
        return make_haze(
            self.rain, self.haze_count, self.time_s, view.anchor_to_world, view.camera.position, self.color, view.roofs
        )

    @cached_property
    def drawn_haze(self) -> Gaussians:
        """Haze Gaussians, then splashes; with the light of lamps as their color, as `lit_streaks`: none on haze."""
        haze, splashes = self.haze, self.splashes
        if self.lamp_light is not None and self.is_linear:
            haze = replace(haze, sh=sh_of(np.zeros(3), len(haze)))
            if splashes is not None:
                light = light_of_drops(self.lamp_light, splashes.means, self.view.camera)
                splashes = replace(splashes, sh=sh_from_color(light))
        return haze if splashes is None else Gaussians.concatenate([haze, splashes])

    @cached_property
    def medium(self) -> RainMedium | None:
        """Medium of fog and, with `haze: medium`, of the drops that are not drawn one by one; None without it."""
        has_drops = self.rain.haze == "medium"
        extinction = self.extinction_per_m if has_drops else self.fog_extinction_per_m
        if extinction <= 0:
            return None
        per_m3 = self.count / float(np.prod(self.period_m)) if has_drops else 0.0
        streaks = NO_STREAKS
        if self.rain.streaks:
            streaks = streak_depths(self.rain, per_m3, self.diameters_mm, self.culling.class_far_m)
        view = self.view
        air = self.airlight_linear
        return make_medium(self.rain, extinction, view.camera, view.anchor_to_world, streaks, air, view.floor_m)

    @property
    def gaussians(self) -> Gaussians:
        """All Gaussians of the rain, G_rain(t): streaks, then haze."""
        return Gaussians.concatenate([self.streaks, self.haze])

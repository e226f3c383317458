"""Splashes: crowns and droplets where drops land on a film, near the camera, as Gaussians like those of streaks.

A drop splashes above a threshold of its Weber and Ohnesorge numbers and the depth of the film. The sheet that it throws
up, the crown, grows in radius with the root of time and falls back; its rim sheds droplets, which fly on their own.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from ..rain.frame import RainFrame
from ..rain.pcg_hash import pcg4d
from ..rain.simulation import RainSimulation
from ..rain.streaks import camera_slopes, sh_of, streak_gaussians
from ..scene.gaussians import Gaussians
from ..scene.ground_water import WetGround
from ..scene.rolling_shutter import GLOBAL_SHUTTER
from .films import WaterFilms
from .impacts import CELL_M, WATER_KG_M3, GroundImpacts, ImpactFlux, LandedDrops, cells_around

FARTHEST_M = 20.0
"""Distance beyond which splashes are not drawn."""
SMALLEST_PX = 0.3
"""Width in the picture below which crowns and droplets are not drawn."""
TENSION_N_M, VISCOSITY_PA_S = 0.0728, 1.0e-3
"""Surface tension and dynamic viscosity of water at 20 C."""
_LIFE = 1.2  # of a crown, in capillary times sqrt(rho D^3 / sigma)
_COVERAGE = 0.5  # mean alpha of a crown's two walls over its outline
_SEGMENTS = 8
_RING_PX = 3.0  # radius from which a crown is drawn as a ring of segments
_DROPLETS = 8
_FLIGHT_S = 0.4
_BEFORE_GROUND_M, _BEFORE_GROUND = 0.75, 0.15  # by which splashes are moved towards the camera, and largest share
_G = 9.81
_GOLDEN = 2.399963


def splash_number(
    diameters_mm: Float64[np.ndarray, " n"], speeds_m_s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """K = We Oh^-0.4 of drops that land: inertia over surface tension, and viscosity."""
    diameter = 1e-3 * diameters_mm
    weber = WATER_KG_M3 * speeds_m_s**2 * diameter / TENSION_N_M
    ohnesorge = VISCOSITY_PA_S / np.sqrt(WATER_KG_M3 * TENSION_N_M * diameter)
    return weber * ohnesorge**-0.4


def splash_threshold(
    diameters_mm: Float64[np.ndarray, " n"], film_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """K from which a drop splashes on a film: 2100 + 5880 (h / D)^1.44 (Cossali, Coghe and Marengo 1997), h up to D.

    Its coefficients were not compared with a copy.
    """
    return 2100 + 5880 * np.minimum(film_mm / diameters_mm, 1) ** 1.44


def splash_rate(flux: ImpactFlux, film_mm: float) -> float:
    """Number of drops on a square meter in a second down to the smallest that splashes on a film; 0 if none does."""
    films = np.full(len(flux.diameters_mm), film_mm)
    splashing = splash_number(flux.diameters_mm, flux.speeds_m_s) > splash_threshold(flux.diameters_mm, films)
    return float(flux.larger_per_m2_s[splashing].max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Splashes:
    """Splashes of a rain in front of one camera at one time."""

    rainfall: RainSimulation
    frame: RainFrame
    films: WaterFilms
    heights: WetGround

    def gaussians(self) -> Gaussians:
        """Crowns and droplets as Gaussians in the world, with the color of drops.

        Gaussians are sorted by their centers, and those of the ground reach over what lies behind theirs: splashes are
        moved towards the camera and made smaller, so that the ground does not cover them.
        """
        return self._before_ground(Gaussians.concatenate([self._crowns(), self._droplets()]))

    def _before_ground(self, gaussians: Gaussians) -> Gaussians:
        eye = self.frame.shutter.camera.position
        away = gaussians.means.astype(np.float64) - eye
        distance = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
        nearer = 1 - np.minimum(_BEFORE_GROUND_M / distance, _BEFORE_GROUND)
        means, scales = eye + nearer * away, nearer * gaussians.scales
        return replace(gaussians, means=means.astype(np.float32), scales=scales.astype(np.float32))

    def landed(self, past_s: float, reach_m: float) -> LandedDrops:
        """Impacts in view that splash, of the time `past_s` up to the end of the exposure."""
        shutter, time_s = self.frame.shutter, self.frame.time_s
        impacts = GroundImpacts(self.rainfall)
        film_mm = self.films.at(time_s).film_mm
        rate = splash_rate(impacts.flux_at(time_s), film_mm)
        if rate <= 0:
            return impacts.land(np.zeros((0, 2), np.int64), time_s, time_s)
        half = shutter.exposure_s / 2
        found = impacts.land(self._cells(reach_m), time_s - half - past_s, time_s + half, rate)
        films = self.films.depth_mm(found.places_m, time_s)
        splashes = splash_number(found.diameters_mm, found.speeds_m_s) > splash_threshold(found.diameters_mm, films)
        splashes &= self.heights.is_open(found.places_m)
        roofs = self.frame.roofs
        if roofs is not None:
            splashes &= ~roofs.shelter(np.column_stack([found.places_m, self.heights.at(found.places_m)]))
        return found.only(splashes)

    def _cells(self, reach_m: float) -> Int64[np.ndarray, "m 2"]:
        """Cells of the ground within reach that may be in view."""
        camera = self.frame.shutter.camera
        eye = camera.position
        cells = cells_around(eye[:2] - reach_m, eye[:2] + reach_m)
        middles = np.column_stack([(cells + 0.5) * CELL_M, np.full(len(cells), self.heights.ground_m)])
        x, y, z = ((middles - eye) @ camera.world_to_camera[:3, :3].T).T
        margin = CELL_M
        left, right, top, bottom = camera_slopes(camera).tolist()
        wide, high = margin * np.hypot(1, max(-left, right)), margin * np.hypot(1, max(-top, bottom))
        seen = (z > -margin) & (x > left * z - wide) & (x < right * z + wide)
        seen &= (y > top * z - high) & (y < bottom * z + high)
        seen |= not camera.is_pinhole and left == right  # a lens without such edges
        seen &= np.hypot(*(middles - eye)[:, :2].T) < reach_m + margin
        return cells[seen]

    def _places(self, of: LandedDrops) -> Float64[np.ndarray, "n 3"]:
        return np.column_stack([of.places_m, self.heights.at(of.places_m)])

    def _distances(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        return np.maximum(np.linalg.norm(points - self.frame.shutter.camera.position, axis=1), 0.1)

    def _crowns(self) -> Gaussians:
        shutter, time_s = self.frame.shutter, self.frame.time_s
        found = self.landed(float(crown_life_s(np.array([6.0]))[0]), FARTHEST_M)
        life, half = crown_life_s(found.diameters_mm), shutter.exposure_s / 2
        begins = np.clip(time_s - half - found.times_s, 0, life)
        ends = np.clip(time_s + half - found.times_s, 0, life)
        age = 0.5 * (begins + ends)
        films = self.films.depth_mm(found.places_m, time_s)
        radius, height = crown_size_m(age, found.diameters_mm, found.speeds_m_s, films)
        places = self._places(found)
        away = self._distances(places)
        width_px = 2 * radius / away * shutter.focal_px
        drawn = (ends > begins) & (width_px > SMALLEST_PX) & (away < FARTHEST_M)
        share = (ends - begins)[drawn] / shutter.exposure_s
        places, radius, height, width_px = places[drawn], radius[drawn], height[drawn], width_px[drawn]
        places[:, 2] += height / 2
        near = width_px > 2 * _RING_PX
        # One Gaussian has a cylinder's variances, r^2 / 2 across and H^2 / 12 upwards, and its coverage.
        across, upwards = radius[~near] / np.sqrt(2), height[~near] / np.sqrt(12)
        alpha = _COVERAGE * 2 * radius[~near] * height[~near] / (2 * np.pi * across * upwards)
        far = self._blurred(places[~near], across, upwards, alpha * share[~near])
        turns = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
        r, h = np.repeat(radius[near], _SEGMENTS), np.repeat(height[near], _SEGMENTS)
        ring = np.repeat(places[near], _SEGMENTS, axis=0)
        ring[:, 0] += r * np.tile(np.cos(turns), near.sum())
        ring[:, 1] += r * np.tile(np.sin(turns), near.sum())
        across, upwards = np.pi * r / _SEGMENTS / np.sqrt(3), h / np.sqrt(12)
        alpha = _COVERAGE * 2 * r * h / _SEGMENTS / (2 * np.pi * across * upwards)
        close = self._blurred(ring, across, upwards, alpha * np.repeat(share[near], _SEGMENTS))
        return Gaussians.concatenate([far, close])

    def _blurred(
        self,
        places: Float64[np.ndarray, "n 3"],
        across: Float64[np.ndarray, " n"],
        upwards: Float64[np.ndarray, " n"],
        alpha: Float64[np.ndarray, " n"],
    ) -> Gaussians:
        """Upright Gaussians blurred by the camera's motion along the ground and by its lens."""
        shutter = self.frame.shutter
        moved = shutter.velocity_m_s * shutter.exposure_s
        along = np.sqrt(across**2 + float(moved @ moved) / 12)
        depths = (places - shutter.camera.position) @ shutter.camera.world_to_camera[2, :3]
        circle = shutter.lens.circle_of_confusion_m(np.maximum(depths, 0)) / 4
        scales = np.stack([np.hypot(along, circle), np.hypot(across, circle), np.hypot(upwards, circle)], axis=1)
        thinner = (across * upwards) / np.sqrt(scales[:, 0] * scales[:, 1]) / scales[:, 2]
        yaw = 0.5 * np.arctan2(moved[1], moved[0])
        quaternions = np.tile(np.array([np.cos(yaw), 0, 0, np.sin(yaw)], np.float32), (len(places), 1))
        opacities = np.clip(alpha * thinner, 0, 1).astype(np.float32)
        sh = sh_of(self.frame.color, len(places))
        return Gaussians(places.astype(np.float32), scales.astype(np.float32), quaternions, opacities, sh)

    def _droplets(self) -> Gaussians:
        """Droplets of splashes so near that the largest are wide enough; streaks by their own motion, as of rain."""
        shutter, time_s, rain = self.frame.shutter, self.frame.time_s, self.frame.rain
        reach = min(FARTHEST_M, 1e-3 * shutter.focal_px / SMALLEST_PX)
        found = self.landed(_FLIGHT_S, reach)
        if not len(found.times_s):
            return Gaussians.empty()
        made = droplets(found, time_s, self._places(found), self.films.depth_mm(found.places_m, time_s))
        wide = 1e-3 * made.diameters_mm * shutter.focal_px > SMALLEST_PX * self._distances(made.positions_m)
        wide &= made.positions_m[:, 2] > np.repeat(self.heights.at(found.places_m), _DROPLETS)
        wide &= made.is_aloft
        if shutter.camera.rolling is not None:  # moves all splashes when they are drawn
            camera = replace(shutter.camera, rolling=None)
            shutter = replace(shutter, camera=camera, readout=GLOBAL_SHUTTER)
        return streak_gaussians(
            made.positions_m[wide], made.diameters_mm[wide], made.velocities_m_s[wide], shutter, rain, self.frame.color
        )


# Crowns


def crown_life_s(diameters_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Time until a crown has fallen back: 1.2 sqrt(rho D^3 / sigma); the factor is ours."""
    return _LIFE * np.sqrt(WATER_KG_M3 * (1e-3 * diameters_mm) ** 3 / TENSION_N_M)


def crown_size_m(
    age_s: Float64[np.ndarray, " n"],
    diameters_mm: Float64[np.ndarray, " n"],
    speeds_m_s: Float64[np.ndarray, " n"],
    film_mm: Float64[np.ndarray, " n"],
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Radius and height of a crown in m.

    Radius D (2 D / 3 h)^(1/4) sqrt(V t / D) (Yarin and Weiss 1995), h from 0.1 to 1 D. The height is a parabola over
    the crown's life, of at most D sqrt(We / 200), 3 D for a drop of 3 mm; that is ours.
    """
    diameter = 1e-3 * diameters_mm
    thickness = np.clip(film_mm / diameters_mm, 0.1, 1)
    radius = diameter * (2 / (3 * thickness)) ** 0.25 * np.sqrt(speeds_m_s * age_s / diameter)
    weber = WATER_KG_M3 * speeds_m_s**2 * diameter / TENSION_N_M
    part = np.clip(age_s / crown_life_s(diameters_mm), 0, 1)
    return radius, diameter * np.sqrt(weber / 200) * 4 * part * (1 - part)


# Droplets


@dataclass(frozen=True, slots=True, eq=False)
class Droplets:
    """Droplets of splashes at one time, `_DROPLETS` for each of them. World frame, meters."""

    positions_m: Float64[np.ndarray, "n 3"]
    velocities_m_s: Float64[np.ndarray, "n 3"]
    diameters_mm: Float64[np.ndarray, " n"]
    is_aloft: np.ndarray
    """True for those that exist and have left the crown."""


def droplets(
    found: LandedDrops, time_s: float, places_m: Float64[np.ndarray, "n 3"], film_mm: Float64[np.ndarray, " n"]
) -> Droplets:
    """Fly the droplets of splashes: they leave the rim of the crown and slow down to their fall speed by linear drag.

    Their number is 7.84e-6 K^1.8 (h / D)^-0.3 (Okawa, Shiraishi and Mori 2006; not compared with a copy), at most 8;
    their sizes, 0.08 to 0.28 D, and speeds, 0.2 to 0.5 V at 45 to 75 degrees, are ours.
    """
    n = len(found.times_s)
    number = np.tile(np.arange(_DROPLETS, dtype=np.uint32), n)
    zero = np.zeros(n * _DROPLETS, np.uint32)
    of = np.repeat(np.arange(n), _DROPLETS)
    random = pcg4d(found.hashes[of], number, zero, zero + np.uint32(1))
    size, speed, rise, turn = (each * 2.0**-32 for each in random)
    v, d = found.speeds_m_s[of], found.diameters_mm[of]
    k, thickness = splash_number(found.diameters_mm, found.speeds_m_s), np.clip(film_mm / found.diameters_mm, 0.1, 1)
    exist = number < (7.84e-6 * k**1.8 * thickness**-0.3)[of]
    diameters = d * (0.08 + 0.2 * size**3)
    azimuth = _GOLDEN * number + 2 * np.pi * turn / _DROPLETS
    up = np.radians(45 + 30 * rise)
    start = (0.2 + 0.3 * speed) * v
    out = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    leaves = 0.3 * crown_life_s(found.diameters_mm)
    radius, height = crown_size_m(leaves, found.diameters_mm, found.speeds_m_s, film_mm)
    age = time_s - found.times_s[of] - leaves[of]
    slowing = 4.0 * diameters / _G  # s: fall speed of 4 m/s a millimeter
    kept = np.exp(-np.maximum(age, 0) / slowing)
    along = (start * np.cos(up))[:, None] * out
    upward = start * np.sin(up)
    positions, velocities = places_m[of].copy(), np.empty((len(of), 3))
    positions[:, :2] += radius[of, None] * out + along * (slowing * (1 - kept))[:, None]
    positions[:, 2] += height[of] + (upward + _G * slowing) * slowing * (1 - kept) - _G * slowing * np.maximum(age, 0)
    velocities[:, :2] = along * kept[:, None]
    velocities[:, 2] = (upward + _G * slowing) * kept - _G * slowing
    return Droplets(positions, velocities, diameters, exist & (age > 0))

"""Haze: the extinction coefficient of falling drops, and far drops as large, faint Gaussians."""

import numpy as np
from jaxtyping import Float64, UInt32

from ..scene.gaussians import Gaussians
from .pcg_hash import pcg4d
from .settings import RainSettings
from .shelter_map import ShelterMap
from .streaks import sh_of

LIFETIME_S, FADE_S = 4.0, 1.0  # lifetime of a haze Gaussian, with a smoothstep fade at both ends
RAMP_M = (3.0, 5.0)  # distances from the camera between which haze fades in; streaks represent nearer drops

_SMOOTH_COUNT, _MAX_SHARES = 16_000, 16
"""M Gaussians are split into the geometric mean of M and `_SMOOTH_COUNT`, at most 16 each, to limit their number."""

_SALT = 0x68617A65  # makes haze independent of drops with the same seed
_FADE_MEAN = (LIFETIME_S - FADE_S) / LIFETIME_S  # a smoothstep has mean 1/2


EXTINCTION_EFFICIENCY = 2.0
"""Q: a drop much larger than the wavelength removes twice its cross-section from a beam (van de Hulst, 1957)."""


def extinction_per_m(rain: RainSettings, density_m3: float, mean_square_m2: float) -> float:
    """Extinction coefficient of falling drops from their number per m3 and their mean squared diameter (eq. 6)."""
    return rain.haze_gain * np.pi / 4 * EXTINCTION_EFFICIENCY * density_m3 * mean_square_m2


def haze_count(rain: RainSettings, extinction: float) -> int:
    """Number M of haze Gaussians in the haze region: M = beta V_f / (2 pi s_h^2 alpha_m), unless the settings fix it.

    The extinction along a ray then equals that of the drops, `extinction` per m. 0 if haze is not of Gaussians.
    """
    if extinction <= 0 or rain.haze != "gaussians":
        return 0
    if rain.haze_count is not None:
        return rain.haze_count
    shadow_m2 = 2 * np.pi * rain.haze_sigma_m**2 * rain.haze_opacity
    return round(extinction * rain.haze_box.volume_m3 / shadow_m2)


def make_haze(
    rain: RainSettings,
    count: int,
    time_s: float,
    anchor_to_world: Float64[np.ndarray, "4 4"],
    camera_position: Float64[np.ndarray, "3"],
    color: Float64[np.ndarray, "3"],
    roofs: ShelterMap | None = None,
) -> Gaussians:
    """Place the haze Gaussians at a time; `count` is M, the number within the haze region at full opacity.

    They are isotropic, in the world, and have one display color. Each of the M is split into several fainter ones at
    independent positions that share its opacity, unless the settings fix the number or are the paper's. Those
    with a center under one of the `roofs` are left out.
    """
    shares = 1.0
    if rain.is_paper:
        positions, fade = _jumping(rain, count, time_s, anchor_to_world)
    else:
        if rain.haze_count is None:  # noise falls with the square root of their number
            shares = float(np.clip(np.sqrt(_SMOOTH_COUNT / max(count, 1)), 1, _MAX_SHARES))
        positions, fade = _fading(rain, count * shares, time_s, anchor_to_world)
    ramp = _smoothstep((np.linalg.norm(positions - camera_position, axis=1) - RAMP_M[0]) / (RAMP_M[1] - RAMP_M[0]))
    opacity = rain.haze_opacity / shares * fade * ramp
    means, opacities = positions[opacity > 0].astype(np.float32), opacity[opacity > 0].astype(np.float32)
    n, upright = len(means), np.array([1, 0, 0, 0], np.float32)
    sigmas = np.full((n, 3), rain.haze_sigma_m, np.float32)
    haze = Gaussians(means, sigmas, np.tile(upright, (n, 1)), opacities, sh_of(color, n))
    return haze if roofs is None else haze.take(np.flatnonzero(~roofs.shelter(means.astype(np.float64))))


def _fading(
    rain: RainSettings, count: float, time_s: float, anchor_to_world: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """World-fixed Gaussians on a lattice around the region: each lives at one position, then reappears elsewhere."""
    size = np.array(rain.haze_box.size_m) + 6 * rain.haze_sigma_m  # 3 sigma beyond each face
    horizontal = np.hypot(size[0], size[1])  # covers the region at any yaw
    period = np.array([horizontal, horizontal, size[2]])
    density = count / rain.haze_box.volume_m3 / _FADE_MEAN
    index = np.arange(round(density * np.prod(period)), dtype=np.uint32)
    phase = _hash(rain.seed, index, np.zeros_like(index))[3] * 2.0**-32
    age = time_s / LIFETIME_S + phase
    life = np.floor(age)
    birthplace = np.stack(_hash(rain.seed, index, (life.astype(np.int64) + 1).astype(np.uint32))[:3], axis=1) * 2.0**-32
    center = anchor_to_world[:3, :3] @ np.array(rain.haze_box.center_m) + anchor_to_world[:3, 3]
    # The copy of the lattice point that lies in the cell around the region's center.
    local = ((birthplace - center / period + 0.5) % 1.0 - 0.5) * period
    inside = np.all(np.abs(local @ anchor_to_world[:3, :3]) <= size / 2, axis=1)
    elapsed = (age - life)[inside] * LIFETIME_S
    fade = _smoothstep(elapsed / FADE_S) * _smoothstep((LIFETIME_S - elapsed) / FADE_S)
    return local[inside] + center, fade


def _jumping(
    rain: RainSettings, count: int, time_s: float, anchor_to_world: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """Positions drawn independently at every time (paper, Algorithm 1)."""
    size = np.array(rain.haze_box.size_m) + 6 * rain.haze_sigma_m
    index = np.arange(round(count * np.prod(size) / rain.haze_box.volume_m3), dtype=np.uint32)
    moment = np.full_like(index, round(time_s * 1e6) & 0xFFFFFFFF)
    fractions = np.stack(_hash(rain.seed, index, moment)[:3], axis=1) * 2.0**-32
    local = (fractions - 0.5) * size + rain.haze_box.center_m
    return local @ anchor_to_world[:3, :3].T + anchor_to_world[:3, 3], np.ones(len(local))


def _hash(
    seed: int, index: UInt32[np.ndarray, " n"], life: UInt32[np.ndarray, " n"]
) -> tuple[UInt32[np.ndarray, " n"], ...]:
    return pcg4d(index, life, np.full_like(index, _SALT), np.full_like(index, seed))


def _smoothstep(x: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)

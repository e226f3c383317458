"""The slow, readable rasterizer that the fast kernels are tested against: NumPy, float64, tiny images only."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64

from gsrain_engine.render.cpu.splats import TINT, TINT_SHARE
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import linear_to_srgb, matrices_from_quaternions, srgb_to_linear
from gsrain_engine.scene.scene import DrawItem

NEAR_M, DILATION_PX2, MAX_ALPHA, MIN_TRANSMITTANCE = 0.2, 0.3, 0.999, 1e-4
SCENE_ALPHA_CUT, RAIN_ALPHA_CUT = 1 / 255, 1 / 65536


class _Splat(NamedTuple):
    center: Float64[np.ndarray, "2"]
    covariance: Float64[np.ndarray, "2 2"]
    opacity: float
    cut: float
    color: Float64[np.ndarray, "3"]
    depth: float
    is_rain: bool


def rasterize_slowly(
    parts: Sequence[DrawItem], camera: Camera, rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None
) -> Float64[np.ndarray, "h w 5"]:
    """Render premultiplied color, alpha and alpha-weighted depth, as 3DGS defines them (Kerbl et al. 2023)."""
    return _blended(_nearest_first(parts, camera, rain), camera)


def rasterize_in_linear_light_slowly(
    parts: Sequence[DrawItem],
    camera: Camera,
    rain: Sequence[Bool[np.ndarray, " _"] | None],
    light_linear: Float[np.ndarray, "3"],
) -> Float64[np.ndarray, "h w 5"]:
    """Render as `rasterize_slowly` does, the rain adding its light in linear space; depth is the scene's own.

    enc(min(W_s / A, 1) dec(B) + W_r S) with B and A the clear scene's color and alpha, see `shares_slowly`.
    """
    splats = _nearest_first(parts, camera, rain)
    image = _blended([splat for splat in splats if not splat.is_rain], camera)
    rain_share, scene_share = np.moveaxis(shares_slowly(splats, camera), -1, 0)
    wet, alpha = rain_share > 0, image[..., 3]
    transmittance = np.where(alpha > 0, np.minimum(scene_share / np.maximum(alpha, 1e-30), 1), 1)[..., None]
    mixed = linear_to_srgb(transmittance * srgb_to_linear(image[..., :3]) + rain_share[..., None] * light_linear)
    image[wet, :3] = mixed[wet]
    image[wet, 3] = (rain_share + scene_share)[wet]
    return image


def shares_slowly(splats: Sequence[_Splat], camera: Camera) -> Float64[np.ndarray, "h w 2"]:
    """Weights of rain and scene composited together, nearest splat first, until the clear scene is opaque."""
    shape = (camera.height, camera.width)
    clear, together, is_open = np.ones(shape), np.ones(shape), np.ones(shape, bool)
    shares = np.zeros((*shape, 2))
    for splat in splats:
        alpha = _alpha(splat, camera)
        share = np.where(is_open, together * alpha, 0)
        shares[..., 0 if splat.is_rain else 1] += share
        together -= share
        if not splat.is_rain:
            clear *= 1 - alpha
            is_open &= clear >= MIN_TRANSMITTANCE
    return shares


def _nearest_first(
    parts: Sequence[DrawItem], camera: Camera, rain: Sequence[Bool[np.ndarray, " _"] | None] | None
) -> list[_Splat]:
    splats: list[_Splat] = []
    for index, part in enumerate(parts):
        flags = rain[index] if rain is not None else None
        left_out = part.left_out.flags if part.left_out is not None else np.zeros(len(part.gaussians), bool)
        for i in np.flatnonzero(~left_out[: part.drawn_count]).tolist():
            splat = _projected(part, i, camera, flags is not None and bool(flags[i]))
            if splat is not None:
                splats.append(splat)
    return sorted(splats, key=lambda splat: np.float32(splat.depth))


def _blended(splats: Sequence[_Splat], camera: Camera) -> Float64[np.ndarray, "h w 5"]:
    """Sum of the splats' values by their weights in each pixel, nearest splat first."""
    shape = (camera.height, camera.width)
    image, transmittance, is_open = np.zeros((*shape, 5)), np.ones(shape), np.ones(shape, bool)
    for splat in splats:
        alpha = _alpha(splat, camera)
        weight = np.where(is_open, transmittance * alpha, 0)
        image += weight[..., None] * np.array([*splat.color, 1.0, splat.depth])
        transmittance *= 1 - alpha
        is_open &= transmittance >= MIN_TRANSMITTANCE
    return image


def _alpha(splat: _Splat, camera: Camera) -> Float64[np.ndarray, "h w"]:
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    offset = np.stack([u, v], axis=-1) - splat.center
    power = -0.5 * np.einsum("...i,ij,...j", offset, np.linalg.inv(splat.covariance), offset)
    alpha = splat.opacity * np.exp(power)
    return np.where(alpha >= splat.cut, np.minimum(alpha, MAX_ALPHA), 0)


def _projected(part: DrawItem, i: int, camera: Camera, is_rain: bool) -> _Splat | None:
    g = part.gaussians
    numbers = [g.means[i], g.scales[i], g.quaternions[i], g.opacities[i], g.sh[i]]
    if part.is_wet and part.wet_sh is not None:
        numbers.append(part.wet_sh[i])
    if not all(np.isfinite(each).all() for each in numbers):
        return None
    object_to_camera = camera.world_to_camera @ part.to_world
    x, y, z = object_to_camera[:3, :3] @ g.means[i].astype(np.float64) + object_to_camera[:3, 3]
    if z <= NEAR_M:
        return None
    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    slope_x = np.clip(x / z, -camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    slope_y = np.clip(y / z, -camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    jacobian = np.array([[camera.fx / z, 0, -camera.fx * slope_x / z], [0, camera.fy / z, -camera.fy * slope_y / z]])
    axes = matrices_from_quaternions(g.quaternions[i].astype(np.float64)) * g.scales[i] * part.growth
    half = jacobian @ object_to_camera[:3, :3] @ axes
    covariance = half @ half.T + DILATION_PX2 * np.eye(2)
    opacity, cut = float(g.opacities[i]) * part.opacity, SCENE_ALPHA_CUT
    if is_rain:
        opacity *= float(np.sqrt(max(np.linalg.det(half @ half.T), 0) / np.linalg.det(covariance)))
        cut = RAIN_ALPHA_CUT
    center = np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    return _Splat(center, covariance, opacity, cut, _color(part, i, camera), float(z), is_rain)


def _color(part: DrawItem, i: int, camera: Camera) -> Float64[np.ndarray, "3"]:
    eye = np.linalg.inv(part.to_world) @ np.append(camera.position, 1)
    direction = part.gaussians.means[i] - eye[:3]
    sh = part.gaussians.sh[i].astype(np.float64)
    basis = sh_basis_slowly(direction / np.linalg.norm(direction))[: len(sh)]
    color = basis @ sh + 0.5
    if part.is_wet and part.wet_sh is not None:
        color = (1 - part.wetness) * color + part.wetness * (basis @ part.wet_sh[i].astype(np.float64) + 0.5)
    color = np.maximum(color if part.colors is None else part.colors @ np.append(color, 1), 0)
    is_selected = part.selected is not None and part.selected.flags[i]
    return (1 - TINT_SHARE) * color + TINT_SHARE * np.array(TINT) if is_selected else color


def sh_basis_slowly(direction: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 16"]:
    """Real spherical harmonics up to degree 3 in unit directions, signed as in 3DGS."""
    x, y, z = np.moveaxis(np.asarray(direction, np.float64), -1, 0)
    c1, c2 = np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi))
    c3a, c3b = np.sqrt(35 / (32 * np.pi)), np.sqrt(21 / (32 * np.pi))
    harmonics = [
        np.full_like(x, np.sqrt(1 / (4 * np.pi))),
        -c1 * y, c1 * z, -c1 * x,
        c2 * x * y, -c2 * y * z, np.sqrt(5 / (16 * np.pi)) * (3 * z * z - 1), -c2 * x * z, c2 / 2 * (x * x - y * y),
        -c3a * y * (3 * x * x - y * y), np.sqrt(105 / (4 * np.pi)) * x * y * z, -c3b * y * (5 * z * z - 1),
        np.sqrt(7 / (16 * np.pi)) * z * (5 * z * z - 3), -c3b * x * (5 * z * z - 1),
        np.sqrt(105 / (16 * np.pi)) * z * (x * x - y * y), -c3a * x * (x * x - 3 * y * y),
    ]  # fmt: skip
    return np.stack(harmonics, axis=-1)

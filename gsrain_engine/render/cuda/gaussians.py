"""Gaussians as torch tensors: uploaded once, transformed to the camera's frame for each frame."""

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from ...scene.camera import Camera
from ...scene.gaussians import Gaussians
from ...scene.geometry import quaternions_from_matrices
from ...scene.scene import DrawItem
from ..cpu.projection import TINT, TINT_SHARE, eye_in_object

torch: Any = import_module("torch")
Tensor = Any
"""torch is an optional dependency: this module is imported only if it is installed, and its types can't be named."""


class CameraSpace(NamedTuple):
    """Gaussians of all parts in the camera's frame (OpenCV axes, meters), in gsplat's layout."""

    means: Tensor
    """(n, 3)"""
    scales: Tensor
    """(n, 3)"""
    quaternions: Tensor
    """(n, 4) wxyz, unit."""
    opacities: Tensor
    """(n,)"""
    colors: Tensor
    """(n, 3) display color, never negative."""


class CudaArrays:
    """Uploads Gaussians on first use and finds them by identity."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._held: dict[int, tuple[object, tuple[Tensor, ...]]] = {}
        self._used: set[int] = set()

    def before_camera(self, parts: list[DrawItem], camera: Camera) -> CameraSpace:
        """Move the drawn Gaussians of each part to the camera's frame; evaluate harmonics in the part's own frame."""
        moved = [self._moved(part, camera) for part in parts]
        nothing = (self._uploaded(np.zeros(shape, np.float32)) for shape in ((0, 3), (0, 3), (0, 4), 0, (0, 3)))
        return CameraSpace(*(torch.cat(each) for each in zip(nothing, *moved, strict=True)))

    def release_unused(self) -> None:
        """Free every set that was not used since the last call."""
        self._held = {key: held for key, held in self._held.items() if key in self._used}
        self._used.clear()

    def _moved(self, part: DrawItem, camera: Camera) -> CameraSpace:
        object_to_camera = camera.world_to_camera @ part.to_world  # float64 for accuracy far from the origin
        scale = float(np.cbrt(np.linalg.det(object_to_camera[:3, :3])))
        turn = quaternions_from_matrices(object_to_camera[:3, :3] / scale)
        rows = _rows(part)
        means, scales, quaternions, opacities, sh = (each[rows] for each in self._arrays(part.gaussians))
        linear, shift = self._uploaded(object_to_camera[:3, :3].T), self._uploaded(object_to_camera[:3, 3])
        directions = means - self._uploaded(eye_in_object(camera, part))
        directions = directions / torch.linalg.norm(directions, dim=1, keepdim=True)
        basis = sh_basis(directions)[:, : sh.shape[1]]
        colors = torch.einsum("nk,nkc->nc", basis, sh) + 0.5
        if part.is_wet:
            soaked = torch.einsum("nk,nkc->nc", basis, self._wet(part.wet_sh)[rows]) + 0.5
            colors = (1 - part.wetness) * colors + part.wetness * soaked
            opacities = torch.where(torch.isfinite(colors).all(dim=1), opacities, 0)
            colors = torch.nan_to_num(colors)
        if part.colors is not None:
            colors = colors @ self._uploaded(part.colors[:, :3].T) + self._uploaded(part.colors[:, 3])
        colors = torch.clamp(colors, min=0)
        if part.selected is not None:
            tinted = torch.as_tensor(part.selected.flags, device=self._device)[rows][:, None]
            colors = torch.where(tinted, torch.lerp(colors, self._uploaded(np.array(TINT)), TINT_SHARE), colors)
        return CameraSpace(
            means @ linear + shift,
            scales * (scale * part.growth),
            quaternions @ self._uploaded(_product_matrix(turn)),
            opacities * part.opacity,
            colors,
        )

    def _arrays(self, gaussians: Gaussians) -> tuple[Tensor, ...]:
        key = id(gaussians)
        self._used.add(key)
        if key not in self._held:
            g = _without_what_is_not_finite(gaussians)
            arrays = tuple(self._uploaded(each) for each in (g.means, g.scales, g.quaternions, g.opacities, g.sh))
            self._held[key] = gaussians, arrays  # with a reference, so that the identity stays unique
        return self._held[key][1]

    def _wet(self, wet_sh: Any) -> Tensor:
        key = id(wet_sh)
        self._used.add(key)
        if key not in self._held:
            self._held[key] = wet_sh, (self._uploaded(wet_sh),)
        return self._held[key][1][0]

    def _uploaded(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values, np.float32), device=self._device)


def _rows(part: DrawItem) -> Any:
    """Drawn Gaussians of a part: a slice without a mask, or else their indices."""
    count = part.drawn_count if part.opacity > 0 else 0
    if part.left_out is None:
        return slice(0, count)
    indices = (~part.left_out).indices
    return torch.from_numpy(indices[indices < count])


def sh_basis(directions: Tensor) -> Tensor:
    """Real spherical harmonics up to degree 3 (n, 16) in unit directions (n, 3), with 3DGS signs."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        dim=1,
    )


def _product_matrix(turn: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4 4"]:
    """Matrix P with q @ P = turn * q, the product of quaternions."""
    w, x, y, z = turn
    return np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])


def _without_what_is_not_finite(gaussians: Gaussians) -> Gaussians:
    """Make Gaussians that contain NaN or infinity transparent, since gsplat doesn't check them."""
    g = gaussians
    rows = (g.means, g.scales, g.quaternions, g.opacities[:, None], g.sh.reshape(len(g), 3 * g.sh.shape[1]))
    bad = ~np.logical_and.reduce([np.isfinite(each).all(axis=1) for each in rows])
    if not bad.any():
        return g
    means, scales, quaternions, opacities, sh = (
        np.where(bad.reshape(-1, *[1] * (each.ndim - 1)), np.float32(0), each)
        for each in (g.means, g.scales, g.quaternions, g.opacities, g.sh)
    )
    quaternions[bad, 0] = 1
    return Gaussians(means, scales, quaternions, opacities, sh)

"""Differentiable rendering at its plainest: every Gaussian against every pixel. What the fast kernels answer to."""

from importlib import import_module
from typing import Any

from gsrain_engine.render.autodiff.differentiable import Tensor
from gsrain_engine.scene.camera import Camera

torch: Any = import_module("torch")

NEAR_M, DILATION_PX2, MAX_ALPHA, MIN_TRANSMITTANCE, ALPHA_CUT = 0.2, 0.3, 0.999, 1e-4, 1 / 255


def render_densely(
    means: Tensor,
    scales: Tensor,
    quaternions: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    world_to_camera: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Render as `differentiable.render_gaussians` does, in float64: color (h, w, 3), alpha and depth (h, w).

    Every value must be finite. Memory is n times the pixels: for tiny pictures.
    """
    means, scales, quaternions, opacities, colors = (
        each.double() for each in (means, scales, quaternions, opacities, colors)
    )
    pose = torch.as_tensor(camera.world_to_camera) if world_to_camera is None else world_to_camera.double()
    before_camera = means @ pose[:3, :3].T + pose[:3, 3]
    seen = before_camera[:, 2] > NEAR_M
    before_camera = torch.where(seen[:, None], before_camera, torch.ones_like(before_camera))
    centers, covariances = in_image(before_camera, scales, quaternions, pose, camera)
    alphas = alphas_of(centers, covariances, opacities, camera) * seen[:, None, None]
    channels = torch.cat(
        [display_colors(means, colors, pose), torch.ones_like(opacities)[:, None], before_camera[:, 2:]], dim=1
    )
    order = torch.argsort(before_camera[:, 2].detach().float(), stable=True)
    picture = torch.einsum("nhw,nc->hwc", weights_of(alphas[order]), channels[order])
    return picture[..., :3], picture[..., 3], picture[..., 4]


def in_image(
    before_camera: Tensor, scales: Tensor, quaternions: Tensor, pose: Tensor, camera: Camera
) -> tuple[Tensor, Tensor]:
    """Centres (n, 2) and 2D covariances (n, 2, 2) in px: EWA splatting (Zwicker et al. 2002)."""
    x, y, z = before_camera.unbind(1)
    c = camera
    low_x, high_x = -c.cx / c.fx - 0.15 * c.width / c.fx, (c.width - c.cx) / c.fx + 0.15 * c.width / c.fx
    low_y, high_y = -c.cy / c.fy - 0.15 * c.height / c.fy, (c.height - c.cy) / c.fy + 0.15 * c.height / c.fy
    slope_x, slope_y, zero = torch.clamp(x / z, low_x, high_x), torch.clamp(y / z, low_y, high_y), torch.zeros_like(z)
    jacobian = torch.stack([c.fx / z, zero, -c.fx * slope_x / z, zero, c.fy / z, -c.fy * slope_y / z], dim=1)
    half = jacobian.reshape(-1, 2, 3) @ pose[:3, :3] @ (_rotations(quaternions) * scales[:, None, :])
    covariances = half @ half.transpose(1, 2) + DILATION_PX2 * torch.eye(2, dtype=z.dtype)
    return torch.stack([c.fx * x / z + c.cx, c.fy * y / z + c.cy], dim=1), covariances


def _rotations(quaternions: Tensor) -> Tensor:
    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)


def alphas_of(centers: Tensor, covariances: Tensor, opacities: Tensor, camera: Camera) -> Tensor:
    """Alpha of each Gaussian (rows) in each pixel: (n, h, w)."""
    u = torch.arange(camera.width, dtype=centers.dtype) + 0.5
    v = torch.arange(camera.height, dtype=centers.dtype) + 0.5
    dx, dy = u[None, None, :] - centers[:, 0, None, None], v[None, :, None] - centers[:, 1, None, None]
    xx, xy, yy = (each[:, None, None] for each in (covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]))
    distance = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alphas = torch.clamp(opacities, max=1)[:, None, None] * torch.exp(-0.5 * distance)
    return torch.where(alphas >= ALPHA_CUT, torch.clamp(alphas, max=MAX_ALPHA), torch.zeros_like(alphas))


def weights_of(alphas: Tensor) -> Tensor:
    """Blending weights, nearest first, until transmittance has fallen below `MIN_TRANSMITTANCE`."""
    after = torch.cumprod(1 - alphas, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    return torch.where(before >= MIN_TRANSMITTANCE, before * alphas, torch.zeros_like(alphas))


def display_colors(means: Tensor, colors: Tensor, pose: Tensor) -> Tensor:
    """Display colors (n, 3) of harmonics seen from a pose, or of display colors themselves; never negative."""
    if colors.ndim == 2:
        return torch.clamp(colors, min=0)
    offsets = means + torch.linalg.solve(pose[:3, :3], pose[:3, 3])
    basis = sh_basis(offsets / offsets.norm(dim=1, keepdim=True))[:, : colors.shape[1]]
    return torch.clamp(torch.einsum("nk,nkc->nc", basis, colors) + 0.5, min=0)


def sh_basis(directions: Tensor) -> Tensor:
    """Real spherical harmonics up to degree 3 (n, 16) in unit directions (n, 3), with 3DGS signs."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    harmonics = [
        torch.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]  # fmt: skip
    return torch.stack(harmonics, dim=1)

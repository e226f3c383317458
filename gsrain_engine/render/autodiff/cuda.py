"""Differentiable rendering on an NVIDIA GPU with gsplat's kernels and gradients.

gsplat (Ye et al. 2025) ends a pixel before the splat that would leave less than 1e-4, our renderers after it; all other
conventions are the same.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from ...scene.camera import Camera
from ..cpu.projection import DILATION_PX2, NEAR_M
from .types import Footprint, Rendered, Tensor

torch: Any = import_module("torch")
_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}


def render_with_gsplat(
    means: Tensor,
    scales: Tensor,
    quaternions: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    world_to_camera: Tensor | None,
    rasterize: Callable[..., tuple[Tensor, Tensor, dict[str, Any]]] | None = None,
) -> Rendered:
    """Render the arguments of `differentiable.render_gaussians`.

    Args:
        means: Like the following, as in `render_gaussians`; float32 on one device.
        scales: As there.
        quaternions: As there.
        opacities: As there.
        colors: As there.
        camera: As there.
        world_to_camera: As there.
        rasterize: `gsplat.rasterization`, or a function with the same signature; None imports gsplat.

    Raises:
        ValueError: For float64, or if gsplat is not installed.
    """
    if means.dtype != torch.float32:
        raise ValueError(f"the cuda backend renders float32, got {means.dtype}; backend='cpu' renders both")
    rasterize = rasterize or _gsplat()
    if not len(means):  # gsplat rejects an empty scene
        return _nothing(means, camera)
    values = _without_what_is_not_finite([means, scales, quaternions, opacities, colors])
    means, scales, quaternions, opacities, colors = values
    pose = torch.as_tensor(camera.world_to_camera) if world_to_camera is None else world_to_camera
    has_harmonics = colors.ndim == 3
    intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    images, alphas, found = rasterize(
        means=means,
        quats=quaternions,
        scales=scales,
        opacities=torch.clamp(opacities, max=1),
        colors=colors if has_harmonics else torch.clamp(colors, min=0),
        viewmats=pose.to(means)[None],
        Ks=torch.tensor(intrinsics, device=means.device)[None],
        width=camera.width,
        height=camera.height,
        near_plane=NEAR_M,
        eps2d=DILATION_PX2,
        sh_degree=_DEGREES[colors.shape[1]] if has_harmonics else None,
        packed=False,
        render_mode="RGB+D",
    )
    centers = found["means2d"]
    if centers.requires_grad:
        centers.retain_grad()
    return Rendered(images[0, ..., :3], alphas[0, ..., 0], images[0, ..., 3], Footprint(_radii(found), centers))


def _gsplat() -> Callable[..., tuple[Tensor, Tensor, dict[str, Any]]]:
    try:
        return import_module("gsplat").rasterization
    except ImportError:
        raise ValueError("the cuda backend needs gsplat: pip install 'gsrain[cuda]'") from None


def _nothing(means: Tensor, camera: Camera) -> Rendered:
    blank = means.sum() + means.new_zeros((camera.height, camera.width))  # an empty sum keeps the graph connected
    footprint = Footprint(means.new_zeros(0))
    footprint.gradients = means.new_zeros(0)
    return Rendered(blank[..., None].expand(-1, -1, 3), blank, blank, footprint)


def _radii(found: dict[str, Any]) -> Tensor:
    """Three standard deviations of each splat's longer axis in px from gsplat's conics; 0 where not drawn."""
    a, b, c = found["conics"].detach()[0].unbind(-1)
    drawn = (found["radii"][0].reshape(len(a), -1) > 0).all(dim=1)
    largest = (a + c) / 2 + torch.hypot((a - c) / 2, b)
    least = torch.where(drawn, (a * c - b * b) / largest, torch.ones_like(a))
    return torch.where(drawn, 3 / torch.sqrt(least), torch.zeros_like(a))


def _without_what_is_not_finite(values: list[Tensor]) -> list[Tensor]:
    """Make Gaussians with NaN or infinity transparent and detach them, since gsplat doesn't check them."""
    good = torch.stack([torch.isfinite(each.detach()).reshape(len(each), -1).all(dim=1) for each in values]).all(dim=0)
    good = good & (values[2].detach().norm(dim=1) > 0)
    if bool(good.all()):
        return values
    means, scales, quaternions, opacities, colors = (
        torch.where(good.reshape(-1, *[1] * (each.ndim - 1)), each, torch.zeros_like(each)) for each in values
    )
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=means.device)
    return [means, scales, torch.where(good[:, None], quaternions, upright), opacities, colors]

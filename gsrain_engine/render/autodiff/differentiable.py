"""Differentiable rendering of Gaussians, with gradients for all of them and for the camera's pose.

The CPU runs our own kernels; an NVIDIA GPU runs those of gsplat (Ye et al. 2025), which ends a pixel before the splat
that would leave less than 1e-4, our renderers after it; all other conventions are the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float64

from ...scene.camera import Camera
from ..cpu.compositing import color_operator_transpose
from ..cpu.projection import nearest_first
from ..cpu.tiles import bin_into_tiles
from ..cuda import uploaded, view_arguments
from .blend import BlendedImage, blend, blend_backward
from .project import TrainedGaussians, project_backward, project_trained, sh_backward

torch: Any = import_module("torch")
Tensor = Any  # torch is an optional dependency: its types can't be named
Backend = Literal["auto", "cpu", "cuda"]
_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}


class Footprint:
    """Size of Gaussians in one image, and after the backward pass the loss gradients of their positions in it.

    Density control uses it (Kerbl et al. 2023).
    """

    def __init__(self, radii_px: Tensor, centers: Tensor | None = None) -> None:
        self.radii_px = radii_px
        """(n,) three standard deviations of the longer axis in px; 0 where not drawn."""
        self.gradients: Tensor | None = None
        """(n,) set by the backward pass."""
        self._centers = centers

    @property
    def drawn(self) -> Tensor:
        """(n,) bool: Gaussians drawn in the image."""
        return self.radii_px > 0

    @property
    def screen_gradients(self) -> Tensor:
        """(n,) length of the loss's gradient by each center in the image, per px; 0 where not drawn.

        Raises `RuntimeError` before a backward pass, or when only colors needed gradients.
        """
        if self.gradients is not None:
            return self.gradients
        if self._centers is None or self._centers.grad is None:
            raise RuntimeError("screen gradients exist after a backward pass through means, scales or a pose only")
        return self._centers.grad.reshape(-1, 2).norm(dim=1)


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """Image, alpha and depth with gradients."""

    color: Tensor  # (h, w, 3) display color, premultiplied over nothing
    alpha: Tensor  # (h, w)
    depth: Tensor  # (h, w) sum of view depth (m) by weight: expected depth is depth / alpha
    footprint: Footprint


def render_gaussians(
    means: Tensor,
    scales: Tensor,
    quaternions: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    *,
    world_to_camera: Tensor | None = None,
    backend: Backend = "auto",
) -> Rendered:
    """Render Gaussians with gradients for every argument that is a tensor.

    Conventions are the renderers': 0.3 px^2 of dilation, alpha cut at 1/255 and at most 0.999, a pixel ends at a
    transmittance of 1e-4, near plane at 0.2 m, colors never negative. Gaussians that are not finite are left out and
    get zero gradients. On the CPU, image and gradients are byte-identical at any number of threads.

    Args:
        means: (n, 3) world, meters.
        scales: (n, 3) standard deviations in meters.
        quaternions: (n, 4) wxyz, of any length above 0.
        opacities: (n,) within 0..1.
        colors: (n, k, 3) spherical harmonics as in `Gaussians.sh` with k = 1, 4, 9 or 16, or (n, 3) display colors.
        camera: Camera in the world.
        world_to_camera: (4, 4) replaces the camera's own pose and receives gradients.
        backend: "cpu" (Numba kernels; float32 or float64), "cuda" (gsplat; float32), "auto": by the tensors' device.

    Raises:
        ValueError: For inconsistent shapes, precisions or devices; the message names the tensor.
    """
    check_tensors(means, scales, quaternions, opacities, colors, world_to_camera)
    if backend != "auto" and (backend == "cuda") != bool(means.is_cuda):
        raise ValueError(f"backend {backend!r} can't take tensors on {means.device}")
    if means.is_cuda:
        return render_with_gsplat(means, scales, quaternions, opacities, colors, camera, world_to_camera)
    pose = torch.as_tensor(camera.world_to_camera) if world_to_camera is None else world_to_camera
    footprint = Footprint(torch.empty(0))
    color, alpha, depth = _Render.apply(means, scales, quaternions, opacities, colors, pose, camera, footprint)
    return Rendered(color, alpha, depth, footprint)


def check_tensors(
    means: Tensor, scales: Tensor, quaternions: Tensor, opacities: Tensor, colors: Tensor, pose: Tensor | None
) -> None:
    """Raise `ValueError` for the first tensor with an invalid shape, precision or device."""
    if means.ndim != 2 or means.shape[1] != 3:
        raise ValueError(f"means have shape {tuple(means.shape)}, expected (n, 3)")
    n = len(means)
    others = {"scales": scales, "quaternions": quaternions, "opacities": opacities}
    for (name, tensor), shape in zip(others.items(), ((n, 3), (n, 4), (n,)), strict=True):
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} have shape {tuple(tensor.shape)}, expected {shape} as there are {n} means")
    shape = tuple(colors.shape)
    if shape != (n, 3) and not (len(shape) == 3 and shape[0] == n and shape[1] in _DEGREES and shape[2] == 3):
        raise ValueError(
            f"colors have shape {shape}, expected ({n}, 3) or ({n}, k, 3) with k = 1, 4, 9 or 16 as there are {n} means"
        )
    if pose is not None and tuple(pose.shape) != (4, 4):
        raise ValueError(f"world_to_camera has shape {tuple(pose.shape)}, expected (4, 4)")
    if str(means.dtype) not in ("torch.float32", "torch.float64"):
        raise ValueError(f"means are {means.dtype}, expected torch.float32 or torch.float64")
    for name, tensor in {**others, "colors": colors, "world_to_camera": pose}.items():
        if tensor is not None and tensor.dtype != means.dtype:
            raise ValueError(f"{name} are {tensor.dtype}, expected {means.dtype} as the means are")
        if tensor is not None and tensor.device != means.device:
            raise ValueError(f"{name} are on {tensor.device}, expected {means.device} where the means are")


# On the CPU


class _Render(torch.autograd.Function):
    """Runs the compiled kernels on the tensors' own memory."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, Tensor, Tensor]:
        means, scales, quaternions, opacities, colors, pose, camera, footprint = inputs
        gaussians = _gaussians(means, scales, quaternions, opacities, colors)
        splats = project_trained(gaussians, camera, _matrix(pose))
        # Depths are compared in float32, as in all our renderers.
        order, shapes = nearest_first(splats.channels[:, 3]), splats.shapes
        if shapes.dtype != np.float32:
            shapes = np.zeros(shapes.shape, np.float32)
            shapes[order] = splats.shapes[order]
        tiles = bin_into_tiles(shapes, order, camera.width, camera.height)
        outputs = tuple(torch.from_numpy(each) for each in blend(splats.shapes, splats.channels, tiles))
        footprint.radii_px = torch.from_numpy(splats.radii_px)
        ctx.save_for_backward(means, scales, quaternions, opacities, colors, pose, *outputs)
        ctx.inputs = splats, tiles, camera, footprint
        ctx.set_materialize_grads(False)
        return outputs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        means, scales, quaternions, opacities, colors, pose, *outputs = ctx.saved_tensors
        splats, tiles, camera, footprint = ctx.inputs
        gaussians, matrix = _gaussians(means, scales, quaternions, opacities, colors), _matrix(pose)
        if all(each is None for each in gradients):
            return (None,) * 8
        picture = BlendedImage(*map(_array, outputs))
        gradient = BlendedImage(
            *(np.zeros_like(output) if each is None else _array(each)
              for each, output in zip(gradients, picture, strict=True))
        )  # fmt: skip
        if not any(ctx.needs_input_grad[i] for i in (0, 1, 2, 3, 5)):
            sums = color_operator_transpose(splats.shapes, gradient.color, tiles, with_squares=False)
            by_harmonics = sh_backward(gaussians, splats, sums, matrix)
            return None, None, None, None, torch.from_numpy(by_harmonics[colors.ndim == 2]), None, None, None
        sums = blend_backward(splats.shapes, splats.channels, tiles, picture, gradient)
        found, on_screen, by_pose = project_backward(gaussians, splats, sums, camera, matrix)
        footprint.gradients = torch.from_numpy(on_screen)
        by_colors = found.display if colors.ndim == 2 else found.colors
        arrays = (found.means, found.scales, found.quaternions, found.opacities, by_colors)
        by_pose = torch.from_numpy(by_pose).to(pose.dtype) if ctx.needs_input_grad[5] else None
        return (*map(torch.from_numpy, arrays), by_pose, None, None)


def _gaussians(
    means: Tensor, scales: Tensor, quaternions: Tensor, opacities: Tensor, colors: Tensor
) -> TrainedGaussians:
    values = _array(colors)
    display = values if values.ndim == 2 else np.zeros((0, 3), values.dtype)
    harmonics = values if values.ndim == 3 else np.zeros((len(values), 0, 3), values.dtype)
    return TrainedGaussians(_array(means), _array(scales), _array(quaternions), _array(opacities), harmonics, display)


def _array(tensor: Tensor) -> Float[np.ndarray, "..."]:
    return tensor.detach().contiguous().numpy()


def _matrix(pose: Tensor) -> Float64[np.ndarray, "4 4"]:
    return np.ascontiguousarray(pose.detach().numpy(), np.float64)


# On an NVIDIA GPU


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
    """Render the arguments of `render_gaussians` in float32 on one device, without waiting for it.

    `rasterize` is `gsplat.rasterization`, or a function with the same signature; None imports gsplat. Raises
    `ValueError` for float64, or if gsplat is not installed.
    """
    if means.dtype != torch.float32:
        raise ValueError(f"the cuda backend renders float32, got {means.dtype}; backend='cpu' renders both")
    kernel: Any = rasterize
    if kernel is None:
        try:
            kernel = import_module("gsplat").rasterization
        except ImportError:
            raise ValueError("the cuda backend needs gsplat: pip install 'gsrain[cuda]'") from None
    if not len(means):  # gsplat rejects an empty scene
        blank = means.sum() + means.new_zeros((camera.height, camera.width))  # an empty sum keeps the graph connected
        footprint = Footprint(means.new_zeros(0))
        footprint.gradients = means.new_zeros(0)
        return Rendered(blank[..., None].expand(-1, -1, 3), blank, blank, footprint)
    values = _without_what_is_not_finite([means, scales, quaternions, opacities, colors])
    means, scales, quaternions, opacities, colors = values
    pose = world_to_camera
    if pose is None:
        pose = uploaded(camera.world_to_camera.astype(np.float32), means.device)
    has_harmonics = colors.ndim == 3
    images, alphas, found = kernel(
        means=means, quats=quaternions, scales=scales, opacities=torch.clamp(opacities, max=1),
        colors=colors if has_harmonics else torch.clamp(colors, min=0),
        sh_degree=_DEGREES[colors.shape[1]] if has_harmonics else None,
        viewmats=pose[None], packed=False, render_mode="RGB+D", **view_arguments(camera, means.device),
    )  # fmt: skip
    centers = found["means2d"]
    if centers.requires_grad:
        centers.retain_grad()
    return Rendered(images[0, ..., :3], alphas[0, ..., 0], images[0, ..., 3], Footprint(_radii(found), centers))


def _radii(found: dict[str, Any]) -> Tensor:
    """Three standard deviations of each splat's longer axis in px from gsplat's conics; 0 where not drawn."""
    a, b, c = found["conics"].detach()[0].unbind(-1)
    drawn = (found["radii"][0].reshape(len(a), -1) > 0).all(dim=1)
    largest = (a + c) / 2 + torch.hypot((a - c) / 2, b)
    smallest = torch.where(drawn, (a * c - b * b) / largest, 1.0)
    return torch.where(drawn, 3 / torch.sqrt(smallest), 0.0)


def _without_what_is_not_finite(values: list[Tensor]) -> list[Tensor]:
    """Make Gaussians with NaN or infinity transparent and detach them, since gsplat doesn't check them.

    All are selected, even if none is bad: a condition on the result would wait for the device.
    """
    flat = [each.detach().reshape(len(each), -1) for each in values]
    largest = torch.stack([torch.linalg.vector_norm(each, torch.inf, dim=1) for each in flat], dim=1)  # NaN stays NaN
    good = torch.isfinite(largest).all(dim=1) & (flat[2].norm(dim=1) > 0)
    unit = torch.eye(1, 4, dtype=flat[2].dtype, device=flat[2].device)
    replaced = [0.0, 0.0, unit, 0.0, 0.0]
    return [
        torch.where(good.reshape(-1, *[1] * (each.ndim - 1)), each, other)
        for each, other in zip(values, replaced, strict=True)
    ]

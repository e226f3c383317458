"""Differentiable rendering of Gaussians, with gradients for all of them and for the camera's pose."""

from importlib import import_module
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float64

from ...scene.camera import Camera
from ..cpu.projection import nearest_first
from ..cpu.tiles import TileLists, bin_into_tiles
from .blend import BlendedImage, blend, blend_backward, blend_colors_backward
from .cuda import render_with_gsplat
from .project import TrainedGaussians, TrainedSplats, project_backward, project_trained, sh_backward
from .types import Footprint, Rendered, Tensor, check_tensors

torch: Any = import_module("torch")
Backend = Literal["auto", "cpu", "cuda"]


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


class _Render(torch.autograd.Function):
    """Runs the compiled kernels on the tensors' own memory."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        scales: Tensor,
        quaternions: Tensor,
        opacities: Tensor,
        colors: Tensor,
        pose: Tensor,
        camera: Camera,
        footprint: Footprint,
    ) -> tuple[Tensor, Tensor, Tensor]:
        gaussians = _gaussians(means, scales, quaternions, opacities, colors)
        splats = project_trained(gaussians, camera, _matrix(pose))
        tiles = _tiles(splats, camera)
        outputs = tuple(torch.from_numpy(each) for each in blend(splats.shapes, splats.channels, tiles))
        footprint.radii_px = torch.from_numpy(splats.radii_px)
        ctx.save_for_backward(means, scales, quaternions, opacities, colors, pose, *outputs)
        ctx.kept = splats, tiles, camera, footprint
        ctx.set_materialize_grads(False)
        return outputs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        means, scales, quaternions, opacities, colors, pose, *outputs = ctx.saved_tensors
        splats, tiles, camera, footprint = ctx.kept
        gaussians = _gaussians(means, scales, quaternions, opacities, colors)
        if all(each is None for each in gradients):
            return (None,) * 8
        color, alpha, depth = (
            np.zeros(tuple(output.shape), splats.shapes.dtype) if each is None else _array(each)
            for each, output in zip(gradients, outputs, strict=True)
        )
        if not any(ctx.needs_input_grad[i] for i in (0, 1, 2, 3, 5)):
            sums = blend_colors_backward(splats.shapes, tiles, color)
            by_harmonics = sh_backward(gaussians, splats, sums, _matrix(pose))
            return None, None, None, None, torch.from_numpy(by_harmonics[colors.ndim == 2]), None, None, None
        picture = BlendedImage(*map(_array, outputs))
        sums = blend_backward(splats.shapes, splats.channels, tiles, picture, BlendedImage(color, alpha, depth))
        found, by_pose = project_backward(gaussians, splats, sums, camera, _matrix(pose))
        footprint.gradients = torch.from_numpy(found.on_screen)
        geometry = (found.means, found.scales, found.quaternions, found.opacities)
        by_colors = found.display if colors.ndim == 2 else found.colors
        return (
            *(torch.from_numpy(each) for each in (*geometry, by_colors)),
            torch.from_numpy(by_pose).to(pose.dtype) if ctx.needs_input_grad[5] else None,
            None,
            None,
        )


def _tiles(splats: TrainedSplats, camera: Camera) -> TileLists:
    """Lists of splats by tile, nearest first; depths are compared in float32, as in all our renderers."""
    order, shapes = nearest_first(splats.channels[:, 3]), splats.shapes
    if shapes.dtype != np.float32:
        shapes = np.zeros(shapes.shape, np.float32)
        shapes[order] = splats.shapes[order]
    return bin_into_tiles(shapes, order, camera.width, camera.height)


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

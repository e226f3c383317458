"""Differentiable rendering of Gaussians, with gradients for all of them and for the camera's pose.

The CPU runs our own kernels; an NVIDIA GPU runs those of gsplat (Ye et al. 2025), which ends a pixel before the splat
that would leave less than 1e-4, our renderers after it; all other conventions are the same.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float64

from ...optional_packages import import_package
from ...scene.camera import Camera
from ..cpu.compositing import color_operator_transpose
from ..cpu.splats import nearest_first
from ..cpu.tiles import bin_into_tiles
from ..gsplat_input import uploaded, view_arguments
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

    def __init__(self, radii_px: Tensor) -> None:
        self._radii_px = radii_px
        self.gradients: Tensor | None = None
        """(n,) set by the backward pass."""

    @cached_property
    def radii_px(self) -> Tensor:
        """(n,) three standard deviations of the longer axis in px; 0 where not drawn."""
        return self._radii_px

    @cached_property
    def drawn(self) -> Tensor:
        """(n,) bool: Gaussians drawn in the image."""
        return self.radii_px > 0

    @property
    def screen_gradients(self) -> Tensor:
        """(n,) length of the loss's gradient by each center in the image, per px; 0 where not drawn.

        Raises `RuntimeError` before a backward pass, or when only colors needed gradients.
        """
        if self.gradients is None:
            raise RuntimeError("screen gradients exist after a backward pass through means, scales or a pose only")
        return self.gradients


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
        footprint._radii_px = torch.from_numpy(splats.radii_px)
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
    gsplat: Any = None,
) -> Rendered:
    """Render the arguments of `render_gaussians` in float32 on one device, without waiting for it.

    `gsplat` is the library, or a module with its `rasterization` and `spherical_harmonics`; None imports it. Raises
    `ValueError` for float64, or if gsplat is not installed.
    """
    if means.dtype != torch.float32:
        raise ValueError(f"the cuda backend renders float32, got {means.dtype}; backend='cpu' renders both")
    if gsplat is None:
        gsplat = import_package("gsplat", "the cuda backend")
    if not len(means):  # gsplat rejects an empty scene
        blank = means.sum() + means.new_zeros((camera.height, camera.width))  # an empty sum keeps the graph connected
        footprint = Footprint(means.new_zeros(0))
        footprint.gradients = means.new_zeros(0)
        return Rendered(blank[..., None].expand(-1, -1, 3), blank, blank, footprint)
    pose, eye, arguments = _uploaded_view(camera, means.device)
    if world_to_camera is not None:
        pose = world_to_camera[None]
        eye = -torch.linalg.inv_ex(world_to_camera[:3, :3]).inverse @ world_to_camera[:3, 3]
    sound = _sound(means, scales, quaternions, opacities, colors)
    if colors.ndim == 3:
        # gsplat would invert the pose for the directions, and wait for the result of a check.
        degree = _DEGREES[colors.shape[1]]
        directions = means - eye if degree else means.detach()
        colors = gsplat.spherical_harmonics(degree, directions, colors, masks=sound) + 0.5
    images, alphas, found = gsplat.rasterization(
        means=means, quats=quaternions, scales=scales, opacities=torch.where(sound, opacities, _nothing(means.device)),
        colors=torch.relu(colors), viewmats=pose, packed=False, render_mode="RGB+D", **arguments,
    )  # fmt: skip
    if found["means2d"].requires_grad:
        found["means2d"].retain_grad()
    color, depth = images.squeeze(0).split((3, 1), dim=-1)
    return Rendered(color, alphas.view(alphas.shape[1:3]), depth.squeeze(-1), _GsplatFootprint(found))


@lru_cache(maxsize=1024)
def _uploaded_view(camera: Camera, device: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Pose (1, 4, 4) and position (3,) of a camera, and gsplat's other arguments: uploaded at a camera's first use."""
    pose = uploaded(camera.world_to_camera[None].astype(np.float32), device)
    return pose, uploaded(camera.position.astype(np.float32), device), view_arguments(camera, device)


@lru_cache(maxsize=8)
def _nothing(device: Any) -> Tensor:
    """() 0: a number of Python would be uploaded at each use in `torch.where`."""
    return torch.zeros((), dtype=torch.float32, device=device)


def _sound(*values: Tensor) -> Tensor:
    """(n,) bool: Gaussians with finite numbers and a quaternion above 0. gsplat doesn't check them.

    The others become transparent, which it leaves out before anything else, with gradients of 0. All are selected, even
    if none is bad: a condition on the result would wait for the device.
    """
    with torch.no_grad():
        turns = torch.linalg.vector_norm(values[2], dim=1, keepdim=True).reciprocal_()
        columns = torch.cat([*(each.reshape(len(turns), -1) for each in values), turns], dim=1)
        return torch.linalg.vector_norm(columns, torch.inf, dim=1) < torch.inf  # not below infinity: NaN stays NaN


class _GsplatFootprint(Footprint):
    """Footprint from gsplat's results, computed when it is asked for."""

    def __init__(self, found: dict[str, Any]) -> None:
        super().__init__(found["radii"])
        self._centers, self._conics = found["means2d"], found["conics"].detach()

    @cached_property
    def drawn(self) -> Tensor:
        count = self._conics.shape[1]
        return self._radii_px.view(count, -1)[:, 0] > 0  # along both axes, or neither

    @cached_property
    def radii_px(self) -> Tensor:
        a, b, c = self._conics[0].unbind(-1)
        double = torch.hypot(a - c, b + b).add_(a).add_(c)  # twice the larger eigenvalue of a conic
        variances = double.div_(torch.addcmul(a * c, b, b, value=-1))  # twice that of the covariance
        return torch.where(self.drawn, variances.sqrt_().mul_(4.5**0.5), _nothing(a.device))

    @property
    def screen_gradients(self) -> Tensor:
        if self._centers.grad is None:
            return super().screen_gradients
        return torch.linalg.vector_norm(self._centers.grad[0], dim=1)

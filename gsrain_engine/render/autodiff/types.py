"""Results of differentiable rendering and checks of its arguments."""

from dataclasses import dataclass
from typing import Any

Tensor = Any
"""torch is an optional dependency: its types can't be named."""


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

        Raises:
            RuntimeError: Before a backward pass, or when only colors needed gradients.
        """
        if self.gradients is not None:
            return self.gradients
        if self._centers is None or self._centers.grad is None:
            raise RuntimeError("screen gradients exist after a backward pass through means, scales or a pose only")
        return self._centers.grad.reshape(-1, 2).norm(dim=1)


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """Image, alpha and depth with gradients."""

    color: Tensor
    """(h, w, 3) display color, premultiplied over nothing."""
    alpha: Tensor
    """(h, w)"""
    depth: Tensor
    """(h, w) sum of view depth (m) by weight: expected depth is depth / alpha."""
    footprint: Footprint


# Argument checks

_HARMONICS = (1, 4, 9, 16)


def check_tensors(
    means: Tensor, scales: Tensor, quaternions: Tensor, opacities: Tensor, colors: Tensor, pose: Tensor | None
) -> None:
    """Raise `ValueError` for the first tensor with an invalid shape, precision or device."""
    if means.ndim != 2 or means.shape[1] != 3:
        raise ValueError(f"means have shape {tuple(means.shape)}, expected (n, 3)")
    n = len(means)
    for name, tensor, shape in (
        ("scales", scales, (n, 3)), ("quaternions", quaternions, (n, 4)), ("opacities", opacities, (n,)),
    ):  # fmt: skip
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} have shape {tuple(tensor.shape)}, expected {shape} as there are {n} means")
    shape = tuple(colors.shape)
    if shape != (n, 3) and not (len(shape) == 3 and shape[0] == n and shape[1] in _HARMONICS and shape[2] == 3):
        raise ValueError(
            f"colors have shape {shape}, expected ({n}, 3) or ({n}, k, 3) with k = 1, 4, 9 or 16 as there are {n} means"
        )
    if pose is not None and tuple(pose.shape) != (4, 4):
        raise ValueError(f"world_to_camera has shape {tuple(pose.shape)}, expected (4, 4)")
    _check_kinds(means, {
        "scales": scales, "quaternions": quaternions, "opacities": opacities, "colors": colors,
        "world_to_camera": pose,
    })  # fmt: skip


def _check_kinds(means: Tensor, others: dict[str, Any]) -> None:
    if str(means.dtype) not in ("torch.float32", "torch.float64"):
        raise ValueError(f"means are {means.dtype}, expected torch.float32 or torch.float64")
    for name, tensor in others.items():
        if tensor is not None and tensor.dtype != means.dtype:
            raise ValueError(f"{name} are {tensor.dtype}, expected {means.dtype} as the means are")
        if tensor is not None and tensor.device != means.device:
            raise ValueError(f"{name} are on {tensor.device}, expected {means.device} where the means are")

"""What training makes small: absolute difference and structural dissimilarity of a render and the truth."""

from importlib import import_module
from typing import Any

import cv2
import numpy as np

from gsrain_engine.evaluate.image_metrics import C1, C2, HALF_WINDOW_PX, LEAST_WEIGHT, WINDOW_PX, check_pair, window

torch: Any = import_module("torch")

Tensor = Any


def l1(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Mean absolute difference of two (h, w, 3) tensors over the pixels of a bool mask (h, w); 0 where it has none."""
    check_pair(tuple(rendered.shape), tuple(truth.shape), None if mask is None else tuple(mask.shape))
    difference = (rendered - truth).abs()
    if mask is None:
        return difference.mean()
    return (difference * mask[..., None]).sum() / (3 * mask.sum()).clamp_min(1)


def d_ssim(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Return 1 - SSIM of two (h, w, 3) tensors of values 0..1 over the pixels of a bool mask (h, w).

    The same SSIM as `gsrain_engine.evaluate.image_metrics.ssim`: windows inside the picture, masked pixels without
    weight. The term of 3DGS's loss (Kerbl et al. 2023, eq. 7). 0 where the mask has no pixel. Differentiable in
    `rendered` and `truth`. Raises ValueError for other shapes and for pictures smaller than the window (11 px).
    """
    check_pair(tuple(rendered.shape), tuple(truth.shape), None if mask is None else tuple(mask.shape))
    if min(rendered.shape[:2]) < WINDOW_PX:
        raise ValueError(f"SSIM takes pictures of at least {WINDOW_PX} px a side, not {tuple(rendered.shape[:2])}")
    if mask is None:
        return 1 - _similarity(_means(rendered, truth, None)).mean()
    weights = mask[..., None].to(rendered.dtype)
    inside = mask[HALF_WINDOW_PX:-HALF_WINDOW_PX, HALF_WINDOW_PX:-HALF_WINDOW_PX, None]
    similarity = _similarity(_means(rendered, truth, weights))
    return ((1 - similarity) * inside).sum() / (3 * inside.sum()).clamp_min(1)


def _means(x: Tensor, y: Tensor, weights: Tensor | None) -> tuple[Tensor, ...]:
    values = torch.cat([x, y, x * x + y * y, x * y], dim=2)
    if weights is None:
        return _blurred(values).split(3, dim=2)
    return (_blurred(values * weights) / _blurred(weights).clamp_min(LEAST_WEIGHT)).split(3, dim=2)


def _similarity(means: tuple[Tensor, ...]) -> Tensor:
    # Only the sum of both variances is needed: a window less to filter.
    x, y, squares, product = means
    both, crossed = x * x + y * y, x * y
    return (2 * crossed + C1) * (2 * (product - crossed) + C2) / ((both + C1) * (squares - both + C2))


def _blurred(values: Tensor) -> Tensor:
    if values.device.type == "cpu":
        return _CpuBlur.apply(values)
    taps = torch.as_tensor(window(), dtype=values.dtype, device=values.device)
    planes = values.permute(2, 0, 1)[:, None]
    rows = torch.nn.functional.conv2d(planes, taps.view(1, 1, -1, 1))
    return torch.nn.functional.conv2d(rows, taps.view(1, 1, 1, -1))[:, 0].permute(1, 2, 0)


class _CpuBlur(torch.autograd.Function):
    """Gaussian window means by OpenCV, several times as fast as torch's convolution of single channels."""

    @staticmethod
    def forward(context: Any, values: Tensor) -> Tensor:
        blurred = _filtered(values.detach().numpy())
        inner = blurred[HALF_WINDOW_PX:-HALF_WINDOW_PX, HALF_WINDOW_PX:-HALF_WINDOW_PX]
        return torch.from_numpy(np.ascontiguousarray(inner))

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> Tensor:
        edge = HALF_WINDOW_PX
        # The window is symmetric: filtering is its own transpose, and leaving the edge out is transposed to zeros.
        return torch.from_numpy(_filtered(np.pad(gradient.numpy(), ((edge, edge), (edge, edge), (0, 0)))))


def _filtered(values: np.ndarray) -> np.ndarray:
    taps = window().astype(values.dtype)
    return cv2.sepFilter2D(values, -1, taps, taps, borderType=cv2.BORDER_CONSTANT).reshape(values.shape)

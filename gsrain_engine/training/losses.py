"""Losses of a render against its target, with gradients by formulas: L1, D-SSIM, depth and cover, and robust masks.

Autograd would start several small kernels for each operation and for its gradient, which takes a GPU's processor longer
than the GPU. Here a loss and its gradients are computed together, and share their intermediate results.
"""

from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any, NamedTuple

import cv2
import numpy as np

from ..evaluation.image_metrics import C1, C2, HALF_WINDOW_PX, MIN_WEIGHT, WINDOW_PX, check_pair, window
from ..render.gsplat_input import uploaded
from .model import TrainingRender
from .settings import TrainingSettings
from .targets import TrainingTarget

torch: Any = import_module("torch")
Tensor = Any

_MIN_ALPHA = 0.05  # alpha below which depth is undefined


class ViewLoss(NamedTuple):
    """Loss of one view."""

    value: Tensor
    """() on the device."""
    gradients: Sequence[tuple[Tensor, Tensor]]
    """Each tensor that the loss depends on, and its gradient."""

    def backward(self, regularization: Tensor | None) -> None:
        """Go back through everything that the loss and another term () depend on."""
        pairs = [*self.gradients, *([(regularization, None)] if regularization is not None else [])]
        tensors, gradients = zip(*pairs, strict=True)
        torch.autograd.backward(tensors, gradients)


def view_loss(picture: TrainingRender, exposed: Tensor, truth: TrainingTarget, settings: TrainingSettings) -> ViewLoss:
    """Loss of one render against its target: the sum of color, depth and cover.

    Color is (1 - s) L1 + s D-SSIM (Kerbl et al. 2023, eq. 7) of `exposed`, the render with its camera's exposure. Depth
    is |d - m| / (d + m) of expected depth d and measured depth m: independent of scale, and bounded, since a beam that
    grazes an edge may be meters off. Cover is the missing alpha at measured surfaces, and the alpha in front of known
    sky.
    """
    alpha, depth = picture.front.alpha, picture.front.depth
    by_alpha: Tensor | None = None
    with torch.no_grad():
        value, by_color = _color(exposed, truth.image, truth.mask, settings.d_ssim)
        gradients = [(exposed, by_color)]
        if len(truth.hits) and (settings.depth or settings.cover):
            surfaces, by_alpha, by_depth = _surfaces(alpha, depth, truth, settings)
            value = value + surfaces
            gradients.append((depth, by_depth))
        if truth.sky is not None and picture.sky is not None and settings.cover:
            sky = truth.sky if truth.mask is None else truth.sky & truth.mask
            share = sky * (settings.cover / sky.sum().clamp_min(1))
            value = value + (alpha * share).sum()
            by_alpha = share if by_alpha is None else by_alpha.add_(share)
    if by_alpha is not None:
        gradients.append((alpha, by_alpha))
    return ViewLoss(value, gradients)


def _surfaces(
    alpha: Tensor, depth: Tensor, truth: TrainingTarget, settings: TrainingSettings
) -> tuple[Tensor, Tensor, Tensor]:
    """Depth and cover at measured pixels, and their gradients by alpha and depth (h, w)."""
    opaque, weighted = alpha.reshape(-1).index_select(0, truth.hits), depth.reshape(-1).index_select(0, truth.hits)
    share = 1 / len(truth.hits)
    solid = opaque.clamp_min(_MIN_ALPHA)
    mean = weighted / solid
    total = mean + truth.depths
    error = (mean - truth.depths).div_(total).mul_(opaque > _MIN_ALPHA)
    value = error.abs().sum().mul_(settings.depth * share)
    value.sub_(opaque.sum(), alpha=settings.cover * share).add_(settings.cover)
    # d |m - t| / (m + t) = sign(m - t) 2 t / (m + t)^2 dm of mean depth m = depth / alpha and measured t.
    by_mean = torch.sgn(error).mul_(truth.depths).div_(total).div_(total)
    by_weighted = by_mean.div_(solid).mul_(2 * share * settings.depth)
    by_opaque = (-settings.cover * share) - by_weighted * mean
    by_alpha, by_depth = alpha.new_zeros((2, alpha.numel())).unbind()
    by_alpha.index_copy_(0, truth.hits, by_opaque)
    by_depth.index_copy_(0, truth.hits, by_weighted)
    return value, by_alpha.view(alpha.shape), by_depth.view(depth.shape)


# L1 and D-SSIM


def l1(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Mean absolute difference of two (h, w, 3) tensors over the pixels of a bool mask (h, w); 0 if none is set.

    Differentiable once in `rendered`.
    """
    return _ColorLoss.apply(rendered, truth, mask, 0.0)


def d_ssim(rendered: Tensor, truth: Tensor, mask: Tensor | None = None) -> Tensor:
    """Return 1 - SSIM of two (h, w, 3) tensors of values 0..1 over the pixels of a bool mask (h, w).

    Same SSIM as `gsrain_engine.evaluation.image_metrics.ssim`: windows inside the image, masked pixels without weight.
    A term of 3DGS's loss (Kerbl et al. 2023, eq. 7). 0 if the mask is empty. Differentiable once in `rendered`. Raises
    ValueError for other shapes and for images smaller than the window (11 px).
    """
    return _ColorLoss.apply(rendered, truth, mask, 1.0)


class _ColorLoss(torch.autograd.Function):
    """Loss (1 - share) L1 + share D-SSIM for autograd."""

    @staticmethod
    def forward(context: Any, rendered: Tensor, truth: Tensor, mask: Tensor | None, share: float) -> Tensor:
        value, gradient = _color(rendered, truth, mask, share)
        context.save_for_backward(gradient)
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context: Any, by_value: Tensor) -> tuple[Tensor | None, ...]:
        return context.saved_tensors[0] * by_value, None, None, None


def _color(rendered: Tensor, truth: Tensor, mask: Tensor | None, share: float) -> tuple[Tensor, Tensor]:
    """Loss (1 - share) L1 + share D-SSIM and its gradient (h, w, 3) by `rendered`."""
    check_pair(tuple(rendered.shape), tuple(truth.shape), None if mask is None else tuple(mask.shape))
    height, width = rendered.shape[:2]
    if share and min(height, width) < WINDOW_PX:
        raise ValueError(f"SSIM takes pictures of at least {WINDOW_PX} px a side, not {(height, width)}")
    x, y, dtype, device = rendered.permute(2, 0, 1), truth.permute(2, 0, 1), rendered.dtype, rendered.device
    inner = max(height - _EDGE, 0) * max(width - _EDGE, 0)
    difference, weights = x - y, None
    if mask is None:
        count: Any = inner
        paces = _constants((1 - share) / (3 * height * width), 4 * share / (3 * max(inner, 1)), dtype, device)
    else:
        weights = mask.to(dtype)
        difference *= weights
        count = weights[_INSIDE, _INSIDE].sum()
        counts = torch.stack([weights.sum(), count]).clamp_min_(1)
        paces = _constants((1 - share) / 3, 4 * share / 3, dtype, device) / counts
    value = difference.abs().sum() * paces[0]
    signs = torch.sgn(difference)
    if not share:
        return value, (signs * paces[0]).permute(1, 2, 0)
    quarters, gradient = _structure(x, y, weights)
    # D-SSIM is 1 - 4 / 3 of the mean of the sums of quarters, and 3 / 4 - 3 / 4 of them is 0 in an empty mask.
    value.addcmul_(quarters - 0.75 * count, paces[1], value=-1)
    gradient *= paces[1] if weights is None else weights * paces[1]
    return value, gradient.addcmul_(signs, paces[0]).permute(1, 2, 0)


@lru_cache(maxsize=64)
def _constants(first: float, second: float, dtype: Any, device: Any) -> Tensor:
    """Two numbers as a tensor on a device."""
    return uploaded(np.array([first, second]), device).to(dtype)


def _structure(x: Tensor, y: Tensor, weights: Tensor | None) -> tuple[Tensor, Tensor]:
    """Sum of a quarter of SSIM over the pixels of a mask of 0 and 1 (h, w), and of its gradient by `x` with weight -1.

    With window means a, b of images (3, h, w), s of the sum of their squares and p of their product, SSIM is 4 (ab + C1
    / 2) (p - ab + C2 / 2) / ((aa + bb + C1) (s - aa - bb + C2)). Only the sum of both variances is needed, which saves
    one filter pass. Derivatives by a, s and p are spread over the windows again: SSIM's is symmetric.
    """
    own, other = (x, y) if weights is None else (x * weights, y * weights)
    products = [own, other, torch.addcmul(own * x, other, y), own * y]
    means, cover = window_means(torch.cat(products if weights is None else [*products, weights[None]])), None
    size = means.shape[1:]
    if weights is not None:
        cover = means[12:].clamp_min_(MIN_WEIGHT)
        means = means[:12].div_(cover)
    a, b, squares, product = means.view(4, 3, *size)
    crossed, both = a * b, torch.addcmul(a * a, b, b)
    factors = torch.stack(
        [crossed + C1 / 2, (squares - both).add_(C2), (product - crossed).add_(C2 / 2), both.add_(C1)]
    )
    quarter = (factors[0] * factors[2]).div_(factors[1] * factors[3])
    if weights is not None:
        quarter *= weights[_INSIDE, _INSIDE]
    slopes = quarter / factors
    slopes[0] = (slopes[2] - slopes[0]).mul_(b).addcmul_(a, slopes[3] - slopes[1], value=2)
    by_windows = slopes[:3] if cover is None else slopes[:3].div_(cover)
    by_mean, by_squares, by_product = spread_over_windows(by_windows.view(9, *size)).view(3, *x.shape)
    return quarter.sum(), by_mean.addcmul_(x, by_squares, value=2).addcmul_(y, by_product, value=-1)


_INSIDE = slice(HALF_WINDOW_PX, -HALF_WINDOW_PX)
_EDGE = 2 * HALF_WINDOW_PX


def window_means(planes: Tensor) -> Tensor:
    """Means (c, h - 10, w - 10) of planes (c, h, w) over SSIM's windows within the image; c is at least 2."""
    return filtered(planes, 0) if planes.device.type == "cpu" else convolved(planes, 0)


def spread_over_windows(planes: Tensor) -> Tensor:
    """Adjoint of `window_means`: (c, h + 10, w + 10) from (c, h, w)."""
    return filtered(planes, _EDGE) if planes.device.type == "cpu" else convolved(planes, _EDGE)


def convolved(planes: Tensor, edge: int) -> Tensor:
    """Filter planes by SSIM's window, within an edge of zeros of `edge` px: along y, then along x. On any device.

    Torch's own float32 kernel takes contiguous planes in at least two groups; cuDNN, which takes the rest, would round
    to TF32, too coarse for variances.
    """
    groups = len(planes)
    taps = _taps(groups, planes.dtype, planes.device)
    rows = torch.nn.functional.conv2d(planes[None], taps[..., None], padding=(edge, 0), groups=groups)
    return torch.nn.functional.conv2d(rows, taps[..., None, :], padding=(0, edge), groups=groups)[0]


@lru_cache(maxsize=16)
def _taps(groups: int, dtype: Any, device: Any) -> Tensor:
    """Taps of the window for each group, (groups, 1, 11)."""
    return uploaded(np.tile(window(), (groups, 1, 1)), device).to(dtype)


def filtered(planes: Tensor, edge: int) -> Tensor:
    """The same by OpenCV, several times faster on the CPU than torch's convolution of single channels."""
    kept = slice(HALF_WINDOW_PX, -HALF_WINDOW_PX)
    values, taps = planes.numpy(), window().astype(planes.numpy().dtype)
    if edge:
        values = np.pad(values, ((0, 0), (edge, edge), (edge, edge)))
    blurred = [cv2.sepFilter2D(each, -1, taps, taps, borderType=cv2.BORDER_CONSTANT)[kept, kept] for each in values]
    return torch.from_numpy(np.stack(blurred))


# Robust mask

_WINDOW = 0.03  # side of the averaging window in image widths; single pixels are no evidence
_THRESHOLDS, _TIMES = 0.08, 4.0
"""Color difference (0..1) below which no pixel is masked, and required multiple of the median."""


def robust_mask(exposed: Tensor, truth: TrainingTarget, max_share: float) -> Tensor:
    """(h, w) bool: the target's mask without the patches where render (h, w, 3) and image differ more than elsewhere.

    Follows robust losses for scenes with distractors (Sabour et al. 2023, section 3.2). Their quantile is only an upper
    bound here, so that no pixel of a well-fitted image is masked: at most `max_share` of the valid pixels.
    """
    with torch.no_grad():
        difference = (exposed - truth.image).abs_().mean(dim=2)
        if truth.mask is None:
            mean = ordered = _patch_means(difference[None])[0]
        else:
            counts = truth.mask.to(difference.dtype)
            mean, part = _patch_means(torch.stack([difference * counts, counts]))
            mean /= part.clamp_min_(1e-6)
            ordered = torch.where(truth.mask, mean, torch.inf)  # pixels that don't count come last
        ordered = ordered.reshape(-1).sort().values
        rank = min(int((1 - max_share) * truth.pixels), truth.pixels - 1)
        bound, median = ordered[max(rank, 0)], ordered[truth.pixels // 2]
        fits = mean <= torch.maximum(bound, (_TIMES * median).clamp_min_(_THRESHOLDS))
        return fits if truth.mask is None else fits & truth.mask


def _patch_means(planes: Tensor) -> Tensor:
    """Means of planes (c, h, w) around each pixel, over the part of a square that is in the image."""
    reach = max(round(_WINDOW * planes.shape[2] / 2), 1)
    side, pool = 2 * reach + 1, torch.nn.functional.avg_pool2d
    columns = pool(planes, (side, 1), 1, (reach, 0), count_include_pad=False)
    return pool(columns, (1, side), 1, (0, reach), count_include_pad=False)

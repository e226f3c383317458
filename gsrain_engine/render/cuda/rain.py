"""Rain in torch for the CUDA renderer, since gsplat's fixed alpha cutoff of 1/255 would erase it.

gsplat renders the scene with its blending weights gathered by depth, with one channel per edge between slabs of rain;
rain is composited slab by slab in between. Inside a slab rain is assumed to be spread evenly over its depth.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64

from ...rain.simulation import RainFrame
from ..cpu.compositing import MAX_ALPHA
from ..cpu.projection import Splats

torch: Any = import_module("torch")
Tensor = Any
_COLUMNS = 1 << 14  # pixel columns of splats that are processed at once
_OPAQUE = 0.98
"""The other renderers end a pixel before the splat that would leave less than 1e-4, with up to 2 % of light left."""

_FIXED_POINT = 2.0**40  # logarithms are added as integers: the sum, and thus the output, doesn't depend on the order


@dataclass(frozen=True, slots=True, eq=False)
class DepthSlabs:
    """Splats of rain, nearest first, in slabs of equal weight."""

    shapes: Float32[np.ndarray, "m 8"]
    """As in `Splats`."""
    starts: Int64[np.ndarray, " slabs_and_one"]
    """First splat of each slab; the last entry is the number of splats."""
    edges_m: Float32[np.ndarray, " slabs_and_one"]
    """Depths between the slabs, including those of the nearest and the farthest splat; rising."""


def slab_edge_channels(depths: Tensor, slabs: DepthSlabs) -> Tensor:
    """Shares of the two nearest slab edges, one channel per edge (n, edges), for scene splats at depths (n,).

    They are linear in depth and add up to 1; in front of all rain only the first edge, behind it only the last.
    """
    edges = torch.as_tensor(slabs.edges_m, device=depths.device)
    upper = torch.clamp(torch.searchsorted(edges, depths.contiguous()), 1, len(edges) - 1)
    low, high = edges[upper - 1], edges[upper]
    position = upper - 1 + torch.clamp((depths - low) / torch.clamp(high - low, min=1e-6), 0, 1)
    return torch.clamp(1 - torch.abs(position[:, None] - torch.arange(len(edges), device=depths.device)), min=0)


def composite_rain_slabs(rgba: Tensor, by_edge: Tensor, slabs: DepthSlabs, rain: RainFrame) -> Tensor:
    """Composite rain with a scene: premultiplied display color and alpha (h, w, 4).

    `rgba` is the clear scene, `by_edge` its weights (h, w, edges) from `slab_edge_channels`. With the scene's color B
    and alpha A, its share W_s and the rain's W_r under each other: enc(min(W_s / A, 1) dec(B) + W_r S) in linear light,
    as in `add_rain_light`; the display form is the same without enc and dec.
    """
    alpha = rgba[..., 3]
    rain_share, scene_share = _shares(by_edge, alpha, slabs)
    light = torch.as_tensor(rain.light_linear, device=rgba.device)
    seen = torch.where(alpha > 0, torch.clamp(scene_share / torch.clamp(alpha, min=1e-30), max=1), 1.0)[..., None]
    if rain.mixing == "linear":
        color = _to_display(seen * _to_linear(rgba[..., :3]) + rain_share[..., None] * light)
    else:
        color = seen * rgba[..., :3] + rain_share[..., None] * _to_display(light)
    rainy = torch.cat([color, (rain_share + scene_share)[..., None]], dim=-1)
    return torch.where(rain_share[..., None] > 0, rainy, rgba)


def _shares(by_edge: Tensor, alpha: Tensor, slabs: DepthSlabs) -> tuple[Tensor, Tensor]:
    """Visible shares of rain and of scene through each other (h, w), see `composite_in_rain`."""
    height, width = alpha.shape
    hidden = torch.where(alpha > _OPAQUE, 1 - alpha, 0.0)
    through_scene = 1 - hidden
    through_rain = torch.ones_like(alpha)
    rain_share, scene_share = torch.zeros_like(alpha), by_edge[..., 0]
    for k, cover in enumerate(_covers(slabs, height, width, alpha.device)):
        through_scene = through_scene - by_edge[..., k]
        rain_share = rain_share + through_rain * cover * torch.clamp(through_scene, min=0)
        through_rain = through_rain * (1 - cover)
        scene_share = scene_share + through_rain * by_edge[..., k + 1]
    return rain_share * (1 + hidden), scene_share


def _covers(slabs: DepthSlabs, height: int, width: int, device: Tensor) -> Tensor:
    """Combined alpha of each slab's splats (slabs, h, w): 1 - prod (1 - alpha), in any order."""
    count = len(slabs.starts) - 1
    total = torch.zeros(count * height * width, dtype=torch.int64, device=device)
    shapes = torch.as_tensor(slabs.shapes, device=device)
    image = torch.as_tensor(np.repeat(np.arange(count), np.diff(slabs.starts)), device=device)
    left = torch.clamp(torch.ceil(shapes[:, 0] - shapes[:, 7] - 0.5), 0, width).long()
    right = torch.clamp(torch.floor(shapes[:, 0] + shapes[:, 7] + 0.5), 0, width).long()
    splats, columns = _spread(left, right)
    for splat, column in zip(splats.split(_COLUMNS), columns.split(_COLUMNS), strict=True):
        _add_columns(shapes[splat], column, image[splat] * (height * width) + column, (height, width), total)
    return -torch.expm1(total.to(torch.float32) / _FIXED_POINT).reshape(count, height, width)


def _add_columns(shapes: Tensor, columns: Tensor, places: Tensor, size: tuple[int, int], total: Tensor) -> None:
    """Add ln(1 - alpha) along one pixel column of each splat, starting at a position in `total`; see `Splats`."""
    height, width = size
    x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, _ = shapes.unbind(1)
    dx = columns + 0.5 - x
    peak = log_opacity + sharpness_x * dx * dx
    center = y + shear * dx
    half = torch.sqrt(torch.clamp((peak - log_cut) / -sharpness_y, min=0))
    top = torch.clamp(torch.ceil(center - half - 0.5), 0, height).long()
    bottom = torch.clamp(torch.floor(center + half + 0.5), 0, height).long()
    column, v = _spread(top, bottom)
    dy = v + 0.5 - center[column]
    alpha = torch.exp(peak[column] + sharpness_y[column] * dy * dy)
    logs = torch.log1p(-torch.clamp(alpha, max=float(MAX_ALPHA)))
    total.index_add_(0, places[column] + v * width, (logs * _FIXED_POINT).to(torch.int64))


def _spread(starts: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
    """Every integer from starts to before ends, and the index of its range."""
    counts = torch.clamp(ends - starts, min=0)
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    first = torch.cumsum(counts, 0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - first[owner] + starts[owner]


def _to_linear(display: Tensor) -> Tensor:
    """Decode by the sRGB transfer function (IEC 61966-2-1)."""
    return torch.where(display > 0.04045, ((torch.clamp(display, min=0.04045) + 0.055) / 1.055) ** 2.4, display / 12.92)


def _to_display(linear: Tensor) -> Tensor:
    curve = 1.055 * torch.clamp(linear, min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear > 0.0031308, curve, 12.92 * linear)


SLABS = 91
"""91 slabs have 92 edges; with color and depth that makes 96 channels, of which gsplat draws 32 at once."""


def split_into_depth_slabs(splats: Splats, slabs: int = SLABS) -> DepthSlabs:
    """Split rain at depths that give each slab the same weight: opacity times the area of its ellipse.

    Only the scene's splats inside a slab are drawn in the wrong order relative to rain; this way that affects a small
    share of the rain at any depth.
    """
    order = splats.nearest_first()
    shapes, depths = splats.shapes[order], splats.colors[order, 3]
    x, y, opacity = (shapes[:, column].astype(np.float64) for column in (3, 4, 5))
    weights = np.cumsum(np.exp(opacity) / np.sqrt(x * y))
    total = weights[-1] if len(order) else 0.0
    inner = np.searchsorted(weights, total * np.arange(1, slabs) / slabs)
    starts = np.concatenate([[0], inner, [len(order)]]).astype(np.int64)
    edges = depths[np.minimum(starts, len(order) - 1)] if len(order) else np.zeros(slabs + 1, np.float32)
    return DepthSlabs(shapes, starts, edges)

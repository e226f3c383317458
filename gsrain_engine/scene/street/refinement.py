"""Refinement of quads for sharp pictures: cells that grow from color edges and outlines inwards, by the ego's view."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64

from .layout import Label, StreetParameters
from .shadows import sun_visibility
from .mesh import EDGE_SPREAD, INNER_SPREAD, Quads, geometric_normals

GROWTH = 2.0
LEAF_SMOOTH = 1.12
SHADE_PX = 6.0
SHADE = 0.08
EDGE_PX = 1.0
UNSEEN_PX = 4.0
LEAF_PX = 2.0
CONTRAST = 0.05
_FOCAL_PX = 1030.0
_EYE_M = (1.54, 2.12)
_SLOPES = (0.4663, 0.311)
_NEAREST_M = 3.0
MAX_CELLS = 9
CLEAR = 2.4


@dataclass(frozen=True, slots=True)
class View:
    """Front cameras of the ego along its way."""

    first_x: float
    last_x: float
    y: float
    z: float


def ego_view(p: StreetParameters) -> View:
    return View(_EYE_M[0], p.ego_speed_m_s * p.drive_seconds + _EYE_M[0], -0.5 * p.lane_width_m, _EYE_M[1])


def refined(quads: Quads, view: View) -> Quads:
    """Cut quads into cells that are small next to color edges and outlines."""
    if not len(quads) or np.all(quads.labels == Label.SKY):
        return quads
    lengths, facing = _lengths_px(quads, view)
    hard = hard_edges(quads, facing)
    leaf = (quads.labels == Label.VEGETATION) & (quads.opacity < 0.985)
    seen = facing.any(axis=1)
    seen |= leaf
    step = np.where(seen, np.where(leaf, LEAF_PX, EDGE_PX), UNSEEN_PX)
    nu = _cells(lengths[:, 0], hard[:, 3], hard[:, 1], step)
    nv = _cells(lengths[:, 1], hard[:, 0], hard[:, 2], step)
    kinds = np.stack([nu, nv, 2 * hard[:, 3] + hard[:, 1], 2 * hard[:, 0] + hard[:, 2]], axis=1).astype(np.int64)
    code = kinds @ np.array([1, 64, 64 * 64, 4 * 64 * 64])
    counts = nu * nv
    first = np.concatenate([[0], np.cumsum(counts)])
    total = int(first[-1])
    parent = np.repeat(np.arange(len(quads)), counts)
    corners = np.empty((total, 4, 3), np.float32)
    spread = np.empty((total, 2), np.float32)
    order = np.argsort(code, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(code[order]) > 0])
    for own in np.split(order, starts[1:]):
        i, j, ku, kv = (int(k) for k in kinds[own[0]])
        u, su = _lines(i, ku)
        v, sv = _lines(j, kv)
        c = quads.corners[own].astype(np.float64)[:, None, None]
        a, b = u[None, :, None, None], v[None, None, :, None]
        grid = (1 - b) * ((1 - a) * c[..., 0, :] + a * c[..., 1, :]) + b * ((1 - a) * c[..., 3, :] + a * c[..., 2, :])
        cells = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, 1:, 1:], grid[:, :-1, 1:]], axis=3)
        rows = (first[own][:, None] + np.arange(i * j)).reshape(-1)
        corners[rows] = cells.reshape(-1, 4, 3)
        each = np.empty((len(own), i, j, 2), np.float32)
        keep = i == 1 and (ku == 0 or j == 1 and kv > 0), j == 1 and (kv == 0 or i == 1 and ku > 0)
        each[..., 0] = quads.spread[own, 0][:, None, None] if keep[0] else su[:, None]
        each[..., 1] = quads.spread[own, 1][:, None, None] if keep[1] else sv[None]
        spread[rows] = each.reshape(-1, 2)
    spread[leaf[parent]] *= LEAF_SMOOTH
    return replace(quads.take(parent), corners=corners, spread=spread)


def split_at_shadows(quads: Quads, view: View, layout, sun) -> Quads:
    """Cut quads that a shadow's edge crosses into even cells."""
    if not len(quads) or np.all(quads.labels == Label.SKY):
        return quads
    lengths, facing = _lengths_px(quads, view)
    leaf = quads.labels == Label.VEGETATION
    lit = np.maximum(quads.normals @ sun.astype(np.float32), 0) * quads.sun_access
    chosen = np.flatnonzero(facing.any(axis=1) & ~leaf & (lit > 0.1) & (lengths.max(axis=1) > 1.5 * SHADE_PX) & (quads.opacity > 0.9))
    c = quads.corners[chosen].astype(np.float64)
    places = [*np.moveaxis(c, 1, 0), c.mean(axis=1)]
    visible = np.stack([sun_visibility(layout, sun, p, np.zeros(len(p), bool)) for p in places])
    tone = np.sqrt(np.clip(quads.albedo[chosen].mean(axis=1), 0, 0.6))
    crossed = (visible.max(axis=0) - visible.min(axis=0)) * lit[chosen] * tone > SHADE
    own = chosen[crossed]
    n = np.ones((len(quads), 2), int)
    n[own] = np.clip(np.round(lengths[own] / SHADE_PX), 1, 6)
    return quads.split(n)


def _lines(n: int, kind: int) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " n"]]:
    """Lines of n cells from 0 to 1 that grow from hard ends (kind: 2 the first, 1 the last, 3 both), and spreads."""
    if n == 1 and kind:
        return np.array([0.0, 1.0]), np.full(1, EDGE_SPREAD)
    if n == 1 or kind == 0:
        return np.linspace(0, 1, n + 1), np.full(n, INNER_SPREAD)
    k = np.arange(n)
    steps = {2: k, 1: n - 1 - k, 3: np.minimum(k, n - 1 - k)}[kind]
    widths = GROWTH ** steps.astype(np.float64)
    widths /= widths.sum()
    lines = np.concatenate([[0.0], np.cumsum(widths)])
    middle = 0.5 * (lines[1:] + lines[:-1])
    away = {2: middle, 1: 1 - middle, 3: np.minimum(middle, 1 - middle)}[kind]
    return lines, np.clip(away / (CLEAR * widths), EDGE_SPREAD, INNER_SPREAD)


def _cells(length_px, first, last, step):
    """Number of cells along a side of a length in pixels."""
    ends = first.astype(int) + last.astype(int)
    half = np.where(ends == 2, 0.5, 1.0) * length_px / step
    steps = np.log1p(half * (GROWTH - 1)) / np.log(GROWTH)
    n = np.where(ends == 2, np.round(2 * steps), np.round(steps)).astype(int)
    return np.where(ends > 0, np.clip(n, 1, MAX_CELLS), 1)


def _lengths_px(quads: Quads, view: View):
    """Lengths of u and v in pixels where the ego passes closest, and whether the front is turned to it, at 3 places."""
    c = quads.corners.astype(np.float64)
    middle = c.mean(axis=1)
    u = 0.5 * (c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3])
    v = 0.5 * (c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1])
    dy, dz = middle[:, 1] - view.y, middle[:, 2] - view.z
    nearest = np.maximum(np.maximum(np.abs(dy) / _SLOPES[0], np.abs(dz) / _SLOPES[1]), _NEAREST_M)
    depth = np.maximum(nearest, middle[:, 0] - view.last_x)
    visible = middle[:, 0] - view.first_x >= nearest
    normals = geometric_normals(c)
    sx, sy = dy / depth, dz / depth
    size = []
    for edge in (u, v):
        size.append(_FOCAL_PX / depth * np.hypot(edge[:, 1] - sx * edge[:, 0], edge[:, 2] - sy * edge[:, 0]))
    facing = []
    for times in (1.0, 2.0, 6.0):
        d = np.minimum(times * depth, np.maximum(middle[:, 0] - view.first_x, depth))
        towards = np.stack([d, dy, dz], axis=1)
        facing.append((np.sum(towards * normals, axis=1) < 0) & visible)
    return np.stack(size, axis=1), np.stack(facing, axis=1)


def hard_edges(quads: Quads, facing) -> Bool[np.ndarray, "n 4"]:
    """Sides (corners 0-1, 1-2, 2-3, 3-0) at which the color changes, or the surface ends."""
    n = len(quads)
    keys = np.round(quads.corners.astype(np.float64) * 1000).astype(np.int64)
    mixed = (keys[..., 0] * 0x1F123BB5 + keys[..., 1] * 0x5F356495 + keys[..., 2] * 0x2545F491).astype(np.int64)
    first, second = mixed, np.roll(mixed, -1, axis=1)
    edge = (np.minimum(first, second) * 31 + np.maximum(first, second) * 17).reshape(-1)
    none = (first == second).reshape(-1)
    order = np.argsort(edge, kind="stable")
    ordered = edge[order]
    pair = np.flatnonzero(ordered[1:] == ordered[:-1])
    a, b = order[pair], order[pair + 1]
    colors = _colors(quads)
    differ = np.max(np.abs(colors[a // 4] - colors[b // 4]), axis=1) > CONTRAST
    differ |= (facing[a // 4] != facing[b // 4]).any(axis=1)
    hard = np.ones(4 * n, bool)
    hard[a] = differ
    hard[b] = differ
    hard[none] = False
    return hard.reshape(n, 4)


_SUN = np.array([-0.42, 0.537, 0.731])


def _colors(quads: Quads):
    n = quads.normals.astype(np.float64)
    light = np.maximum(n @ _SUN, 0)[:, None] * quads.sun_access[:, None] * 2.6
    light = light + quads.sky_access[:, None] * (0.35 + 0.25 * n[:, 2:])
    return (1 - np.exp(-1.18 * light * quads.albedo)) ** (1 / 2.2) + 0.3 * quads.gloss[:, None]


def refined_lead(lead: Quads) -> Quads:
    view = View(-18.0 + _EYE_M[0], -15.5 + _EYE_M[0], 0.0, _EYE_M[1])
    shadow = lead.opacity < 0.9
    return Quads.joined([lead.take(shadow), refined(lead.take(~shadow), view)])

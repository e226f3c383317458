"""Optics of a wet pane: refraction by drops, veil of film and dirt, the wiper's blade, and blur by the open lens.

A picture through wet glass is I (1 - c) + L in linear light. L and c, light and coverage of water, dirt and blade, are
drawn on the pane with rays through the center of the lens, and averaged over the circle of confusion of the pane. They
vary slowly where that circle is large, and have a cell for several pixels there.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import no_type_check

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from ..kernels import kernel, range_of
from ..rain.pcg_hash import pcg4d_scalar
from ..scene.camera import Camera
from ..scene.geometry import srgb_to_linear
from ..scene.sensor import ThinLens
from .glass_drops import RADIUS, SHAPE, SPEED, TO_U, TO_V, U, V
from .pane import Pane
from .wiper import BLADE_M, INNER_M, OUTER_M, PIVOT_M
from .wiper_glare import add_streaks, lamp_streaks, pivot_px, smeared

WATER_INDEX = 1.333
"""Refractive index of water for visible light."""

WIDE = 2.5
"""Tangents of the half angles of the wide view, relative to those of the picture."""

WIDE_PX, _COARSE_PX = 160, (64, 80)
"""Width of the wide view for sharp drops, and widths for blurred ones, of which the least that is enough is taken."""

_LARGE_M, _FINE = 0.003, 4.0  # radius of a large drop; least pixels of the wide view along what a cell shows; ours
_SPREAD = 0.7  # difference of angles of rays over half a drop: they spread over some 80 degrees

_FILM_M, _FILM_SHARE = 2e-6, 0.5  # depth at which the film takes 1 - 1/e of its largest share of the light; ours
_DIRT_SHARE, _WIPED_SHARE = 0.2, 0.3  # coverage of dirt of 1, and what wipers leave of it; ours
_DIRT_M = 0.009, 0.0023  # sizes of spots
_BLADE_LIGHT, _ARM_M = 0.01, 0.006
_NOWHERE = np.float32(1e6)
_FAST = {"contract", "nsz", "arcp"}  # fused multiply-add and reciprocals, but no change of infinities or order


@dataclass(frozen=True, slots=True, eq=False)
class WetGlass:
    """Water, dirt and blade on a pane at one time, and the camera behind it."""

    pane: Pane
    drops: Float64[np.ndarray, "n 10"]
    """Rows of `GlassDrops.drops`."""
    film_m: Float32[np.ndarray, "rows columns"]
    film_cell_m: float
    contact_angle_deg: float
    blade_rad: float | None
    """Angle of the blade; None without a wiper."""
    dirt: float
    """Amount of dirt, 0..1."""
    seed: int


def wide_camera(camera: Camera, width_px: int = WIDE_PX) -> Camera:
    """Camera with the same pose and a wide field of view, for what drops refract into the picture."""
    height = max(round(width_px * camera.height / camera.width), 8)
    across, down = width_px / camera.width, height / camera.height
    return Camera(
        width_px, height, camera.fx * across / WIDE, camera.fy * down / WIDE, width_px / 2, height / 2,
        camera.world_to_camera, camera.exposure_s,
    )  # fmt: skip


def wide_view(camera: Camera, pane: Pane, lens: ThinLens) -> Camera:
    """Wide camera with the width that drops need: they minify the view, and an open lens blurs it.

    It does not depend on the drops, so that nothing jumps when a larger one comes.
    """
    return wide_camera(camera, _wide_px(pane, lens, camera.rounded_intrinsics, camera.width, camera.height))


@lru_cache(maxsize=8)
def _wide_px(pane: Pane, lens: ThinLens, intrinsics: tuple[float, float, float, float], width: int, height: int) -> int:
    camera = Camera(width, height, *intrinsics)
    depth_m = float(pane.origin_m @ pane.normal) / max(float(pane.normal[2]), 0.02)
    cells = camera.fx * _LARGE_M / depth_m / _cell_px(_circles_px(pane, lens, camera, _edges_px(camera)))
    fine = (each for each in _COARSE_PX if _SPREAD * wide_camera(camera, each).fx / cells >= _FINE)
    return next(fine, WIDE_PX)


@dataclass(frozen=True, slots=True, eq=False)
class GlassView:
    """Wet glass in front of one camera."""

    glass: WetGlass
    camera: Camera
    lens: ThinLens
    wide: UInt8[np.ndarray, "h w 3"]
    """View behind the glass of `wide_camera`, of any width (sRGB)."""

    def picture(self, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """Return a picture (sRGB) as it is through the glass; it has the camera's size."""
        layer, cell_px, margin = self.layer(image)
        made = np.empty_like(image)
        _composite(np.ascontiguousarray(image), layer, cell_px, margin, made)
        return made

    def layer(self, image: UInt8[np.ndarray, "h w 3"]) -> tuple[Float32[np.ndarray, "rows columns 4"], int, int]:
        """Light and coverage of what is on the glass, pixels along a cell, and cells of a margin on each side."""
        glass, pane, height, width = self.glass, self.glass.pane, image.shape[0], image.shape[1]
        camera = self.camera.resized(width, height)
        grid = _pane_grid(pane, self.lens, camera.rounded_intrinsics, width, height)
        blade_rad = -1.0 if glass.blade_rad is None else glass.blade_rad
        has_wiper = blade_rad >= 0
        dirt = _dirt(grid, glass.seed, has_wiper) if glass.dirt > 0 else np.zeros((0, 0), np.float32)
        rows, columns = grid.size
        layer = np.zeros((rows, columns, 4), np.float32)
        wide = wide_camera(camera, self.wide.shape[1])
        if len(glass.drops):
            levels, starts = _pyramid(self.wide)
            source = np.array([wide.fx, wide.fy, wide.cx, wide.cy])
            boxes, outlines = _boxes(glass.drops, grid.view, grid.axes, rows, columns, wide.fx, len(starts))
            row_starts, members = _members(boxes, rows)
            _draw_drops(
                layer, glass.drops, boxes, outlines, row_starts, members, grid.view, grid.axes, grid.places, source,
                levels, starts, *_cap(glass.contact_angle_deg),
            )  # fmt: skip
        blurred = _shrunk(image)
        pivot = pivot_px(pane, camera)
        if has_wiper:
            blurred = smeared(blurred, pivot, camera.fy, height / blurred.shape[0])
        depth_m = np.empty(grid.size, np.float32)
        _sample_film(grid.places, np.array(pane.low_m), glass.film_m, glass.film_cell_m, depth_m)
        _draw_veil(
            layer, grid.places, _film_share(depth_m), dirt, glass.dirt, blade_rad, grid.margin, blurred,
            np.array(cv2.mean(blurred)[:3]),
        )  # fmt: skip
        layer = _blurred(layer, grid.radii) if grid.radii.max() >= 0.5 else layer
        streaks = lamp_streaks(image, pivot, camera.fy) if has_wiper else None
        if streaks is not None:
            # The lens is open: it averages the film over a few of its cells.
            around = cv2.blur(glass.film_m, (3, 3), borderType=cv2.BORDER_CONSTANT)
            share, cells = _film_share(around), (grid.cell_px, grid.margin)
            add_streaks(layer, streaks, grid.places, *cells, pane.low_m, share, glass.film_cell_m)
        return layer, grid.cell_px, grid.margin


@dataclass(frozen=True, slots=True, eq=False)
class _PaneGrid:
    """Cells of the layer of a picture's glass, the same for all frames of a camera."""

    cell_px: int
    margin: int
    """Cells on each side."""
    size: tuple[int, int]
    """Rows and columns, with the margin."""
    view: Float64[np.ndarray, "6"]
    """Focal lengths and principal point in px, pixels of a cell, cells of the margin."""
    axes: Float64[np.ndarray, "4 3"]
    """Axes, normal and origin of the pane."""
    places: Float32[np.ndarray, "2 rows columns"]
    """Places of the cells in pane coordinates (m); `_NOWHERE` for rays that meet no pane."""
    radii: Float64[np.ndarray, " rows"]
    """Radius of the circle of confusion in each row, in cells."""


@lru_cache(maxsize=8)
def _pane_grid(
    pane: Pane, lens: ThinLens, intrinsics: tuple[float, float, float, float], width: int, height: int
) -> _PaneGrid:
    fx, fy, cx, cy = intrinsics
    camera = Camera(width, height, fx, fy, cx, cy, np.eye(4))
    circles = _circles_px(pane, lens, camera, _edges_px(camera))
    cell_px = _cell_px(circles)
    margin = int(np.ceil(float(circles.max()) / (2 * cell_px))) + 1
    rows, columns = (-(-side // cell_px) + 2 * margin for side in (height, width))
    y = (np.arange(rows) + 0.5 - margin) * cell_px
    radii = _circles_px(pane, lens, camera, y) / (2 * cell_px)
    view = np.array([fx, fy, cx, cy, cell_px, margin])
    axes = np.stack([pane.right, pane.up, pane.normal, pane.origin_m])
    places = np.empty((2, rows, columns), np.float32)
    _fill_places(view, axes, places)
    return _PaneGrid(cell_px, margin, (rows, columns), view, axes, places, radii)


@lru_cache(maxsize=8)
def _dirt(grid: _PaneGrid, seed: int, is_wiped: bool) -> Float32[np.ndarray, "rows columns"]:
    """Coverage of the glass by dirt of an amount of 1, less of it where a wiper reaches."""
    coverage = np.zeros(grid.size, np.float32)
    _draw_dirt(grid.places, np.uint32(seed), is_wiped, coverage)
    return coverage


def _film_share(depth_m: Float32[np.ndarray, "n m"]) -> Float32[np.ndarray, "n m"]:
    """Share of the light that a film spreads."""
    share = np.multiply(depth_m, np.float32(-1 / _FILM_M))
    np.exp(share, out=share)
    share -= 1
    share *= np.float32(-_FILM_SHARE)
    return share


def _edges_px(camera: Camera) -> Float64[np.ndarray, "2"]:
    return np.array([0.0, float(camera.height)])


def _circles_px(
    pane: Pane, lens: ThinLens, camera: Camera, y_px: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Diameter of the circle of confusion of the pane in the middle of rows of the picture."""
    y = np.clip(y_px, 0, camera.height)
    rays = np.stack([np.zeros_like(y), (y - camera.cy) / camera.fy, np.ones_like(y)], axis=1)
    depth_m = float(pane.origin_m @ pane.normal) / np.maximum(rays @ pane.normal, 0.02)
    return camera.fy * lens.circle_of_confusion_m(depth_m) / depth_m


def _cell_px(circles_px: Float64[np.ndarray, " n"]) -> int:
    """Pixels along a cell: 1, or an eighth to a quarter of the largest circle of confusion."""
    cell_px = 1
    while float(circles_px.max()) >= 8 * cell_px:
        cell_px *= 2
    return cell_px


def refracted(
    place: tuple[float, float], ray: tuple[float, float, float], contact_angle_deg: float
) -> tuple[float, float, float, float]:
    """Trace a ray from the pane (z = 0) through a drop of footprint radius 1 at the origin.

    `ray` is a unit vector in air before the pane, with z > 0 outward. Returns the transmitted share of the light, and
    the direction behind; the share is -1 if the ray misses the drop.
    """
    return _trace(*place, *ray, *_cap(contact_angle_deg), 1.0, 0.0, 1.0)


def _cap(contact_angle_deg: float) -> tuple[float, float]:
    """Radius of the sphere of a cap, and depth of its center below the pane, for a footprint radius of 1."""
    angle = np.radians(contact_angle_deg)
    sphere = 1.0 / np.sin(angle)
    return float(sphere), float(sphere * np.cos(angle))


# Tables


@cache
def _linear_levels() -> Float32[np.ndarray, "256"]:
    return srgb_to_linear(np.arange(256) / 255).astype(np.float32)


def _shrunk(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "r c 3"]:
    """Linear light of a twelfth of a picture: mean display levels of every fourth pixel in both directions."""
    rows, columns = (max(round((side - 2) / 4) // 3, 1) for side in image.shape[:2])
    shrunk = np.empty((rows, columns, 3), np.float32)
    _shrink(image, _linear_levels(), shrunk)
    return shrunk


def _pyramid(picture: UInt8[np.ndarray, "h w 3"]) -> tuple[Float32[np.ndarray, "texels 3"], Int64[np.ndarray, "n 3"]]:
    """Linear light of a picture at resolutions that halve; and first texel, width and height of each."""
    level, levels, starts, first = cv2.LUT(picture, _linear_levels()), [], [], 0
    while True:
        height, width = level.shape[:2]
        levels.append(level.reshape(-1, 3))
        starts.append((first, width, height))
        first += height * width
        if min(height, width) < 8:
            return np.concatenate(levels), np.array(starts)
        level = cv2.resize(level, (width // 2, height // 2), interpolation=cv2.INTER_AREA)


# Kernels


@kernel(parallel=True)
@no_type_check
def _shrink(portion, image, linear, shrunk):
    for row in range_of(portion, shrunk.shape[0]):
        for column in range(shrunk.shape[1]):
            red = green = blue = np.int64(0)
            for k in range(9):
                pixel = image[min(12 * row + 2 + k // 3 * 4, image.shape[0] - 1)]
                at = min(12 * column + 2 + k % 3 * 4, image.shape[1] - 1)
                red, green, blue = red + pixel[at, 0], green + pixel[at, 1], blue + pixel[at, 2]
            shrunk[row, column, 0] = linear[(2 * red + 9) // 18]
            shrunk[row, column, 1] = linear[(2 * green + 9) // 18]
            shrunk[row, column, 2] = linear[(2 * blue + 9) // 18]


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _fresnel(cos_in, cos_out, ratio):
    """Reflected share of unpolarized light; `ratio` is the index before over that behind."""
    s = (ratio * cos_in - cos_out) / (ratio * cos_in + cos_out)
    p = (ratio * cos_out - cos_in) / (ratio * cos_out + cos_in)
    return 0.5 * (s * s + p * p)


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _trace(x, y, dx, dy, dz, sphere, depth, cos_turn, sin_turn, stretch):
    """Trace a ray through a spherical cap (`_cap`) that is stretched along one axis and compressed along the other.

    Lengths are in footprint radii. Three reflections inside are followed, as long as they are total.
    """
    # Coordinates in which the cap is a sphere's: a = (cos x + sin y) / stretch, b = (cos y - sin x) stretch.
    a = (cos_turn * x + sin_turn * y) / stretch
    b = (cos_turn * y - sin_turn * x) * stretch
    c = 0.0
    weight = 1.0
    if a * a + b * b < 1.0:
        dx, dy = dx / WATER_INDEX, dy / WATER_INDEX
        dz = np.sqrt(max(1.0 - dx * dx - dy * dy, 0.0))
        first = True
    else:  # through dry glass onto the outside of a drop
        first = False
    for _ in range(5):
        da = (cos_turn * dx + sin_turn * dy) / stretch
        db = (cos_turn * dy - sin_turn * dx) * stretch
        square = da * da + db * db + dz * dz
        half = a * da + b * db + (c + depth) * dz
        excess = a * a + b * b + (c + depth) * (c + depth) - sphere * sphere
        root = half * half - square * excess
        if root <= 0.0:
            return -1.0, 0.0, 0.0, 0.0
        path = (-half + np.sqrt(root)) / square if first else (-half - np.sqrt(root)) / square
        if path <= 0.0 or c + path * dz < 0.0:
            # Back through the pane into the dark car, or past the drop.
            return (0.0 if first else -1.0), 0.0, 0.0, -1.0
        a, b, c = a + path * da, b + path * db, c + path * dz
        na, nb, nz = a / sphere, b / sphere, (c + depth) / sphere
        nx = cos_turn * na / stretch - sin_turn * nb * stretch
        ny = sin_turn * na / stretch + cos_turn * nb * stretch
        norm = np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        along = dx * nx + dy * ny + dz * nz
        if not first:  # into the water
            ratio, cos_in = 1.0 / WATER_INDEX, -along
            cos_out = np.sqrt(1.0 - ratio * ratio * (1.0 - cos_in * cos_in))
            weight *= 1.0 - _fresnel(cos_in, cos_out, ratio)
            factor = ratio * cos_in - cos_out
            dx, dy, dz = ratio * dx + factor * nx, ratio * dy + factor * ny, ratio * dz + factor * nz
            first = True
            continue
        squared = 1.0 - WATER_INDEX * WATER_INDEX * (1.0 - along * along)
        if squared <= 0.0:  # total reflection
            dx, dy, dz = dx - 2.0 * along * nx, dy - 2.0 * along * ny, dz - 2.0 * along * nz
            continue
        cos_out = np.sqrt(squared)
        weight *= 1.0 - _fresnel(along, cos_out, WATER_INDEX)
        factor = cos_out - WATER_INDEX * along
        dx, dy = WATER_INDEX * dx + factor * nx, WATER_INDEX * dy + factor * ny
        dz = WATER_INDEX * dz + factor * nz
        return (weight if dz > 0.0 else 0.0), dx, dy, dz
    return 0.0, 0.0, 0.0, -1.0


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _outline(drop):
    """Axis and stretch of a drop: running drops are long, others are a little out of round."""
    if drop[SPEED] > 0.0:
        stretch = 1.0 + min(2.0 * drop[SPEED], 0.5)
        return drop[TO_U], drop[TO_V], np.sqrt(stretch)
    turn = 40.0 * drop[SHAPE]
    return np.cos(turn), np.sin(turn), 1.0 + 0.3 * abs(drop[SHAPE] - 0.5)


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _boxes(drops, view, axes, rows, columns, focal, levels):
    """Cells of each drop, as first and last row and column, none if it is out of view; and its outline.

    That is its radius in cells, axis and stretch, and the level of the wide view, of a focal length, that it shows.
    """
    fx, fy, cx, cy, cell, margin = view
    boxes, outlines = np.empty((len(drops), 4), np.int64), np.empty((len(drops), 5))
    for k in range(len(drops)):
        reach = 1.3 * drops[k, RADIUS]
        low_x = low_y = 1e9
        high_x = high_y = -1e9
        for corner in range(4):
            u = drops[k, U] + (reach if corner & 1 else -reach)
            v = drops[k, V] + (reach if corner & 2 else -reach)
            z = axes[3, 2] + u * axes[0, 2] + v * axes[1, 2]
            if z < 1e-4:
                continue
            x = ((axes[3, 0] + u * axes[0, 0] + v * axes[1, 0]) / z * fx + cx) / cell + margin
            y = ((axes[3, 1] + u * axes[0, 1] + v * axes[1, 1]) / z * fy + cy) / cell + margin
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        # A cell's center is half a cell from its corner.
        boxes[k, 0] = np.int64(max(0.0, np.floor(low_y - 0.5)))
        boxes[k, 1] = np.int64(min(np.ceil(high_y - 0.5), rows - 1.0))
        boxes[k, 2] = np.int64(max(0.0, np.floor(low_x - 0.5)))
        boxes[k, 3] = np.int64(min(np.ceil(high_x - 0.5), columns - 1.0))
        if boxes[k, 2] > boxes[k, 3] or boxes[k, 0] > boxes[k, 1]:
            boxes[k, 1] = boxes[k, 0] - 1
            continue
        cells = max(np.sqrt(max(high_x - low_x, 0.0) * max(high_y - low_y, 0.0)) / 2.6, 0.05)
        outlines[k, 0], outlines[k, 1:4] = cells, _outline(drops[k])
        outlines[k, 4] = min(np.floor(np.log2(max(1.0, _SPREAD * focal / cells)) + 0.5), levels - 1.0)
    return boxes, outlines


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _members(boxes, rows):
    """Drops of each row, in their order: `members[starts[row] : starts[row + 1]]`."""
    starts = np.zeros(rows + 1, np.int64)
    for k in range(len(boxes)):
        for row in range(boxes[k, 0], boxes[k, 1] + 1):
            starts[row + 1] += 1
    starts = np.cumsum(starts)
    members, ends = np.empty(starts[-1], np.int64), starts.copy()
    for k in range(len(boxes)):
        for row in range(boxes[k, 0], boxes[k, 1] + 1):
            members[ends[row]] = k
            ends[row] += 1
    return starts, members


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _look_up(levels, starts, level, x, y, found):
    """Bilinear color of a level at a place in texels of the first one; the border goes on outside."""
    first, width, height = starts[level]
    scale_x, scale_y = width / starts[0, 1], height / starts[0, 2]
    x = min(max(0.0, x * scale_x - 0.5), width - 1.0)
    y = min(max(0.0, y * scale_y - 0.5), height - 1.0)
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    right, below = x - column, y - row
    at = first + row * width + column
    for channel in range(3):
        upper = levels[at, channel] + right * (levels[at + 1, channel] - levels[at, channel])
        lower = levels[at + width, channel] + right * (levels[at + width + 1, channel] - levels[at + width, channel])
        found[channel] = upper + below * (lower - upper)


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _draw_drops(
    portion,
    layer,
    drops,
    boxes,
    outlines,
    row_starts,
    members,
    view,
    axes,
    places,
    source,
    levels,
    starts,
    sphere,
    depth,
):
    fx, fy, cx, cy, cell, margin = view
    for row in range_of(portion, layer.shape[0]):
        color = np.empty(3)
        y = ((row + 0.5 - margin) * cell - cy) / fy
        for at in range(row_starts[row], row_starts[row + 1]):
            k = members[at]
            center_u, center_v, by_radius = drops[k, U], drops[k, V], 1.0 / drops[k, RADIUS]
            cells, cos_turn, sin_turn, stretch = outlines[k, 0], outlines[k, 1], outlines[k, 2], outlines[k, 3]
            level = int(outlines[k, 4])
            for column in range(boxes[k, 2], boxes[k, 3] + 1):
                u = (places[0, row, column] - center_u) * by_radius
                v = (places[1, row, column] - center_v) * by_radius
                # Share of the cell inside of the outline; the ray of a cell on the edge is that of the drop's rim.
                across = (cos_turn * u + sin_turn * v) / stretch
                along = (cos_turn * v - sin_turn * u) * stretch
                distance = np.sqrt(across * across + along * along)
                share = 1.0
                if cells < 1.0:  # about as small as a cell: its area, as a square around its place
                    side = np.sqrt(np.pi) * cells
                    half = 0.5 + 0.5 * max(side, 1.0)
                    share = min(max(half - abs(u) * cells, 0.0), 1.0) * min(max(half - abs(v) * cells, 0.0), 1.0)
                    share *= min(side * side, 1.0)
                    shrink = 0.6 / max(distance, 0.6)
                    u, v = u * shrink, v * shrink
                else:
                    inside = (1.0 - distance) * cells + 0.5
                    if 0.0 < inside < 1.0 and distance >= 1.0:
                        u, v = 0.999 * u / distance, 0.999 * v / distance
                        share = inside
                    elif distance < 1.0:
                        share = min(inside, 1.0)
                if share <= 0.0 or distance > 1e3:  # far off: the ray meets no pane
                    continue
                x = ((column + 0.5 - margin) * cell - cx) / fx
                short = 1.0 / np.sqrt(x * x + y * y + 1.0)
                du = (x * axes[0, 0] + y * axes[0, 1] + axes[0, 2]) * short
                dv = (x * axes[1, 0] + y * axes[1, 1] + axes[1, 2]) * short
                dz = (x * axes[2, 0] + y * axes[2, 1] + axes[2, 2]) * short
                weight, out_u, out_v, out_n = _trace(u, v, du, dv, dz, sphere, depth, cos_turn, sin_turn, stretch)
                if weight < 0.0:
                    continue
                free = share * (1.0 - layer[row, column, 3])
                layer[row, column, 3] += free
                if weight <= 0.0:
                    continue
                rx = out_u * axes[0, 0] + out_v * axes[1, 0] + out_n * axes[2, 0]
                ry = out_u * axes[0, 1] + out_v * axes[1, 1] + out_n * axes[2, 1]
                rz = max(out_u * axes[0, 2] + out_v * axes[1, 2] + out_n * axes[2, 2], 0.05)
                _look_up(levels, starts, level, source[0] * rx / rz + source[2], source[1] * ry / rz + source[3], color)
                for channel in range(3):
                    layer[row, column, channel] += free * weight * color[channel]


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _noise(u, v, size, seed, lattice):
    """Smooth noise 0..1 over the pane; `lattice` holds a cell and its corners from one call to the next."""
    x, y = u / size, v / size
    column, row = np.floor(x), np.floor(y)
    if column != lattice[0] or row != lattice[1]:
        lattice[0], lattice[1] = column, row
        for corner in range(4):
            i, j = np.int64(column) + (corner & 1), np.int64(row) + (corner >> 1)
            a, _, _, _ = pcg4d_scalar(np.uint32(i), np.uint32(j), np.uint32(0x165667B1), seed)
            lattice[2 + corner] = a * 2.0**-32
    right, above = x - column, y - row
    right, above = right * right * (3 - 2 * right), above * above * (3 - 2 * above)
    lower = lattice[2] + right * (lattice[3] - lattice[2])
    upper = lattice[4] + right * (lattice[5] - lattice[4])
    return lower + above * (upper - lower)


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _plane(axes):
    """Axes of the pane, two and the normal, and the origin along each: numbers, not an array that might change."""
    right, up, normal, origin = axes
    along = 0.0, 0.0, 0.0
    for k in range(3):
        along = along[0] + right[k] * origin[k], along[1] + up[k] * origin[k], along[2] + normal[k] * origin[k]
    return (right[0], right[1], right[2]), (up[0], up[1], up[2]), (normal[0], normal[1], normal[2]), along


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _place(x, y, plane):
    """Place on the pane that the ray (x, y, 1) meets, and whether it meets one."""
    right, up, normal, origin = plane
    along = x * normal[0] + (y * normal[1] + normal[2])
    path = origin[2] / max(along, 0.01)
    u = path * (x * right[0] + (y * right[1] + right[2])) - origin[0]
    return u, path * (x * up[0] + (y * up[1] + up[2])) - origin[1], along > 0.01


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _fill_places(view, axes, places):
    fx, fy, cx, cy, cell, margin = view
    plane = _plane(axes)
    for row in range(places.shape[1]):
        y = ((row + 0.5 - margin) * cell - cy) / fy
        for column in range(places.shape[2]):
            u, v, is_met = _place(((column + 0.5 - margin) * cell - cx) / fx, y, plane)
            places[0, row, column] = u if is_met else _NOWHERE
            places[1, row, column] = v if is_met else _NOWHERE


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _draw_dirt(portion, places, seed, is_wiped, coverage):
    for row in range_of(portion, coverage.shape[0]):
        coarse, fine = np.full(6, np.inf), np.full(6, np.inf)
        for column in range(coverage.shape[1]):
            u, v = np.float64(places[0, row, column]), np.float64(places[1, row, column])
            if u == _NOWHERE:
                continue
            spots = 0.6 * _noise(u, v, _DIRT_M[0], seed, coarse)
            spots += 0.4 * _noise(u, v, _DIRT_M[1], seed + np.uint32(1), fine)
            share = _DIRT_SHARE * (0.3 + 1.4 * max(spots - 0.25, 0.0))
            from_pivot = np.hypot(u - PIVOT_M[0], v - PIVOT_M[1])
            coverage[row, column] = share * (_WIPED_SHARE if is_wiped and INNER_M <= from_pivot <= OUTER_M else 1.0)


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _sample_film(portion, places, low, film, film_cell, depth):
    """Interpolate the film's depth; none outside of it."""
    low_u, low_v, points_m = np.float32(low[0]), np.float32(low[1]), np.float32(1 / film_cell)
    wide, tall, one = np.float32(film.shape[1] - 1), np.float32(film.shape[0] - 1), np.float32(1)
    for row in range_of(portion, depth.shape[0]):
        for column in range(depth.shape[1]):
            x, y = (places[0, row, column] - low_u) * points_m, (places[1, row, column] - low_v) * points_m
            found = np.float32(0)
            if (x >= 0) & (y >= 0) & (x < wide) & (y < tall):
                i, j = np.uint32(np.int32(x)), np.uint32(np.int32(y))
                right, above = x - np.float32(i), y - np.float32(j)
                lower = film[j, i] * (one - right) + film[j, i + np.uint32(1)] * right
                upper = film[j + np.uint32(1), i] * (one - right) + film[j + np.uint32(1), i + np.uint32(1)] * right
                found = lower * (one - above) + upper * above
            depth[row, column] = found


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _draw_veil(portion, layer, places, wet, dirt, amount, blade, margin, blurred, mean):
    """Add film and dirt, which spread light, and the blade, which hides it."""
    tall, wide = blurred.shape[0], blurred.shape[1]
    down = np.float32(tall / (layer.shape[0] - 2 * margin))
    across = np.float32(wide / (layer.shape[1] - 2 * margin))
    to_u, to_v = np.float32(np.cos(blade)), np.float32(np.sin(blade))
    zero, half, one, thousand = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1000)
    pivot_u, pivot_v, amount = np.float32(PIVOT_M[0]), np.float32(PIVOT_M[1]), np.float32(amount)
    inner, outer = np.float32(INNER_M**2), np.float32(OUTER_M**2)
    red, green, blue = np.float32(mean[0]), np.float32(mean[1]), np.float32(mean[2])
    near = np.float32(0.7)
    far_red, far_green, far_blue = (one - near) * red, (one - near) * green, (one - near) * blue
    for row in range_of(portion, layer.shape[0]):
        j = min(max(int((np.float32(row - margin) + half) * down), 0), tall - 1)
        covers = np.zeros(layer.shape[1], np.float32)
        if blade >= 0.0:
            for column in range(layer.shape[1]):
                du, dv = places[0, row, column] - pivot_u, places[1, row, column] - pivot_v
                square = du * du + dv * dv
                width = np.float32(0.5 * BLADE_M) if square > inner else np.float32(0.5 * _ARM_M)
                is_there = (square < outer) & (du * to_u + dv * to_v > 0)
                part = min(max((width - abs(dv * to_u - du * to_v)) * thousand + half, zero), one)
                covers[column] = part if is_there else zero
        for column in range(layer.shape[1]):
            covered, spread = covers[column], wet[row, column]
            dirty = amount * dirt[row, column] if len(dirt) > 0 else zero
            if dirty + spread + covered <= 0:
                continue
            # The film, and dirt in front of it, spread the light of what is around.
            i = min(max(int((np.float32(column - margin) + half) * across), 0), wide - 1)
            cell, spreads = layer[row, column], blurred[j, i]
            # The blade is all that drops under it refract.
            open_share, clean = one - covered, one - dirty
            around, black = (one - cell[3]) * open_share * spread, covered * np.float32(_BLADE_LIGHT)
            light = open_share * cell[0] + black + around * (near * spreads[0] + far_red)
            cell[0] = light * clean + dirty * red
            light = open_share * cell[1] + black + around * (near * spreads[1] + far_green)
            cell[1] = light * clean + dirty * green
            light = open_share * cell[2] + black + around * (near * spreads[2] + far_blue)
            cell[2] = light * clean + dirty * blue
            cell[3] = one - (one - cell[3]) * open_share * (one - spread) * clean


def _blurred(layer: Float32[np.ndarray, "h w 4"], radii: Float64[np.ndarray, " h"]) -> Float32[np.ndarray, "h w 4"]:
    """Average over disks, with the radius of each row in cells; not at the sides of the layer, a radius wide."""
    sums = np.empty((layer.shape[0], 4 * (layer.shape[1] + 1)))  # of the cells to the left, four channels each
    made = np.zeros(layer.shape, np.float32)
    _sum_rows(layer, sums)
    _blur(layer, sums, radii, made)
    return made


@kernel(parallel=True)
@no_type_check
def _sum_rows(portion, layer, sums):
    width = 4 * layer.shape[1]
    for row in range_of(portion, len(layer)):
        total = np.zeros(4)
        for column in range(layer.shape[1]):
            for channel in range(4):
                sums[row, 4 * column + channel] = total[channel]
                total[channel] += layer[row, column, channel]
        sums[row, width:] = total


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _blur(portion, layer, sums, radii, made):
    rows, width = layer.shape[0], 4 * layer.shape[1]
    flat, flat_made = layer.reshape(rows, width), made.reshape(rows, width)
    for row in range_of(portion, rows):
        radius = max(0.5, radii[row])
        reach = int(np.ceil(radius))
        area = 0.0
        for part in range(2):  # the area of the disk, then the sums over its rows
            for k in range(-reach, reach + 1):
                # Mean half chord over the height of the cell, of the part that has one.
                top, bottom = min(k + 0.5, radius), max(k - 0.5, -radius)
                if top <= bottom:
                    continue
                middle = 0.5 * (top + bottom)
                half = np.sqrt(max(0.0, radius * radius - middle * middle))
                if part == 0:
                    area += 2.0 * half * (top - bottom)
                    continue
                # The chord begins and ends within cells that are so far to the left and right.
                i, j = int(np.floor(0.5 - half)), int(np.floor(0.5 + half))
                left, right = np.float32(0.5 - half - i), np.float32(0.5 + half - j)
                weight = (top - bottom) / area
                first, last, other = 4 * max(-i, 0), width - 4 * max(j, 0), min(max(row + k, 0), rows - 1)
                _add_chord(
                    flat_made[row, first:last], sums[other, first + 4 * j : last + 4 * j],
                    flat[other, first + 4 * j : last + 4 * j], right, sums[other, first + 4 * i : last + 4 * i],
                    flat[other, first + 4 * i : last + 4 * i], left, weight,
                )  # fmt: skip


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _add_chord(made, sums_to, to, right, sums_from, start, left, weight):
    for n in range(len(made)):
        made[n] += weight * (sums_to[n] - sums_from[n] + (right * to[n] - left * start[n]))


_BANDS = 8  # between rows of cells, which a thread composites one after the other


@kernel(parallel=True, error_model="numpy", fastmath=_FAST)
@no_type_check
def _composite(portion, image, layer, cell, margin, made):
    """I (1 - c) + L, with the layer interpolated between the centers of its cells; cells have 1, 2, 4... pixels."""
    height, values = image.shape[0], 3 * image.shape[1]
    bands = layer.shape[0] - 2 * margin + 1
    for part in range_of(portion, (bands + _BANDS - 1) // _BANDS):
        # Light, and the share of what is behind the glass, of each value of a row of pixels in the centers of a row of
        # cells, of the next one, and their differences.
        upper, upper_share = np.empty(values, np.float32), np.empty(values, np.float32)
        lower, lower_share = np.empty(values, np.float32), np.empty(values, np.float32)
        linear, row = np.empty(values, np.float32), margin - 1 + part * _BANDS
        covered = _fill_row(layer[row], cell, margin, lower, lower_share)
        for band in range(part * _BANDS, min((part + 1) * _BANDS, bands)):
            row = margin - 1 + band
            first, before = cell * (row - margin) + cell // 2, covered
            upper, upper_share, lower, lower_share = lower, lower_share, upper, upper_share
            covered = _fill_row(layer[row + 1], cell, margin, lower, lower_share)
            more, more_share = lower - upper, lower_share - upper_share
            for y in range(max(first, 0), min(first + cell, height)):
                pixels, target = image[y].reshape(values), made[y].reshape(values)
                if max(covered, before) < np.float32(1e-4):
                    target[:] = pixels
                else:
                    below = np.float32((y + 0.5) / cell - 0.5 + margin - row)
                    _to_linear(pixels, linear)
                    _composite_row(linear, upper, upper_share, more, more_share, below, target)


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _fill_row(cells, cell, margin, light, share):
    """Interpolate a row of the layer for each value of a row of pixels; returns the largest coverage."""
    width, step = len(light) // 3, np.float32(1 / cell)
    nearest = np.float32(0.5 / cell if cell > 1 else 0.0)  # from a cell's center to the first pixel after it, in cells
    covered = np.float32(0)
    for column in range(margin - 1, len(cells) - margin):
        # Pixels between the centers of two cells.
        first = cell * (column - margin) + cell // 2
        start, end = max(first, 0), min(first + cell, width)
        red, green, blue, cover = cells[column, 0], cells[column, 1], cells[column, 2], cells[column, 3]
        more_red, more_green = cells[column + 1, 0] - red, cells[column + 1, 1] - green
        more_blue, more = cells[column + 1, 2] - blue, cells[column + 1, 3] - cover
        covered = max(covered, cover, cover + more)
        for x in range(start, end):
            right, i = nearest + step * np.float32(x - first), np.uint32(3 * x)
            j, k = i + np.uint32(1), i + np.uint32(2)
            light[i], light[j], light[k] = red + right * more_red, green + right * more_green, blue + right * more_blue
            behind = np.float32(1) - (cover + right * more)
            share[i] = share[j] = share[k] = behind
    return covered


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _to_linear(levels, linear):
    """Linear light of sRGB levels, to 0.13 levels, by a polynomial (least squares) instead of a table.

    LLVM vectorizes it. The polynomial is for levels above 10.
    """
    for i in range(len(levels)):
        level = np.float32(levels[i])
        p = np.float32(-2.729071e-11) * level + np.float32(3.159277e-08)
        p = p * level + np.float32(8.642195e-06)
        p = p * level + np.float32(1.101198e-04)
        p = p * level + np.float32(1.063604e-03)
        straight = level * np.float32(1 / (255 * 12.92))
        linear[i] = p if straight > np.float32(10.5 / (255 * 12.92)) else straight  # slower if integers are compared


@kernel(error_model="numpy", fastmath=_FAST)
@no_type_check
def _composite_row(behind, light, share, more_light, more_share, below, target):
    """Composite linear light of a row of pixels, and convert it to sRGB levels, as `_to_linear`.

    The polynomial is for levels of the root of light above the knee. Two loops take less time than one of both.
    """
    for i in range(len(behind)):
        seen = behind[i] * (share[i] + below * more_share[i]) + (light[i] + below * more_light[i])
        seen = min(max(seen, np.float32(0)), np.float32(1))
        root = np.sqrt(seen)
        q = np.float32(131.8966) * root + np.float32(-413.9965)
        q = q * root + np.float32(518.0257)
        q = q * root + np.float32(-357.6934)
        q = q * root + np.float32(387.0783)
        q = q * root + np.float32(-10.22797 + 0.5)
        rounded = q if seen > np.float32(0.0031308) else seen * np.float32(255 * 12.92) + np.float32(0.5)
        target[i] = np.uint8(np.int32(rounded))

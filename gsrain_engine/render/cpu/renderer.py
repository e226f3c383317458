"""CPU renderer: scene, rain and render modes without OpenGL."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int32, UInt8

from ...choices import RenderMode
from ...fast_math import FAST
from ...kernels import kernel, range_of
from ...malloc_tuning import tune_malloc
from ...rain.frame import RainFrame
from ...rain.lamp_light import LampLight, depth_of_share, light_in_picture, share_of_depth
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from ...water.mirror import LensMirror, Mirror
from ..images import layer_color, turbo_colors
from ..renderer import (
    FARTHEST_M,
    MAX_FRAGMENTS,
    MIN_WEIGHT,
    NEAREST_M,
    Color,
    Frame,
    PendingImage,
    RenderStatistics,
    timed,
)
from .backdrop import Backdrop, composite_over, draw_backdrop
from .block_cache import BlockCaches
from .compositing import (
    NO_SKY,
    Film,
    SkyLayer,
    add_light,
    composite,
    composite_in_rain,
    composite_wet,
    dim_by_medium,
    expected,
    film_of_splats,
    sky_layer,
)
from .projection import in_camera, project
from .splats import MIN_SCENE_CUT, TINT, TINT_SHARE, Splats, rotation_columns
from .tiles import TILE, TileLists, bin_into_tiles, log_alpha, nothing, walk_pixels, walk_tiles


class CpuRenderer:
    """Renders scene and rain into one image without OpenGL; byte-identical at any number of threads."""

    name = "cpu"
    draws_lenses = True

    def __init__(self) -> None:
        tune_malloc()
        self.statistics = RenderStatistics()
        self._caches = BlockCaches()
        self._frame: Frame | None = None
        self.checkpoint: Callable[[], None] = lambda: None
        """Called before each stage of a picture; what it raises ends the drawing."""

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        mirror: Mirror | LensMirror | None = None,
    ) -> None:
        stages = {"project": 0.0, "sort": 0.0, "draw": 0.0}
        self.statistics = RenderStatistics(sum(part.drawn_count for part in parts), stages_ms=stages)
        self.checkpoint()
        falling, lit, medium = list[DrawItem](), None, None
        if rain is not None and mode == "splats":
            falling, lit, medium = self._falling(rain), rain.lamp_light if rain.is_linear else None, rain.medium
        with timed(stages, "project"):
            flags = [*[None] * len(parts), *(np.ones(each.drawn_count, np.bool_) for each in falling)]
            held = range(len(parts), len(parts) + (rain is not None and len(rain.lit_streaks) > 0)) if falling else ()
            splats = project(
                [*parts, *falling], camera, flags, as_points=mode == "points", caches=self._caches, held=held
            )
            self._caches.release_unused()
            splats = _color_by_mode(mode, splats, parts, camera)
        if rain is not None and medium is not None:
            with timed(stages, "medium"):
                dim_by_medium(splats, camera, medium, is_linear=rain.is_linear)
        self.checkpoint()
        with timed(stages, "sort"):
            order = splats.nearest_first()
            tiles = bin_into_tiles(splats.shapes, order, camera.width, camera.height)
        self.checkpoint()
        with timed(stages, "draw"):
            sky = sky_layer(medium, camera) if medium is not None else NO_SKY
            film = None if mirror is None else Film.on(film_of_splats(splats, parts), tiles)
            if rain is not None and lit is not None:
                self._frame = _draw_lit(
                    splats, tiles, camera, rain, lit, sky, film, has_drops=bool(falling), with_depth=with_depth
                )
            elif rain is not None and falling and rain.is_linear:
                rgba, weighted, weight = composite_in_rain(
                    splats.shapes, splats.colors, rain.light_linear, tiles, sky, film=film
                )
                depth = partial(expected, weighted, weight, MIN_WEIGHT)
                self._frame = Frame(rgba, depth() if with_depth else None, rough_depth=depth)
            else:
                if rain is None or not falling:
                    self._frame = _draw_mode(mode, splats, tiles, film, with_depth=with_depth)
                else:
                    self._frame = _draw_behind_veil(splats, order, tiles, rain, film, with_depth=with_depth)
                _add_sky(self._frame.rgba, sky)
            if mirror is not None and film is not None:
                add_light(self._frame.rgba, mirror.reflected(film.visible))
            if camera.lens is not None:
                self._frame = _within_lens(self._frame, camera)
        self.statistics.splats_drawn = len(order)

    def _falling(self, rain: RainFrame) -> list[DrawItem]:
        """Streaks, and haze with splashes."""
        with timed(self.statistics.stages_ms, "streaks"):
            found = [DrawItem(each, np.eye(4)) for each in (rain.lit_streaks, rain.drawn_haze) if len(each)]
            self.statistics.drops_drawn, self.statistics.haze_drawn = len(rain.drops.numbers), len(rain.haze)
        return found

    def draw_backdrop(self, parts: Sequence[DrawItem], camera: Camera, rain: RainFrame | None) -> Backdrop:
        """Draw what stands still of a scene, for any number of pictures by `draw_over`."""
        self.checkpoint()
        backdrop = draw_backdrop(parts, camera, None if rain is None else rain.medium, self.checkpoint, self._caches)
        self._caches.release_unused()
        return backdrop

    def draw_over(
        self,
        backdrop: Backdrop,
        moving: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None,
        mirror: Mirror | None = None,
    ) -> None:
        """Draw what moves, and rain that adds its light in linear light, over the backdrop of the rest."""
        stages = {"project": 0.0, "sort": 0.0, "draw": 0.0}
        count = backdrop.gaussians + sum(part.drawn_count for part in moving)
        self.statistics = RenderStatistics(count, stages_ms=stages)
        self.checkpoint()
        falling = list[DrawItem]() if rain is None else self._falling(rain)
        with timed(stages, "project"):
            flags = [*[None] * len(moving), *(np.ones(len(each.gaussians), np.bool_) for each in falling)]
            splats = project([*moving, *falling], camera, flags, caches=self._caches)
            if moving and rain is not None and rain.medium is not None:
                dim_by_medium(splats, camera, rain.medium, is_linear=True)
        with timed(stages, "sort"):
            order = splats.nearest_first()
            tiles = bin_into_tiles(splats.shapes, order, camera.width, camera.height)
        self.checkpoint()
        with timed(stages, "draw"):
            light = np.zeros(3, np.float32) if rain is None else rain.light_linear
            rgba, visible = composite_over(splats, tiles, light, backdrop)
            if mirror is not None:
                add_light(rgba, mirror.reflected(visible))
            self._frame = Frame(rgba, rough_depth=lambda: backdrop.depth)
        self.statistics.splats_drawn = len(order)

    def release_scenes(self) -> None:
        """Free what is kept of scenes that are mapped from files."""
        self._caches = BlockCaches()

    def read(self) -> Frame:
        assert self._frame is not None, "draw before reading the picture"
        return self._frame

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        return self.read().to_uint8(background)

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        return partial(self.read().to_uint8, background)


# Drawing


def _draw_mode(mode: RenderMode, splats: Splats, tiles: TileLists, film: Film | None, *, with_depth: bool) -> Frame:
    """Draw a scene without rain; depth is blended from all splats, in any render mode."""
    depth, rough_depth = None, None
    rgba = np.empty((tiles.height, tiles.width, 4), np.float32)
    if with_depth or mode not in ("ellipsoids", "overdraw"):
        rgba, weighted = _composite_dry(splats.shapes, splats.colors, tiles, film)
        rough_depth = partial(expected, weighted, rgba[..., 3].copy(), MIN_WEIGHT)
        depth = rough_depth() if with_depth or mode == "depth" else None
    if mode == "ellipsoids":
        _cover(tiles, splats.shapes, splats.colors, rgba)
    elif mode == "overdraw":
        counts = np.empty((tiles.height, tiles.width), np.float32)
        _count(tiles, splats.shapes, counts)
        rgba = _heat_where(counts / np.float32(MAX_FRAGMENTS), counts > 0)
    elif mode == "depth" and depth is not None:
        t = np.log(np.maximum(depth, np.float32(1e-9)) / NEAREST_M) / np.log(FARTHEST_M / NEAREST_M)
        rgba = _heat_where(t.astype(np.float32), depth > 0)
    return Frame(rgba, depth, rough_depth=rough_depth)


def _draw_lit(
    splats: Splats,
    tiles: TileLists,
    camera: Camera,
    rain: RainFrame,
    lit: LampLight,
    sky: SkyLayer,
    film: Film | None,
    *,
    has_drops: bool,
    with_depth: bool,
) -> Frame:
    """Draw scene and rain with the light of lamps; `sky` is the layer of the medium."""
    channels = splats.colors.copy()
    channels[:, 3] = share_of_depth(channels[:, 3])
    light: Float32[np.ndarray, "h w 3"] | None = None
    if has_drops:
        light = np.empty((tiles.height, tiles.width, 3), np.float32)
        rgba, shares, weight = composite_in_rain(splats.shapes, channels, rain.light_linear, tiles, sky, light, film)
    else:
        rgba, shares = _composite_dry(splats.shapes, channels, tiles, film)
        weight = rgba[..., 3].copy()
        _add_sky(rgba, sky)
    if len(sky.shares) > 0:
        medium = light_in_picture(lit, shares, weight, None if camera.lens is None else camera.rays)
        light = medium if light is None else np.add(light, medium, out=light)
    if light is not None:
        add_light(rgba, light)
    if not with_depth:
        return Frame(rgba, rough_depth=lambda: depth_of_share(expected(shares, weight, MIN_WEIGHT)))
    if has_drops:
        _, weighted, weight = composite_in_rain(splats.shapes, splats.colors, rain.light_linear, tiles)
    else:
        _, weighted = composite(splats.shapes, splats.colors, tiles)
    return Frame(rgba, expected(weighted, weight, MIN_WEIGHT))


def _add_sky(rgba: Float32[np.ndarray, "h w 4"], sky: SkyLayer) -> None:
    if len(sky.shares) > 0:
        rgba += (1 - rgba[..., 3:]) * sky.rgba


def _composite_dry(
    shapes: Float32[np.ndarray, "m 8"], channels: Float32[np.ndarray, "m 4"], tiles: TileLists, film: Film | None
) -> tuple[Float32[np.ndarray, "h w 4"], Float32[np.ndarray, "h w"]]:
    """Blend a scene without drops: the image, and its fourth channel."""
    return composite(shapes, channels, tiles) if film is None else composite_wet(shapes, channels, tiles, film)


def _within_lens(frame: Frame, camera: Camera) -> Frame:
    """Leave pixels empty that no ray comes to."""
    is_imaged = camera.rays.is_imaged
    if is_imaged.all():
        return frame
    frame.rgba[~is_imaged] = 0
    depth = None if frame.depth is None else np.where(is_imaged, frame.depth, np.float32(0))
    return replace(frame, depth=depth)


def _draw_behind_veil(
    splats: Splats,
    order: Int32[np.ndarray, " drawn"],
    tiles: TileLists,
    rain: RainFrame,
    film: Film | None,
    *,
    with_depth: bool,
) -> Frame:
    """Draw scene and rain, which is blended as a display color (the paper's form); `tiles` have that order."""
    rgba, _ = composite(splats.shapes, splats.colors, tiles, veil=rain.color.astype(np.float32))
    if not with_depth and film is None:
        return Frame(rgba)
    is_rain = splats.shapes[order, 6] < MIN_SCENE_CUT
    alone = bin_into_tiles(splats.shapes, order[~is_rain], tiles.width, tiles.height)
    clear = _draw_mode("splats", splats, alone, film, with_depth=with_depth)
    return Frame(rgba, clear.depth)


def _heat_where(numbers: Float32[np.ndarray, "h w"], there: np.ndarray) -> Float32[np.ndarray, "h w 4"]:
    return np.where(there[..., None], np.dstack([turbo_colors(numbers), np.ones_like(numbers)]), np.float32(0))


# Render modes by color


def _color_by_mode(mode: RenderMode, splats: Splats, parts: Sequence[DrawItem], camera: Camera) -> Splats:
    """Color the splats of `parts` by their normals, opacity or layer; other render modes leave them unchanged.

    Selected splats are tinted here, too.
    """
    if mode not in ("normals", "opacity", "layers"):
        return splats
    colors = splats.colors.copy()
    drawn = np.flatnonzero(colors[:, 3])
    ends = np.cumsum([0, *(len(part.gaussians) for part in parts)])
    bounds = np.searchsorted(splats.indices[drawn], ends)
    for number, part in enumerate(parts):
        g, rows = part.gaussians, drawn[bounds[number] : bounds[number + 1]]
        members = splats.indices[rows] - ends[number]
        if mode == "normals":
            to_world = np.ascontiguousarray(part.to_world, np.float64)
            _normal_colors(rows, members, g.means, g.scales, g.quaternions, to_world, camera.position, colors)
        elif mode == "opacity":
            colors[rows, :3] = turbo_colors(g.opacities[members] * np.float32(part.opacity))
        else:
            colors[rows, :3] = layer_color(number)
        if part.selected is not None:
            tinted = rows[part.selected.flags[members]]
            colors[tinted, :3] += np.float32(TINT_SHARE) * (np.array(TINT, np.float32) - colors[tinted, :3])
    return replace(splats, colors=colors)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _normal_colors(portion, rows, members, means, scales, quaternions, to_world, eye, colors):
    """Write 0.5 + 0.5 n of each Gaussian's shortest axis n in the world, facing the eye, to `rows` of `colors`."""
    for n in range_of(portion, len(rows)):
        i = members[n]
        q = quaternions[i]
        axes = rotation_columns(np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))
        if scales[i, 0] <= scales[i, 1] and scales[i, 0] <= scales[i, 2]:
            a, b, c = axes[0]
        else:
            a, b, c = axes[1] if scales[i, 1] <= scales[i, 2] else axes[2]
        mean = in_camera(to_world, means[i])
        length = facing = 0.0
        for k in range(3):
            normal = to_world[k, 0] * a + to_world[k, 1] * b + to_world[k, 2] * c
            facing += normal * (mean[k] - eye[k])
            length += normal * normal
        half = (-0.5 if facing > 0 else 0.5) / max(np.sqrt(length), 1e-300)
        for k in range(3):
            normal = to_world[k, 0] * a + to_world[k, 1] * b + to_world[k, 2] * c
            colors[rows[n], k] = 0.5 + half * normal


# Overdraw and ellipsoids

SURFACE_ALPHA = 1 / 4  # alpha on the surface of a Gaussian's ellipsoid
_LOG_SURFACE_ALPHA = np.float32(np.log(SURFACE_ALPHA))


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _count(portion, tiles, shapes, counts):
    """Count the splats per pixel whose alpha is not below their cut, including those behind opaque ones."""
    walk_tiles(portion, tiles, shapes, shapes[:0, :0], 2, 0, nothing, _count_splat, _store_counts, counts)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _count_splat(shapes, channels, j, x, y, state, lanes, k, counts):
    walk_pixels(shapes[j], x, y, state, lanes, _count_pixel, ())


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _count_pixel(line, v, dx, dy, falloff, lanes, data):
    line[v + TILE] += np.float32(1) if log_alpha(dx, dy, falloff) >= falloff[3] else np.float32(0)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_counts(state, x0, y0, counts):
    height, width = counts.shape
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            counts[y0 + v, x0 + u] = state[u, TILE + v]


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _cover(portion, tiles, shapes, colors, rgba):
    """Color each pixel by the nearest splat whose alpha there is at least `SURFACE_ALPHA`, with an alpha of 1.

    Shaded like a ball: full color in the middle, half of it at the rim.
    """
    walk_tiles(portion, tiles, shapes, colors, 4, 0, nothing, _cover_splat, _store_covers, rgba)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _cover_splat(shapes, colors, j, x, y, state, lanes, k, rgba):
    by_height = 1 / (shapes[j, 5] - _LOG_SURFACE_ALPHA)
    walk_pixels(shapes[j], x, y, state, lanes, _cover_pixel, (by_height, colors[j, 0], colors[j, 1], colors[j, 2]))


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _cover_pixel(line, v, dx, dy, falloff, lanes, data):
    sharpness_x, sharpness_y, log_opacity, _ = falloff
    by_height, red, green, blue = data
    power = sharpness_y * dy * dy + sharpness_x * dx * dx
    is_hit = line[v] > 0 and log_opacity + power >= _LOG_SURFACE_ALPHA
    shade = np.float32(0.5) + np.float32(0.5) * np.sqrt(max(1 + power * by_height, np.float32(0)))
    line[v] = np.float32(0) if is_hit else line[v]
    line[v + TILE] = red * shade if is_hit else line[v + TILE]
    line[v + 2 * TILE] = green * shade if is_hit else line[v + 2 * TILE]
    line[v + 3 * TILE] = blue * shade if is_hit else line[v + 3 * TILE]


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _store_covers(state, x0, y0, rgba):
    height, width = rgba.shape[:2]
    for v in range(min(TILE, height - y0)):
        for u in range(min(TILE, width - x0)):
            for channel in range(3):
                rgba[y0 + v, x0 + u, channel] = state[u, (1 + channel) * TILE + v]
            rgba[y0 + v, x0 + u, 3] = 1 - state[u, v]

"""Mirror of wet ground: a camera below it, and the light that films and standing water reflect into each pixel.

Ground at a height is a level mirror. A camera mirrored in it draws what it reflects, and waves of the water blur that:
facets that tilt by d turn a reflected ray by 2 d. Facets that face the camera cover more of its view, so that
reflections also move up on the reflected objects, the more the flatter the view is.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64

from ..kernels import kernel, range_of
from ..rain.settings import RainSettings
from ..scene.camera import Camera
from ..scene.ground_water import FILM_SLOPE, STANDING_SLOPE
from ..scene.lamps import LitLamps
from ..scene.lens_faces import LensFace
from ..scene.water_surface import WATER_INDEX, reflectance, unshadowed
from .films import WaterDepth
from .leveled_ground import LeveledView
from .rings import RingField, RingWaves, ring_slope

SCALES = 0.5, 0.25
"""Width and height of the mirror image relative to the picture: rough water blurs much more along its columns."""
SLOPES = FILM_SLOPE, STANDING_SLOPE
_MIN_HEIGHT_M = 0.05  # of a camera over the ground
_ANGLES = 128  # of the tables over the viewing angle
_FOOTPRINT_PX = np.float32(0.4)  # standard deviation of a pixel of the mirror image
_TAPS = np.exp(-0.5 * (0.9 * np.arange(-2, 3)) ** 2).astype(np.float32)
_TILTS = 97
_MIN_SINE = np.float32(2e-3)  # of a ray's angle to the ground; others pass over it
_LAMP_REACH = 4.0  # of a lamp's image, in standard deviations of the slope
_LAMP_M = 0.2  # radius of a lamp, by which the shadows of its light are soft
_BEHIND_M, _BEHIND = 0.5, 0.02  # by which a lamp's light is behind what blocks it: a length, and a share of its depth
_SHADOW_STEPS = 12
_VISIBLE = 4e-4  # light from which what hides its lamp is looked for: about a level in the dark, under a full film


def rows_of_ground(camera: Camera) -> tuple[int, int]:
    """First and past-the-last row of a mirror image with rays to level ground; two equal ones without any."""
    height = max(int(np.ceil(SCALES[1] * camera.height)), 1)
    turn = camera.camera_to_world[2, :3]
    y = ((np.arange(height)[:, None] + 0.5) / SCALES[1] - camera.cy) / camera.fy
    x = (np.array([0.0, camera.width]) - camera.cx) / camera.fx
    found = np.flatnonzero((turn[0] * x + turn[1] * y + turn[2] < 0).any(axis=1))
    return (int(found[0]), int(found[-1]) + 1) if len(found) else (0, 0)


def has_mirror(view: LeveledView, wetness: float, standing: tuple[float, float]) -> bool:
    """Return whether wet ground reflects anything into a camera; `standing` is the `standing_water` of that time."""
    if wetness <= 0 and min(standing) <= 0:
        return False
    first, last = rows_of_ground(view.camera)
    return last > first and bool(view.camera.position[2] > view.ground_m + _MIN_HEIGHT_M)


def standing_water(rain: RainSettings, depth: WaterDepth, wetness: float) -> tuple[float, float]:
    """Share of the area of dips that is under water, and how wet it is: as wet as can be, or as is set by hand."""
    return depth.filled, 1.0 if rain.wetness is None else wetness


def mirrored_camera(camera: Camera, ground_m: float) -> Camera:
    """Camera that sees what level ground at a height reflects into another, rows from bottom to top.

    The reflection of the world in the ground, and a flip of the camera's y axis, so that the pose is a rotation. It has
    the `rows_of_ground` only, of which there must be one.
    """
    reflection, flip = np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
    reflection[2, 3] = 2 * ground_m
    first, last = rows_of_ground(camera)
    across, along = SCALES
    return replace(
        camera,
        width=max(int(np.ceil(across * camera.width)), 1),
        height=last - first,
        fx=across * camera.fx,
        fy=along * camera.fy,
        cx=across * camera.cx,
        cy=last - along * camera.cy,
        world_to_camera=flip @ camera.world_to_camera @ reflection,
    )


@lru_cache(maxsize=8)
def facet_table(slope: float) -> Float32[np.ndarray, "angles 3"]:
    """Table of `facet_rows` for water that is equally rough at all angles."""
    return facet_rows(np.full(_ANGLES, slope))


def facet_rows(slopes: Float64[np.ndarray, " angles"]) -> Float32[np.ndarray, "angles 3"]:
    """Share of light that rough water reflects, and mean and standard deviation of the tilt of facets that do.

    By sine of the viewing angle to the ground, 0 to 1 in equal steps of its square root, with a standard deviation of
    slope for each. Facets tilt along the line of sight, with Gaussian slopes, weighted by visible area, Fresnel's law
    and Smith's shadowing of the reflected ray. A ray that goes down again meets the ground, and is lost.
    """
    table = np.empty((_ANGLES, 3), np.float32)
    _fill_facets(slopes, table)
    return table


@kernel(error_model="numpy")
@no_type_check
def _fill_facets(slopes, table):
    for row in range(len(slopes)):
        root = row / (len(slopes) - 1)
        view, slope = np.arcsin(max(root * root, 1e-4)), slopes[row]
        visible = gained = first = second = 0.0
        for k in range(_TILTS):
            steepness = 3.5 * (2 * k / (_TILTS - 1) - 1)
            tilt = np.arctan(slope * steepness)
            area = np.exp(-0.5 * steepness * steepness) / np.cos(tilt) * np.sin(view + tilt)
            if area <= 0:
                continue
            visible += area
            up = view + 2 * tilt
            if 0 < up < np.pi:
                gain = area * reflectance(np.sin(view + tilt), WATER_INDEX)
                gain *= unshadowed(np.sin(min(up, np.pi / 2)), slope)
                gained, first, second = gained + gain, first + gain * tilt, second + gain * tilt * tilt
        mean = first / gained
        table[row] = gained / visible, mean, np.sqrt(max(second / gained - mean * mean, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Mirror:
    """Light that water on the ground would reflect into one camera, if it covered all of it."""

    first_row: int
    """Row of the picture, at `SCALES`, of the first row of `light`; the ground is not visible above."""
    light: Float32[np.ndarray, "h w 2 3"]
    """Linear light at `SCALES`: that of films, and that of standing water; 0 above the horizon."""
    rings: "MirrorRings | None" = None
    """Rings that tilt the water, in which case `light` is that of films that are not flooded; None without any."""

    def reflected(self, film: Float32[np.ndarray, "h w 2"]) -> Float32[np.ndarray, "h w 3"]:
        """Linear light that the visible shares of films and standing water reflect, at the picture's size."""
        image = np.empty((*film.shape[:2], 3), np.float32)
        shares = np.ascontiguousarray(film)
        across, along = np.float32(SCALES[0]), np.float32(SCALES[1])
        if self.rings is None:
            _weigh(shares, self.light, self.first_row, across, along, image)
        else:
            _weigh_rings(shares, self.light, self.first_row, across, along, *self.rings, image)
        return image


@dataclass(frozen=True, slots=True, eq=False)
class LensMirror:
    """Light that water reflects into a camera with a lens: that of a wide pinhole picture, sampled."""

    mirror: Mirror
    """Of the face's camera."""
    face: LensFace

    def reflected(self, film: Float32[np.ndarray, "h w 2"]) -> Float32[np.ndarray, "h w 3"]:
        """Linear light that the visible shares of films and standing water reflect; it is proportional to both."""
        camera, light = self.face.camera, np.zeros((*film.shape[:2], 3), np.float32)
        for water in range(2):
            full = np.zeros((camera.height, camera.width, 2), np.float32)
            full[..., water] = 1
            light += film[..., water, None] * self.face.sampled(self.mirror.reflected(full))
        light[~self.face.covered] = 0
        return light


class MirrorRings(NamedTuple):
    """Rings before one camera, as `Mirror.reflected` uses them."""

    flooded: float
    """Share of films on which rings run, as on standing water."""
    sines: Float32[np.ndarray, "h w"]
    ways: Float32[np.ndarray, "h w"]
    """Shares of the way beyond the ground, of each pixel of the mirror's light."""
    intrinsics: Float32[np.ndarray, "4"]
    """Of the mirror's light."""
    to_world: Float64[np.ndarray, "4 4"]
    above_m: float
    """Height of the camera over the ground."""
    on_films: RingField
    on_standing: RingField


def make_mirror(
    image_linear: Float32[np.ndarray, "h w 3"],
    depth: Float32[np.ndarray, "h w"],
    camera: Camera,
    ground_m: float,
    wetness: float,
    flooded: float = 0.0,
    lamps: LitLamps | None = None,
    extinction_per_m: float = 0.0,
    standing: tuple[float, float] | None = None,
    waves: RingWaves | None = None,
) -> Mirror:
    """Mirror of a camera from the picture and the depth (m, 0 where empty) of its `mirrored_camera`.

    Both have the first row on top, as drawn. A share `flooded` of the films is as smooth as standing water. Lamps are
    added as images of points, whose light the medium dims. Of `standing` water, the share of its area that is under
    water now, and its wetness (None: all, as wet as films). Rings of `waves` tilt the water.
    """
    image, depth = image_linear[::-1], depth[::-1]
    height, width = depth.shape
    sines, distances, shares = (np.empty((height, width), np.float32) for _ in range(3))
    to_world = camera.camera_to_world
    first_row = rows_of_ground(camera)[0]
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy]) * (*SCALES, *SCALES) - (0, 0, 0, first_row)
    above_m = float(to_world[2, 3]) - ground_m
    _geometry(depth, to_world[:3, :3], intrinsics, above_m, sines, distances, shares)
    columns, light = (np.zeros((height, width, 2, 3), np.float32) for _ in range(2))
    slopes = np.tile(np.array(SLOPES)[:, None], _ANGLES)
    tables = np.stack([facet_table(slope) for slope in SLOPES])
    if waves is not None:
        angles = np.arcsin(np.maximum(np.linspace(0, 1, _ANGLES) ** 2, 1e-4))
        slopes[1] = waves.slopes_along(above_m / np.tan(angles))
        tables[1] = facet_rows(slopes[1])
    fx, fy, _, cy = intrinsics.astype(np.float32)
    _blur_columns(np.ascontiguousarray(image), sines, shares, tables, fy, cy, columns)
    _fill_rows(sines, columns)
    _fill_columns(columns)
    _blur_rows(columns, sines, shares, slopes.astype(np.float32), fx, light)
    if lamps is not None and len(lamps.positions_m):
        rows = _lamp_rows(lamps.brightest(camera.position))
        _add_lamps(light, sines, distances, depth, to_world, intrinsics, rows, slopes, ground_m, extinction_per_m)
    films = light[:, :, 0] + np.float32(flooded) * (light[:, :, 1] - light[:, :, 0])
    filled, as_wet = standing or (1.0, wetness)
    if filled < 1:
        light[:, :, 1] += np.float32(1 - filled) * (np.float32(wetness / as_wet) * films - light[:, :, 1])
    light[:, :, 1] *= np.float32(as_wet)
    if waves is None:
        light[:, :, 0] = np.float32(wetness) * films
        return Mirror(first_row, light)
    light[:, :, 0] *= np.float32(wetness)
    rings = MirrorRings(
        flooded, sines, shares, intrinsics.astype(np.float32), to_world, above_m, waves.on_films, waves.on_standing
    )
    return Mirror(first_row, light, rings)


# Geometry of pixels


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _geometry(portion, depth, turn, intrinsics, above_m, sines, distances, shares):
    """Write each pixel's sine of the angle to the ground, distance to it, and the share of the way beyond it."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    for row in range_of(portion, height):
        for column in range(width):
            x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
            length = np.sqrt(x * x + y * y + 1)
            sine = -(turn[2, 0] * x + turn[2, 1] * y + turn[2, 2]) / length
            sines[row, column] = sine
            distances[row, column] = above_m / sine if sine > _MIN_SINE else 0.0
            whole = depth[row, column] * length
            share = 1 - distances[row, column] / whole if whole > 0 else 1.0
            shares[row, column] = min(max(share, 0.0), 1.0)


# Blur


@kernel(parallel=True, error_model="numpy", fastmath={"reassoc", "contract", "arcp", "nsz"})
@no_type_check
def _blur_columns(portion, image, sines, shares, tables, fy, cy, light):
    """Integrate over facets that tilt along the line of sight: over the rows of the image above and below a pixel.

    A facet of tilt d reflects what is 2 d fy k rows away, k being the share of the way beyond the ground of what is
    visible there. (1 - t^2 / 16)^8 stands for the Gaussian exp(-t^2 / 2).
    """
    height, width = sines.shape
    one, last_angle = np.float32(1), np.float32(tables.shape[1] - 1)
    for column in range_of(portion, width):
        reds, greens, blues = np.empty(height, np.float32), np.empty(height, np.float32), np.empty(height, np.float32)
        ways, places = np.empty(height, np.float32), np.empty(height, np.float32)
        for row in range(height):
            reds[row], greens[row] = image[row, column, 0], image[row, column, 1]
            blues[row] = image[row, column, 2]
            ways[row], places[row] = shares[row, column], np.float32(row)
        top = 0
        while top < height and sines[top, column] <= _MIN_SINE:
            top += 1
        for row in range(top, height):
            slant = (np.float32(row) + np.float32(0.5) - cy) / fy
            scale = np.float32(2) * fy * (one + slant * slant)
            at = np.sqrt(min(max(np.float32(0), sines[row, column]), one)) * last_angle
            k = min(int(at), tables.shape[1] - 2)
            part = at - np.float32(k)
            # A film is smooth: every other row and column, which `_fill_films` interpolates.
            is_between = column % 2 == 1 or (row % 2 == 1 and row > top and row < height - 1)
            for water in range(1 if is_between else 0, 2):
                share_of_light = (one - part) * tables[water, k, 0] + part * tables[water, k + 1, 0]
                mean = scale * ((one - part) * tables[water, k, 1] + part * tables[water, k + 1, 1])
                spread = scale * ((one - part) * tables[water, k, 2] + part * tables[water, k + 1, 2])
                reach = np.float32(4) * (spread + _FOOTPRINT_PX) + one
                first = max(top, int(np.float32(row) - reach))
                last = min(height, int(np.float32(row) + mean + reach) + 1)
                red = green = blue = total = np.float32(0)
                here = places[row]
                for j in range(first, last):
                    beyond = ways[j]
                    away = places[j] - here - mean * beyond
                    by_variance = one / (spread * spread * beyond * beyond + _FOOTPRINT_PX * _FOOTPRINT_PX)
                    near = one - np.float32(1 / 16) * away * away * by_variance
                    near = near if near > 0 else np.float32(0)
                    near *= near
                    near *= near
                    weight = near * near * np.sqrt(by_variance)
                    red += weight * reds[j]
                    green += weight * greens[j]
                    blue += weight * blues[j]
                    total += weight
                gain = share_of_light / max(total, np.float32(1e-12))
                light[row, column, water, 0] = gain * red
                light[row, column, water, 1] = gain * green
                light[row, column, water, 2] = gain * blue


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill_rows(portion, sines, light):
    """Interpolate the light of films in the rows that `_blur_columns` leaves out, in every other column."""
    height, width = sines.shape
    half = np.float32(0.5)
    for place in range_of(portion, (width + 1) // 2):
        column = 2 * place
        for row in range(1, height - 1, 2):
            if sines[row - 1, column] > _MIN_SINE:
                for c in range(3):
                    light[row, column, 0, c] = half * (light[row - 1, column, 0, c] + light[row + 1, column, 0, c])


@kernel(parallel=True)
@no_type_check
def _fill_columns(portion, light):
    """Interpolate the light of films in the columns that `_blur_columns` leaves out."""
    height, width = light.shape[:2]
    half = np.float32(0.5)
    for row in range_of(portion, height):
        for column in range(1, width, 2):
            other = column + 1 if column + 1 < width else column - 1
            for c in range(3):
                light[row, column, 0, c] = half * (light[row, column - 1, 0, c] + light[row, other, 0, c])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _blur_rows(portion, light, sines, shares, slopes, fx, blurred):
    """Blur by facets that tilt across the line of sight, which turn a ray by 2 d times the sine of its angle."""
    height, width = sines.shape
    for row in range_of(portion, height):
        for column in range(width):
            at = np.sqrt(min(max(np.float32(0), sines[row, column]), np.float32(1))) * np.float32(slopes.shape[1] - 1)
            for water in range(2):
                across = np.float32(2) * slopes[water, int(at)] * sines[row, column] * fx * shares[row, column]
                reach = 2 if across > np.float32(0.4) else 0
                red = green = blue = total = np.float32(0)
                for tap in range(-reach, reach + 1):
                    offset = np.float32(0.9) * across * np.float32(tap)
                    u = min(max(int(np.floor(np.float32(column) + offset + np.float32(0.5))), 0), width - 1)
                    weight = _TAPS[tap + 2]
                    total += weight
                    red += weight * light[row, u, water, 0]
                    green += weight * light[row, u, water, 1]
                    blue += weight * light[row, u, water, 2]
                blurred[row, column, water, 0] = red / total
                blurred[row, column, water, 1] = green / total
                blurred[row, column, water, 2] = blue / total


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _weigh(portion, film, light, first_row, across, along, image):
    """Sum of the light of films and standing water, linear between pixels, times their visible shares."""
    height, width = film.shape[:2]
    rows, columns = light.shape[:2]
    one = np.float32(1)
    for row in range_of(portion, height):
        y = along * (np.float32(row) + np.float32(0.5)) - np.float32(0.5 + first_row)
        y = min(max(np.float32(0), y), np.float32(rows - 1))
        top = min(int(y), max(rows - 2, 0))
        v, bottom = y - np.float32(top), min(top + 1, rows - 1)
        for column in range(width):
            a, b = film[row, column, 0], film[row, column, 1]
            if a <= 0 and b <= 0:
                for c in range(3):
                    image[row, column, c] = 0
                continue
            x = across * (np.float32(column) + np.float32(0.5)) - np.float32(0.5)
            x = min(max(np.float32(0), x), np.float32(columns - 1))
            left = min(int(x), max(columns - 2, 0))
            u, right = x - np.float32(left), min(left + 1, columns - 1)
            red = green = blue = np.float32(0)
            for water in range(2):
                share = a if water == 0 else b
                if share <= 0:
                    continue
                w00, w01 = share * (one - v) * (one - u), share * (one - v) * u
                w10, w11 = share * v * (one - u), share * v * u
                first, second = light[top, left, water], light[top, right, water]
                third, fourth = light[bottom, left, water], light[bottom, right, water]
                red += w00 * first[0] + w01 * second[0] + w10 * third[0] + w11 * fourth[0]
                green += w00 * first[1] + w01 * second[1] + w10 * third[1] + w11 * fourth[1]
                blue += w00 * first[2] + w01 * second[2] + w10 * third[2] + w11 * fourth[2]
            image[row, column, 0], image[row, column, 1], image[row, column, 2] = red, green, blue


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _light_at(light, x, y, water, share):
    """Share of the light at a place of the mirror, linear between pixels."""
    rows, columns = light.shape[:2]
    one = np.float32(1)
    y = min(max(np.float32(0), y), np.float32(rows - 1))
    x = min(max(np.float32(0), x), np.float32(columns - 1))
    top, left = min(int(y), max(rows - 2, 0)), min(int(x), max(columns - 2, 0))
    v, u = y - np.float32(top), x - np.float32(left)
    bottom, right = min(top + 1, rows - 1), min(left + 1, columns - 1)
    w00, w01 = share * (one - v) * (one - u), share * (one - v) * u
    w10, w11 = share * v * (one - u), share * v * u
    first, second = light[top, left, water], light[top, right, water]
    third, fourth = light[bottom, left, water], light[bottom, right, water]
    return (
        w00 * first[0] + w01 * second[0] + w10 * third[0] + w11 * fourth[0],
        w00 * first[1] + w01 * second[1] + w10 * third[1] + w11 * fourth[1],
        w00 * first[2] + w01 * second[2] + w10 * third[2] + w11 * fourth[2],
    )


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _weigh_rings(
    portion,
    film,
    light,
    first_row,
    scale_x,
    scale_y,
    flooded,
    sines,
    ways,
    intrinsics,
    to_world,
    above_m,
    on_films,
    on_standing,
    image,
):
    """Sum as `_weigh` does, with standing water, and the flooded share of films, tilted by rings.

    A facet that tilts by t towards the eye reflects what is 2 t fy k rows further down, with the reflectance of its own
    angle; one that tilts sideways by t what is 2 t fx k times the sine of the viewing angle to the side.
    """
    height, width = film.shape[:2]
    fx, fy, cx, cy = intrinsics
    turn, eye_x, eye_y = to_world[:3, :3].astype(np.float32), to_world[0, 3], to_world[1, 3]
    rows, columns = light.shape[:2]
    one, half, two = np.float32(1), np.float32(0.5), np.float32(2)
    above, q = np.float32(above_m), np.float32(flooded)
    far = max(on_films.distance_m, on_standing.distance_m)
    steep = above / np.sqrt(np.float32(far * far) + above * above) if far > 0 else np.float32(2)
    for row in range_of(portion, height):
        y = scale_y * (np.float32(row) + half) - np.float32(0.5 + first_row)
        near_row = min(max(int(y + half), 0), rows - 1)
        v = (y + half - cy) / fy
        for column in range(width):
            thin, standing = film[row, column, 0], film[row, column, 1]
            if thin <= 0 and standing <= 0:
                for c in range(3):
                    image[row, column, c] = 0
                continue
            x = scale_x * (np.float32(column) + half) - half
            near_column = min(max(int(x + half), 0), columns - 1)
            sine = sines[near_row, near_column]
            red, green, blue = _light_at(light, x, y, 0, thin * (one - q))
            if sine < steep:
                r, g, b = _light_at(light, x, y, 1, thin * q + standing)
                image[row, column, 0], image[row, column, 1], image[row, column, 2] = red + r, green + g, blue + b
                continue
            u = (x + half - cx) / fx
            across = one / np.sqrt(u * u + v * v + one)
            ahead_x = (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2]) * across
            ahead_y = (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2]) * across
            sine = max(-(turn[2, 0] * u + turn[2, 1] * v + turn[2, 2]) * across, np.float32(1e-3))
            level = np.sqrt(max(one - sine * sine, np.float32(1e-6)))
            away = above / sine
            across_m = np.float32(_FOOTPRINT_PX) * scale_x * away / fx
            plain = np.float32(0)
            for water in range(2):
                share = standing if water == 1 else thin * q
                field = on_standing if water == 1 else on_films
                fade = (np.float32(field.distance_m) - away * level) * np.float32(field.per_fade_m)
                if share < np.float32(1 / 64) or fade <= 0:
                    plain += share
                    continue
                tilt, aside = ring_slope(
                    eye_x + away * ahead_x, eye_y + away * ahead_y, ahead_x / level, ahead_y / level, across_m / sine,
                    across_m, field.corner_m, field.starts, field.members, field.centers_m, field.radii_m, field.slopes,
                )  # fmt: skip
                if tilt == 0 and aside == 0:
                    plain += share
                    continue
                fade = min(fade, one)
                fade *= fade * (np.float32(3) - two * fade)
                way = two * ways[near_row, near_column] * fade
                lower, aside_x = y + tilt * way * fy * (one + v * v), x + aside * way * fx * sine
                bounded = min(max(np.float32(0), lower), np.float32(rows - 1))
                upper_row = min(int(bounded), max(rows - 2, 0))
                upper, lower_row = sines[upper_row, near_column], min(upper_row + 1, rows - 1)
                there = upper + (bounded - np.float32(upper_row)) * (sines[lower_row, near_column] - upper)
                # sin(v + t) for a small t
                facing = min(max(sine + fade * tilt * level, np.float32(1e-3)), one)
                gain = reflectance(facing, WATER_INDEX) / reflectance(
                    min(max(there, np.float32(1e-3)), one), WATER_INDEX
                )
                r, g, b = _light_at(light, aside_x, lower, 1, share * np.float32(min(gain, 4.0)))
                red, green, blue = red + r, green + g, blue + b
            r, g, b = _light_at(light, x, y, 1, plain)
            image[row, column, 0], image[row, column, 1], image[row, column, 2] = red + r, green + g, blue + b


# Lamps


def _lamp_rows(lamps: LitLamps) -> Float64[np.ndarray, "n 11"]:
    """Position, axis, intensity, cosines of the cone where light ends and is full."""
    return np.column_stack([lamps.positions_m, lamps.directions, lamps.intensities, lamps.cos_outer, lamps.cos_inner])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _add_lamps(
    portion, light, sines, distances, depth, to_world, intrinsics, lamps, slopes, ground_m, extinction_per_m
):
    """Add the light of lamps that rough water reflects: F D G / (4 cos v) times the irradiance.

    The model of Cook and Torrance (1982) with Gaussian slopes (Beckmann 1963). The lamp is a point, so that no image of
    it has to be blurred; what the mirror image shows in front of it hides it.
    """
    height, width = sines.shape
    fx, fy, cx, cy = intrinsics
    for row in range_of(portion, height):
        for column in range(width):
            sine = np.float64(sines[row, column])
            if sine <= _MIN_SINE:
                continue
            x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
            scale = 1 / np.sqrt(x * x + y * y + 1)
            angle = int(np.sqrt(min(1.0, sine)) * (slopes.shape[1] - 1))
            away = np.float64(distances[row, column])
            dx = (to_world[0, 0] * x + to_world[0, 1] * y + to_world[0, 2]) * scale
            dy = (to_world[1, 0] * x + to_world[1, 1] * y + to_world[1, 2]) * scale
            px, py = to_world[0, 3] + away * dx, to_world[1, 3] + away * dy
            for i in range(len(lamps)):
                lx, ly, lz = lamps[i, 0] - px, lamps[i, 1] - py, lamps[i, 2] - ground_m
                if lz <= 0:
                    continue
                length = np.sqrt(lx * lx + ly * ly + lz * lz)
                lx, ly, lz = lx / length, ly / length, lz / length
                hx, hy, hz = lx - dx, ly - dy, lz + sine
                squared = (hx * hx + hy * hy) / (hz * hz)
                if squared > (_LAMP_REACH * slopes[0, angle]) ** 2:
                    continue
                cosine = -(lamps[i, 3] * lx + lamps[i, 4] * ly + lamps[i, 5] * lz)
                cone = (cosine - lamps[i, 9]) / max(lamps[i, 10] - lamps[i, 9], 1e-6)
                cone = min(max(cone, 0.0), 1.0)
                cone *= cone * (3 - 2 * cone)
                if cone <= 0:
                    continue
                norm = np.sqrt(hx * hx + hy * hy + hz * hz)
                facing = min((hx * lx + hy * ly + hz * lz) / norm, 1.0)
                upright = hz / norm
                dimmed = cone * np.exp(-extinction_per_m * (away + length)) / (length * length)
                open_share = -1.0  # of the lamp: not yet known
                for water in range(2):
                    slope = slopes[water, angle]
                    if squared > (_LAMP_REACH * slope) ** 2:
                        continue
                    density = np.exp(-0.5 * squared / (slope * slope)) / (2 * np.pi * slope * slope * upright**4)
                    shadowed = unshadowed(sine, slope) * unshadowed(lz, slope)
                    gain = dimmed * reflectance(facing, WATER_INDEX) * density * shadowed / (4 * sine)
                    if gain * max(lamps[i, 6], lamps[i, 7], lamps[i, 8]) > _VISIBLE:
                        if open_share < 0:
                            z = away * scale
                            open_share = _open_share(depth, row, column, z, lamps[i], ground_m, to_world, intrinsics)
                        gain *= open_share
                    for c in range(3):
                        light[row, column, water, c] += np.float32(gain * lamps[i, 6 + c])


@kernel(error_model="numpy")
@no_type_check
def _open_share(depth, row, column, z, lamp, ground_m, to_world, intrinsics):
    """Share of a lamp that a point of the ground sees, by depth z in the camera, past what the mirror image shows.

    The way from the point to the mirrored lamp is a line in the mirror image; it is blocked where it is behind what is
    visible there. Three ways, to the middle and the sides of the lamp, soften the edges of shadows.
    """
    fx, fy, cx, cy = intrinsics
    x, y, height = lamp[0] - to_world[0, 3], lamp[1] - to_world[1, 3], 2 * ground_m - lamp[2] - to_world[2, 3]
    lamp_z = to_world[0, 2] * x + to_world[1, 2] * y + to_world[2, 2] * height
    if lamp_z <= z:
        return 1.0
    lamp_x = fx / lamp_z * (to_world[0, 0] * x + to_world[1, 0] * y + to_world[2, 0] * height) + cx - 0.5 - column
    lamp_y = fy / lamp_z * (to_world[0, 1] * x + to_world[1, 1] * y + to_world[2, 1] * height) + cy - 0.5 - row
    side = max(0.5, fx * _LAMP_M / lamp_z)
    found = 0.0
    for k in range(-1, 2):
        across = lamp_x + k * side
        steps = min(_SHADOW_STEPS, int(max(abs(across), abs(lamp_y)) / 2) + 1)  # of two pixels
        is_open = True
        for step in range(1, steps + 1):
            share = step / steps
            i, j = int(np.floor(row + share * lamp_y + 0.5)), int(np.floor(column + share * across + 0.5))
            if i < 0 or j < 0 or i >= depth.shape[0] or j >= depth.shape[1]:
                break
            there = 1 / ((1 - share) / z + share / lamp_z)
            if 0 < depth[i, j] < there - _BEHIND_M - _BEHIND * there:
                is_open = False
                break
        found += is_open
    return found / 3

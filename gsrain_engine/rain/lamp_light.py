"""Light of lamps that drops and the medium scatter once, toward one camera.

Along a ray, light from a lamp at distance b is scattered by the angle pi / 2 + atan((s - s0) / b), s0 the point that
is nearest to it. In that angle the integral has no pole, and the phase function can be summed in advance (Sun et al.
2005). A table holds the light of all lamps up to each distance, for every few pixels; there b has a floor, so that it
is smooth, and pixels near a lamp take the difference from an integral of their own.
"""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64

from ..fast_math import exponential
from ..kernels import kernel, range_of
from ..scene.camera import Camera
from ..scene.lamps import LitLamps
from ..scene.lens import PixelRays
from ..scene.lens_faces import wide_face
from .medium import RainMedium, optical_depth
from .phase import ANGLES, phase_sums

LAMP_NUMBERS = 18
SLICES = 24  # of the table over distance
SLICE_SCALE_M = 16.0  # half of the slices are nearer
FAR_M = 1e6
CELL_PX = 4  # least distance of the table's rays
COLUMNS = 128  # of the table at full resolution
FLOOR_CELLS = 2.0
"""Floor of b in the table, in cells at the lamp's distance."""
REACH = 2.5
"""Distance from a lamp in floors at which the table is exact to a percent; pixels nearer take an integral."""
UNSEEN = 0.01
"""Share of a pixel's light up to which such integrals are left out, all together."""
SEGMENT_PX = 32  # of a row, for which lamps are chosen at once
STEP, PIXEL_STEP = np.float32(np.pi / 16), np.float32(np.pi / 8)
"""Longest steps of an integral, by angle: in the table, and at pixels, where the difference of two integrals counts."""
BLOCK = 4
"""Cells of a block, over which the light of a lamp is interpolated if it is smooth."""
SMOOTH, LEAST_LIGHT = 0.012, 1e-6
"""Share of the light, and light, that this may be wrong by in the middle of a block, all lamps together."""
APART = 3.0
"""Distance in blocks from a lamp up to which its light is never interpolated."""
FAR_APART = 10.0
"""The same, beyond which that of a lamp without a cone always is: 1 / b then bends by less than `SMOOTH`."""
NARROW = float(np.cos(np.radians(20.0)))  # cosine of the half-angle of cones that fit between the corners of blocks
NEAREST_M = 0.02
NEAREST_DROP_M = 0.1  # of a drop to a lamp
NO_WEIGHT, OPAQUE = 1e-3, 0.98
"""Shares of a scene that count as none and as all: renderers end a pixel with up to 2 % of light left."""


@dataclass(frozen=True, slots=True, eq=False)
class LampLight:
    """Lamps before one camera, and the light that its medium scatters."""

    lamps: Float32[np.ndarray, "n 18"]
    """In the camera's frame: position (m), axis, intensity, cosines of the cone where light ends and is full; floor of
    b (m) in the table and at pixels; position in the axes of the medium's region, from its center (m); brightness."""
    sums: Float32[np.ndarray, " angles"]
    """Integral of the medium's phase function over the angle."""
    drop_phase: Float32[np.ndarray, " angles"]
    """Phase function of single drops."""
    table: Float32[np.ndarray, "rows columns slices 3"]
    """Scattered linear light up to each slice, at the corners of cells of `cell_px`."""
    cell_px: float
    intrinsics: Float32[np.ndarray, "4"]
    """fx fy cx cy (px)."""
    numbers: Float32[np.ndarray, "33"]
    drawn: Float32[np.ndarray, " steps"]
    """As in `RainMedium`."""


def make_lamp_light(
    lamps: LitLamps,
    camera: Camera,
    medium: RainMedium | None,
    phase: Float64[np.ndarray, " angles"],
    drop_phase: Float64[np.ndarray, " angles"],
) -> LampLight:
    """Light of lamps in a medium with a phase function; without a medium they light single drops only.

    Only the brightest lamps at the camera count, see `LitLamps.brightest`. Through a lens, the table is that of a wide
    pinhole picture, in which the pixels of the lens are looked up.
    """
    if camera.lens is not None:
        camera = wide_face(camera).of(camera)
    lamps = lamps.brightest(camera.position)
    numbers = np.zeros(33, np.float32) if medium is None else medium.numbers
    numbers[1] = numbers[1] or 1.0
    drawn = np.zeros(2, np.float32) if medium is None else medium.drawn
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    cell_px = float(max(CELL_PX, -(-camera.width // COLUMNS)))
    rows = lamp_rows(lamps, camera, numbers, cell_px)
    sums = phase_sums(phase)
    size = (
        (-(-camera.height // int(cell_px)) + 1, -(-camera.width // int(cell_px)) + 1) if medium is not None else (0, 0)
    )
    table = np.zeros((*size, SLICES + 1, 3), np.float32)
    distances = slice_distances()
    blocks = (-(-size[0] // BLOCK), -(-size[1] // BLOCK))
    corners = np.empty((blocks[0] + 1, blocks[1] + 1, len(rows), len(distances)), np.float32)
    if medium is not None:
        _fill_blocks(corners, cell_px, intrinsics, rows, numbers, drawn, sums, distances)
        _fill(table, corners, cell_px, intrinsics, rows, numbers, drawn, sums, distances)
    return LampLight(rows, sums, drop_phase.astype(np.float32), table, cell_px, intrinsics, numbers, drawn)


def slice_distances() -> Float32[np.ndarray, " slices"]:
    """Distances of the slices in m: s / (s + scale) has equal steps."""
    share = np.arange(SLICES + 1) / SLICES
    share[-1] = FAR_M / (FAR_M + SLICE_SCALE_M)
    return (SLICE_SCALE_M * share / (1 - share)).astype(np.float32)


def lamp_rows(
    lamps: LitLamps, camera: Camera, numbers: Float32[np.ndarray, "33"], cell_px: float
) -> Float32[np.ndarray, "n 18"]:
    """Lamps as kernels and shaders use them, see `LampLight.lamps`."""
    rows = np.zeros((len(lamps.positions_m), LAMP_NUMBERS))
    turn = camera.world_to_camera[:3, :3]
    rows[:, 0:3] = (lamps.positions_m - camera.position) @ turn.T
    rows[:, 3:6] = lamps.directions @ turn.T
    rows[:, 6:9] = lamps.intensities
    rows[:, 9], rows[:, 10] = lamps.cos_outer, lamps.cos_inner
    distances, focal = np.linalg.norm(rows[:, 0:3], axis=1), float(np.sqrt(camera.fx * camera.fy))
    rows[:, 11] = np.maximum(FLOOR_CELLS * cell_px * distances / focal, NEAREST_M)
    rows[:, 12] = np.maximum(0.5 * distances / focal, NEAREST_M)
    region = numbers[17:32].astype(np.float64)
    rows[:, 13:16] = rows[:, 0:3] @ region[:9].reshape(3, 3).T + region[9:12]
    rows[:, 16] = rows[:, 6:9].max(axis=1)
    rows[:, 17] = distances
    return rows.astype(np.float32)


# Integral along a ray


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _cone(cosine, outer, per_cosine):
    """Share of a lamp's light at the cosine of an angle from its axis: a smoothstep from the cone's edge on."""
    at = min(max((cosine - outer) * per_cosine, np.float32(0)), np.float32(1))
    return at * at * (np.float32(3) - np.float32(2) * at)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _edge(lamp):
    """Cosine of the cone's edge, and one over the cosines from there to full light."""
    return lamp[9], np.float32(1) / max(lamp[10] - lamp[9], np.float32(1e-6))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _axis(ray, lamp, nearest, b):
    """Parts of a lamp's axis along a ray, and across it, away from the lamp."""
    along = lamp[3] * ray[0] + lamp[4] * ray[1] + lamp[5] * ray[2]
    return along, (nearest * along - (lamp[3] * lamp[0] + lamp[4] * lamp[1] + lamp[5] * lamp[2])) / b


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _middle(start, end, b):
    """Middle, by angle, of a piece of a ray that begins and ends so far behind its nearest point to a lamp.

    The ends' unit vectors halved, without a tangent. Returns its place, and its distance from the lamp.
    """
    near, far = np.sqrt(start * start + b * b), np.sqrt(end * end + b * b)
    offset = min(max((start * far + end * near) / (near + far), start), end)
    return offset, np.sqrt(b * b + offset * offset)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _lit_share(offset, length, b, angle, along, across, outer, per_cosine):
    """Mean share of a lamp's light on a piece of a ray of at most half a radian, by Gauss's three points.

    The cosine from the lamp's axis is a sine of the angle along the ray. Arguments as `_middle`, `_axis` and `_edge`
    return them.
    """
    ahead, aside, one = offset / length, b / length, np.float32(1)
    cosine, sine = along * ahead + across * aside, along * aside - across * ahead
    turned = np.float32(0.7745967 * 0.5) * angle
    square = turned * turned
    turned_cosine = (one - np.float32(1 / 2) * square * (one - np.float32(1 / 12) * square)) * cosine
    turned_sine = turned * (one - np.float32(1 / 6) * square) * sine
    return np.float32(8 / 18) * _cone(cosine, outer, per_cosine) + np.float32(5 / 18) * (
        _cone(turned_cosine + turned_sine, outer, per_cosine) + _cone(turned_cosine - turned_sine, outer, per_cosine)
    )


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _lit_angles(ray, lamp, nearest, b, step):
    """Angles along a ray between which it is in a lamp's cone, and the longest step between them."""
    along, across = _axis(ray, lamp, nearest, b)
    largest = np.sqrt(along * along + across * across)
    ratio = lamp[9] / max(largest, np.float32(1e-9))
    if ratio <= 0:
        return np.float32(-2), np.float32(2), step
    if ratio >= 1:
        return np.float32(2), np.float32(-2), step
    middle, half = np.arctan2(along, across), np.arccos(ratio)
    return middle - half, middle + half, min(step, half * np.float32(1 / 3))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _sum_to(angle, sums):
    """Integral of the phase function up to an angle of scattering (radians)."""
    at = min(max(np.float32(0), angle * np.float32((ANGLES - 1) / np.pi)), np.float32(ANGLES - 1))
    k = min(np.int32(at), np.int32(ANGLES - 2))
    return sums[k] + (at - np.float32(k)) * (sums[k + 1] - sums[k])


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _depth_from_lamp(vx, vy, vz, length, lamp, numbers):
    """Optical depth of the medium from a lamp along a vector (camera's frame), all drops counted."""
    if numbers[32] == 0:
        return numbers[0] * length
    enters, leaves = np.float32(0), length
    for row in range(3):
        k = 17 + 3 * row
        along = numbers[k] * vx + numbers[k + 1] * vy + numbers[k + 2] * vz
        start, half = lamp[13 + row], numbers[29 + row]
        inverse = length / (along if abs(along) > np.float32(1e-9) else np.float32(1e-9))
        one, other = (-half - start) * inverse, (half - start) * inverse
        enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
    return numbers[0] * max(leaves - enters, np.float32(0))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _place(angle, nearest, b, first_m, last_m, depth, per_m):
    """An angle along a ray, the optical depth and the distance (m) there, within a slice."""
    s = min(max(nearest + b * np.tan(angle), first_m), last_m)
    return angle, depth + per_m * (s - first_m), s


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _scattered(ray, lamp, nearest, b, first, last, per_m, numbers, sums):
    """Light of one lamp, over its intensity, that a piece of a ray scatters into the camera.

    `first` and `last`: angle atan((s - s0) / b), optical depth and distance at the ends of the piece; `per_m` is the
    medium's extinction between them.
    """
    offset, length = _middle(first[2] - nearest, last[2] - nearest, b)
    lit = np.float32(1)
    if lamp[10] > -1:
        along, across = _axis(ray, lamp, nearest, b)
        outer, per_cosine = _edge(lamp)
        lit = _lit_share(offset, length, b, last[0] - first[0], along, across, outer, per_cosine)
    if lit <= 0 or per_m <= 0:
        return np.float32(0)
    at = nearest + offset
    vx, vy, vz = at * ray[0] - lamp[0], at * ray[1] - lamp[1], at * ray[2] - lamp[2]
    depth = first[1] + per_m * (at - first[2]) + _depth_from_lamp(vx, vy, vz, length, lamp, numbers)
    quarter = np.float32(np.pi / 2)
    phase = _sum_to(last[0] + quarter, sums) - _sum_to(first[0] + quarter, sums)
    return per_m * np.exp(-depth) * lit * phase / (np.float32(4 * np.pi) * b)


@numba.njit(error_model="numpy")
@no_type_check
def _depths(column, row, cell_px, intrinsics, numbers, drawn, distances, depths):
    """Unit ray of a corner of the cells; writes the optical depth up to each slice."""
    fx, fy, cx, cy = intrinsics
    x, y = (np.float32(column * cell_px) - cx) / fx, (np.float32(row * cell_px) - cy) / fy
    scale = np.float32(1) / np.sqrt(x * x + y * y + np.float32(1))
    ray = (x * scale, y * scale, scale)
    depths[0] = 0
    for k in range(1, len(distances)):
        s = distances[k]
        depths[k] = optical_depth(s * ray[0], s * ray[1], s * ray[2], numbers, drawn)
    return ray


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _angle(x):
    """Arc tangent to 3e-6, in steps that LLVM vectorizes: that of a quarter of the angle, by its series."""
    t = x / (np.float32(1) + np.sqrt(np.float32(1) + x * x))
    t = t / (np.float32(1) + np.sqrt(np.float32(1) + t * t))
    q = t * t
    p = np.float32(1 / 9) - q * np.float32(1 / 11)
    p = np.float32(-1 / 7) + q * p
    p = np.float32(1 / 5) + q * p
    p = np.float32(-1 / 3) + q * p
    return np.float32(4) * t * (np.float32(1) + q * p)


@numba.njit(error_model="numpy")
@no_type_check
def _scatter_slices(ray, lamp, nearest, b, depths, distances, numbers, sums, angles, light):
    """Write the angle at each slice, and the light of one lamp that each slice scatters if all of it is lit.

    That is `_scattered` for each whole slice of a medium without a region, in loops that LLVM vectorizes.
    """
    count, one = len(distances), np.float32(1)
    for k in range(count):
        angles[k] = _angle((distances[k] - nearest) / b)
    along, across = _axis(ray, lamp, nearest, b)
    outer, per_cosine = _edge(lamp)
    has_cone, extinction_per_m = lamp[10] > -1, numbers[0]
    for k in range(1, count):
        offset, length = _middle(distances[k - 1] - nearest, distances[k] - nearest, b)
        lit = one
        if has_cone:
            lit = _lit_share(offset, length, b, angles[k] - angles[k - 1], along, across, outer, per_cosine)
        per_m = (depths[k] - depths[k - 1]) / (distances[k] - distances[k - 1])
        depth = depths[k - 1] + per_m * (nearest + offset - distances[k - 1])
        depth += extinction_per_m * length
        light[k] = per_m * exponential(-depth) * lit
    quarter, share = np.float32(np.pi / 2), one / (np.float32(4 * np.pi) * b)
    before = _sum_to(angles[0] + quarter, sums)
    for k in range(1, count):
        after = _sum_to(angles[k] + quarter, sums)
        light[k] *= share * (after - before)
        before = after


@numba.njit(error_model="numpy")
@no_type_check
def _sum_slices(ray, lamp, depths, distances, numbers, sums, angles, light):
    """Write the light of one lamp, over its intensity, up to each slice; returns False if there is none."""
    count = len(distances)
    nearest = ray[0] * lamp[0] + ray[1] * lamp[1] + ray[2] * lamp[2]
    square = max(lamp[17] * lamp[17] - nearest * nearest, np.float32(0))
    floor = lamp[11] * lamp[11]
    b = np.sqrt(np.sqrt(square * square + floor * floor))
    lit_first, lit_last, longest = _lit_angles(ray, lamp, nearest, b, STEP)
    if lit_first >= lit_last:
        light[:] = 0
        return False
    _scatter_slices(ray, lamp, nearest, b, depths, distances, numbers, sums, angles, light)
    light[0] = total = np.float32(0)
    for k in range(1, count):
        before, after = angles[k - 1], angles[k]
        first, last = max(before, lit_first), min(after, lit_last)
        if last > first:
            if first == before and last == after and after - before <= longest and numbers[32] == 0:
                total += light[k]
            else:
                total += _scatter_slice(
                    ray, lamp, nearest, b, (before, first, last, after), longest, depths, distances, k, numbers, sums
                )
        light[k] = total
    return True


@numba.njit(error_model="numpy")
@no_type_check
def _scatter_slice(ray, lamp, nearest, b, limits, longest, depths, distances, k, numbers, sums):
    """Light of one lamp, over its intensity, that a slice scatters between two angles, in as many steps as it takes."""
    before, first, last, after = limits
    total = np.float32(0)
    per_m = (depths[k] - depths[k - 1]) / (distances[k] - distances[k - 1])
    steps = np.int32(np.ceil((last - first) / longest))
    start = (first, depths[k - 1], distances[k - 1])
    if first > before:
        start = _place(first, nearest, b, distances[k - 1], distances[k], depths[k - 1], per_m)
    for step in range(1, steps + 1):
        if step == steps and last == after:
            end = (last, depths[k], distances[k])
        else:
            angle = first + (last - first) * np.float32(step) / np.float32(steps)
            end = _place(angle, nearest, b, distances[k - 1], distances[k], depths[k - 1], per_m)
        total += _scattered(ray, lamp, nearest, b, start, end, per_m, numbers, sums)
        start = end
    return total


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill_blocks(portion, corners, cell_px, intrinsics, lamps, numbers, drawn, sums, distances):
    """Light of each lamp, over its intensity, up to each slice at the corners of blocks of cells."""
    for row in range_of(portion, corners.shape[0]):
        depths, angles = np.empty(len(distances), np.float32), np.empty(len(distances), np.float32)
        for column in range(corners.shape[1]):
            ray = _depths(column * BLOCK, row * BLOCK, cell_px, intrinsics, numbers, drawn, distances, depths)
            for i in range(len(lamps)):
                if lamps[i, 9] < NARROW:
                    _sum_slices(ray, lamps[i], depths, distances, numbers, sums, angles, corners[row, column, i])


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _mean_of_corners(corners, row, column, i, k):
    return np.float32(0.25) * (
        corners[row, column, i, k] + corners[row + 1, column, i, k]
        + corners[row, column + 1, i, k] + corners[row + 1, column + 1, i, k]
    )  # fmt: skip


@numba.njit(error_model="numpy")
@no_type_check
def _is_smooth(
    corners, row, column, i, ray, lamp, depths, distances, numbers, sums, angles, light, unseen, cell_px, focal_px
):  # fmt: skip
    """Compare the light of a lamp in the middle of a block with the mean at its corners; true if they agree.

    `unseen` is the error that is left to all lamps up to each slice; it is used up.
    """
    if lamp[9] >= NARROW:
        return False
    nearest = ray[0] * lamp[0] + ray[1] * lamp[1] + ray[2] * lamp[2]
    square = max(lamp[17] * lamp[17] - nearest * nearest, np.float32(0))
    block_m = np.float32(BLOCK) * cell_px / focal_px * lamp[17]
    if nearest > 0 and square < np.float32(APART * APART) * block_m * block_m:
        return False
    if _mean_of_corners(corners, row, column, i, len(distances) - 1) == 0:  # none is in its cone
        return True
    if lamp[9] <= -1 and (nearest <= 0 or square > np.float32(FAR_APART * FAR_APART) * block_m * block_m):
        return True
    _sum_slices(ray, lamp, depths, distances, numbers, sums, angles, light)
    for k in range(1, len(distances)):
        light[k] = lamp[16] * abs(light[k] - _mean_of_corners(corners, row, column, i, k))
        if light[k] > unseen[k]:
            return False
    for k in range(1, len(distances)):
        unseen[k] -= light[k]
    return True


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill(portion, table, corners, cell_px, intrinsics, lamps, numbers, drawn, sums, distances):
    """Sum the light of all lamps up to each slice along the ray of each corner of the cells.

    Where that of a lamp is smooth over a block of cells, it is interpolated between the block's corners.
    """
    rows, columns, count, _ = table.shape
    focal_px = np.sqrt(intrinsics[0] * intrinsics[1])
    half = np.float32(BLOCK // 2)
    for block in range_of(portion, corners.shape[0] - 1):
        depths, angles, light = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
        unseen, smooth = np.empty(count, np.float32), np.empty((2, 2, count, 3), np.float32)
        rough = np.empty(len(lamps), np.int32)
        for across in range(corners.shape[1] - 1):
            ray = _depths(
                across * BLOCK + half, block * BLOCK + half, cell_px, intrinsics, numbers, drawn, distances, depths
            )
            smooth[:] = 0
            unseen[:] = LEAST_LIGHT
            for i in range(len(lamps)):
                if lamps[i, 9] < NARROW:
                    for k in range(1, count):
                        light_there = lamps[i, 16] * _mean_of_corners(corners, block, across, i, k)
                        unseen[k] += np.float32(SMOOTH) * light_there
            found = 0
            for i in range(len(lamps)):
                if _is_smooth(
                    corners, block, across, i, ray, lamps[i], depths, distances, numbers, sums, angles, light,
                    unseen, cell_px, focal_px,
                ):  # fmt: skip
                    for down in range(2):
                        for right in range(2):
                            for k in range(1, count):
                                value = corners[block + down, across + right, i, k]
                                for channel in range(3):
                                    smooth[down, right, k, channel] += value * lamps[i, 6 + channel]
                else:
                    rough[found] = i
                    found += 1
            for row in range(block * BLOCK, min((block + 1) * BLOCK, rows)):
                v = np.float32(row - block * BLOCK) / np.float32(BLOCK)
                for column in range(across * BLOCK, min((across + 1) * BLOCK, columns)):
                    u = np.float32(column - across * BLOCK) / np.float32(BLOCK)
                    for k in range(1, count):
                        for channel in range(3):
                            upper = (1 - u) * smooth[0, 0, k, channel] + u * smooth[0, 1, k, channel]
                            lower = (1 - u) * smooth[1, 0, k, channel] + u * smooth[1, 1, k, channel]
                            table[row, column, k, channel] = (1 - v) * upper + v * lower
                    if found == 0:
                        continue
                    ray = _depths(column, row, cell_px, intrinsics, numbers, drawn, distances, depths)
                    for at in range(found):
                        i = rough[at]
                        if _sum_slices(ray, lamps[i], depths, distances, numbers, sums, angles, light):
                            for k in range(1, count):
                                for channel in range(3):
                                    table[row, column, k, channel] += light[k] * lamps[i, 6 + channel]


@numba.njit(error_model="numpy")
@no_type_check
def _up_to(ray, distance, lamp, nearest, b, numbers, drawn, sums):
    """Light of one lamp, over its intensity, scattered along a ray up to a distance."""
    lit_first, lit_last, longest = _lit_angles(ray, lamp, nearest, b, PIXEL_STEP)
    first, last = max(np.arctan2(-nearest, b), lit_first), min(np.arctan2(distance - nearest, b), lit_last)
    total = np.float32(0)
    if first >= last:
        return total
    steps = np.int32(np.ceil((last - first) / longest))
    s = min(max(nearest + b * np.tan(first), np.float32(0)), distance)
    start = (first, optical_depth(s * ray[0], s * ray[1], s * ray[2], numbers, drawn), s)
    for step in range(1, steps + 1):
        angle = first + (last - first) * np.float32(step) / np.float32(steps)
        s = min(max(nearest + b * np.tan(angle), start[2]), distance)
        end = (angle, optical_depth(s * ray[0], s * ray[1], s * ray[2], numbers, drawn), s)
        per_m = (end[1] - start[1]) / max(s - start[2], np.float32(1e-9))
        total += _scattered(ray, lamp, nearest, b, start, end, per_m, numbers, sums)
        start = end
    return total


# Pixels


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _looked_up(table, column, row, slice_at):
    """Trilinear interpolation in the table."""
    x = min(max(np.int32(0), np.int32(column)), np.int32(table.shape[1] - 2))
    y = min(max(np.int32(0), np.int32(row)), np.int32(table.shape[0] - 2))
    z = min(max(np.int32(0), np.int32(slice_at)), np.int32(table.shape[2] - 2))
    u, v, w = column - np.float32(x), row - np.float32(y), slice_at - np.float32(z)
    i, j, k = np.uint64(y), np.uint64(x), np.uint64(z)
    red = green = blue = np.float32(0)
    for down in range(2):
        for right in range(2):
            share = (v if down == 1 else 1 - v) * (u if right == 1 else 1 - u)
            m, n, far = i + np.uint64(down), j + np.uint64(right), k + np.uint64(1)
            red += share * (table[m, n, k, 0] + w * (table[m, n, far, 0] - table[m, n, k, 0]))
            green += share * (table[m, n, k, 1] + w * (table[m, n, far, 1] - table[m, n, k, 1]))
            blue += share * (table[m, n, k, 2] + w * (table[m, n, far, 2] - table[m, n, k, 2]))
    return red, green, blue


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _rest(x, y, z, distance, light, lamps, found, numbers, drawn, sums):
    """Light along a unit ray up to a distance beyond that in the table, where it passes near one of the `found` lamps.

    `light` is the brightest channel of that in the table.
    """
    red = green = blue = np.float32(0)
    unseen = np.float32(UNSEEN) * light
    bound = numbers[0] * sums[ANGLES - 1] / np.float32(4 * np.pi)
    for i in range(found):
        nearest = x * lamps[i, 0] + y * lamps[i, 1] + z * lamps[i, 2]
        square = max(lamps[i, 17] * lamps[i, 17] - nearest * nearest, np.float32(0))
        floor = lamps[i, 11] * lamps[i, 11]
        reach = square / (np.float32(REACH * REACH) * floor)
        if nearest <= 0 or reach >= 1:
            continue
        b = max(np.sqrt(square), lamps[i, 12])
        soft = np.sqrt(np.sqrt(square * square + floor * floor))
        at_most = lamps[i, 16] * bound * (np.float32(1) / b - np.float32(1) / soft)
        if at_most < unseen:
            unseen -= at_most
            continue
        rest = _nearer((x, y, z), distance, lamps[i], nearest, b, soft, numbers, drawn, sums)
        fades = min((np.float32(1) - reach) * np.float32(4), np.float32(1))
        rest *= fades * fades * (np.float32(3) - np.float32(2) * fades)
        red += rest * lamps[i, 6]
        green += rest * lamps[i, 7]
        blue += rest * lamps[i, 8]
    return red, green, blue


@numba.njit(error_model="numpy")
@no_type_check
def _nearer(ray, distance, lamp, nearest, b, soft, numbers, drawn, sums):
    """Light of one lamp, over its intensity, at its distance b beyond that at the distance `soft` of the table."""
    there = _up_to(ray, distance, lamp, nearest, b, numbers, drawn, sums)
    return there - _up_to(ray, distance, lamp, nearest, soft, numbers, drawn, sums)


@numba.njit(error_model="numpy")
@no_type_check
def _light_row(shares, distances, places, table, light):
    """Look up the light of a row's pixels at `places` (cells) up to a scene's distances, and to infinity for the sky.

    A loop of its own, since LLVM makes five times as much of it alone as around what few pixels need.
    """
    one, far = np.float32(1), np.float32(FAR_M / (FAR_M + SLICE_SCALE_M) * SLICES)
    for column in range(len(shares)):
        at = distances[column] / (distances[column] + np.float32(SLICE_SCALE_M)) * np.float32(SLICES)
        red, green, blue = _looked_up(table, places[column, 0], places[column, 1], at)
        light[column, 0], light[column, 1], light[column, 2] = red, green, blue
    for column in range(len(shares)):
        if shares[column] < one:
            red, green, blue = _looked_up(table, places[column, 0], places[column, 1], far)
            share, rest = shares[column], one - shares[column]
            light[column, 0] = share * light[column, 0] + rest * red
            light[column, 1] = share * light[column, 1] + rest * green
            light[column, 2] = share * light[column, 2] + rest * blue


def share_of_depth(depth_m: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Depth over itself and `SLICE_SCALE_M`: 0 at the camera, 1 at infinity."""
    return depth_m / (depth_m + np.float32(SLICE_SCALE_M))


def depth_of_share(share: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Depth in meters of a `share_of_depth`; of a mean of shares, one that near surfaces weigh more in."""
    return share * np.float32(SLICE_SCALE_M) / np.maximum(1 - share, np.float32(1e-6))


def light_in_picture(
    lit: LampLight,
    depth_share: Float32[np.ndarray, "h w"],
    weight: Float32[np.ndarray, "h w"],
    rays: PixelRays | None = None,
) -> Float32[np.ndarray, "h w 3"]:
    """Linear light that the medium scatters into each pixel, before a scene at depths along the axis.

    `weight` is the scene's share of a pixel, `depth_share` the sum of each splat's times its `share_of_depth`, in which
    the table is linear, so that what shows through gaps does not move the mean; the rest is the sky. With `rays`, those
    of a lens, depths are distances.
    """
    image = np.empty((*weight.shape, 3), np.float32)
    if rays is not None:
        _light_along_rays(
            depth_share, weight, rays.directions, image, lit.table, np.float32(lit.cell_px), lit.intrinsics, lit.lamps,
            lit.numbers, lit.drawn, lit.sums,
        )  # fmt: skip
        return image
    _light_in_picture(
        depth_share, weight, image, lit.table, np.float32(lit.cell_px), lit.intrinsics, lit.lamps, lit.numbers,
        lit.drawn, lit.sums,
    )  # fmt: skip
    return image


@numba.njit(error_model="numpy")
@no_type_check
def _lamps_near(x, y, intrinsics, lamps, near):
    """Copy the lamps in whose reach pixels of a segment around a point may be; returns their number."""
    across, down = (x - intrinsics[2]) / intrinsics[0], (y - intrinsics[3]) / intrinsics[1]
    scale = np.float32(1) / np.sqrt(across * across + down * down + np.float32(1))
    more = np.float32(SEGMENT_PX) / min(intrinsics[0], intrinsics[1])  # radians, at most
    found = 0
    for i in range(len(lamps)):
        lamp = lamps[i]
        away = max(lamp[17], np.float32(1e-6))
        cosine = scale * (across * lamp[0] + down * lamp[1] + lamp[2]) / away
        reach = np.arcsin(min(np.float32(REACH) * lamp[11] / away, np.float32(1)))
        if reach + more >= np.float32(np.pi / 2) or cosine >= np.cos(reach + more):
            near[found] = lamp
            found += 1
    return found


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _scene_before(weight, depth_share, slope):
    """Share of the scene in a pixel, and its distance (m) along a ray that has this slope to the axis."""
    one = np.float32(1)
    share = min(max(weight, np.float32(0)), one)
    if share <= np.float32(NO_WEIGHT):
        return np.float32(0), np.float32(FAR_M)
    mean = min(depth_share / weight, np.float32(1 - 1e-6))
    distance = min(slope * np.float32(SLICE_SCALE_M) * mean / (one - mean), np.float32(FAR_M))
    return (one if share > np.float32(OPAQUE) else share), distance


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _add_rest(x, y, z, share, distance, light, column, lamps, found, numbers, drawn, sums):
    """Add to a pixel's light that of near lamps, before the scene and before the sky beside it, and bound it by 0."""
    zero, rest = np.float32(0), np.float32(1) - share
    red, green, blue = light[column, 0], light[column, 1], light[column, 2]
    brightest = max(red, green, blue)
    if share > 0:
        more = _rest(x, y, z, distance, brightest, lamps, found, numbers, drawn, sums)
        red, green, blue = red + share * more[0], green + share * more[1], blue + share * more[2]
    if rest > 0:
        more = _rest(x, y, z, np.float32(FAR_M), brightest, lamps, found, numbers, drawn, sums)
        red, green, blue = red + rest * more[0], green + rest * more[1], blue + rest * more[2]
    light[column, 0], light[column, 1], light[column, 2] = max(red, zero), max(green, zero), max(blue, zero)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _light_in_picture(
    portion, depth_share, weight, image, table, cell_px, intrinsics, lamps, numbers, drawn, sums
):  # fmt: skip
    height, width = weight.shape
    one, half = np.float32(1), np.float32(0.5)
    fx, fy, cx, cy = intrinsics
    shares, distances = np.empty(width, np.float32), np.empty(width, np.float32)
    places, near = np.empty((width, 2), np.float32), np.empty_like(lamps)
    for row in range_of(portion, height):
        y, light = np.float32(row) + half, image[row]
        down = (y - cy) / fy
        for column in range(width):
            x = np.float32(column) + half
            across = (x - cx) / fx
            slope = np.sqrt(one + across * across + down * down)
            shares[column], distances[column] = _scene_before(weight[row, column], depth_share[row, column], slope)
            places[column, 0], places[column, 1] = x / cell_px, y / cell_px
        _light_row(shares, distances, places, table, light)
        for first in range(0, width, SEGMENT_PX):
            found = _lamps_near(np.float32(first + SEGMENT_PX // 2) + half, y, intrinsics, lamps, near)
            for column in range(first, min(first + SEGMENT_PX, width) if found > 0 else first):
                across = (np.float32(column) + half - cx) / fx
                scale = one / np.sqrt(one + across * across + down * down)
                _add_rest(
                    scale * across, scale * down, scale, shares[column], distances[column], light, column, near,
                    found, numbers, drawn, sums,
                )  # fmt: skip


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _light_along_rays(
    portion, depth_share, weight, rays, image, table, cell_px, intrinsics, lamps, numbers, drawn, sums
):  # fmt: skip
    """Write the light of the pixels of a lens, each looked up at its ray's place in the table's pinhole picture."""
    height, width = weight.shape
    one, flat = np.float32(1), np.float32(0.1)
    fx, fy, cx, cy = intrinsics
    right = (np.float32(table.shape[1] - 1)) * cell_px
    bottom = (np.float32(table.shape[0] - 1)) * cell_px
    shares, distances, places = (
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty((width, 2), np.float32),
    )
    for row in range_of(portion, height):
        light = image[row]
        for column in range(width):
            z = max(rays[row, column, 2], flat)  # flatter rays have the light at the edge
            x = min(max(fx * rays[row, column, 0] / z + cx, np.float32(0)), right)
            y = min(max(fy * rays[row, column, 1] / z + cy, np.float32(0)), bottom)
            shares[column], distances[column] = _scene_before(weight[row, column], depth_share[row, column], one)
            places[column, 0], places[column, 1] = x / cell_px, y / cell_px
        _light_row(shares, distances, places, table, light)
        for column in range(width):
            across, down = (places[column, 0] * cell_px - cx) / fx, (places[column, 1] * cell_px - cy) / fy
            scale = one / np.sqrt(one + across * across + down * down)
            _add_rest(
                scale * across, scale * down, scale, shares[column], distances[column], light, column, lamps,
                len(lamps), numbers, drawn, sums,
            )  # fmt: skip


# Drops


def light_of_drops(
    lit: LampLight, positions_m: Float32[np.ndarray, "n 3"], camera: Camera
) -> Float32[np.ndarray, "n 3"]:
    """Linear light by lamps of drops that are drawn one by one, over their own cross-section; positions in the world.

    A drop scatters the light of twice its cross-section, half of it straight ahead, which the phase function omits.
    """
    points = (positions_m - camera.position) @ camera.world_to_camera[:3, :3].T
    light = np.empty((len(points), 3), np.float32)
    _light_drops(points.astype(np.float32), lit.lamps, lit.numbers, lit.drawn, lit.drop_phase, light)
    return light


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _light_drops(portion, points, lamps, numbers, drawn, phase, light):
    for n in range_of(portion, len(points)):
        x, y, z = points[n]
        away = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
        before = optical_depth(x, y, z, numbers, drawn)
        for channel in range(3):
            light[n, channel] = 0
        for i in range(len(lamps)):
            lamp = lamps[i]
            vx, vy, vz = x - lamp[0], y - lamp[1], z - lamp[2]
            length = max(np.sqrt(vx * vx + vy * vy + vz * vz), np.float32(NEAREST_DROP_M))
            outer, per_cosine = _edge(lamp)
            share = _cone((lamp[3] * vx + lamp[4] * vy + lamp[5] * vz) / length, outer, per_cosine)
            if share <= 0:
                continue
            cosine = min(max(np.float32(-1), -(vx * x + vy * y + vz * z) / (length * away)), np.float32(1))
            at = np.arccos(cosine) * np.float32((ANGLES - 1) / np.pi)
            k = min(np.int32(at), np.int32(ANGLES - 2))
            scattered = phase[k] + (at - np.float32(k)) * (phase[k + 1] - phase[k])
            depth = before + _depth_from_lamp(vx, vy, vz, length, lamp, numbers)
            share *= scattered * np.exp(-depth) / (np.float32(2 * np.pi) * length * length)
            for channel in range(3):
                light[n, channel] += share * lamp[6 + channel]

"""Rain streaks: near drops as Gaussians with the size, opacity and direction of a drop's motion blur."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Float64

from ..kernels import kernel, range_of
from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, sh_from_color
from ..scene.lens import lens_numbers, view_bounds
from ..scene.lens_kernels import bent_place, turned_back
from ..scene.rolling_shutter import GLOBAL_SHUTTER, Readout
from ..scene.sensor import PINHOLE, ThinLens
from .settings import RainSettings

AXIS_RATIO_SLOPE, AXIS_RATIO_OFFSET = -0.07, 1.07  # tau(D) = k D + b for 1 mm < D < 9 mm (paper, eq. 4)

MAX_STRETCH = 2.0
"""Upper bound of the factor by which a rolling shutter lengthens the streak of a drop that falls with its readout."""

STREAK_REACH = 2.0  # maximum distance of the last visible fragment of a streak from its drop, in streak lengths


@dataclass(frozen=True, slots=True, eq=False)
class ShutterModel:
    """Camera motion and shutter that determine motion blur."""

    camera: Camera
    velocity_m_s: Float64[np.ndarray, "3"]
    exposure_s: float
    focal_px: float
    """Focal length of the *output* image, at any drawn resolution."""
    lens: ThinLens = PINHOLE
    readout: Readout = GLOBAL_SHUTTER


def camera_slopes(camera: Camera) -> Float64[np.ndarray, "4"]:
    """Edges of a camera's view: lowest and highest x/z, lowest and highest y/z; all 0 if a lens has no such edges."""
    if not camera.is_pinhole:
        slopes = view_bounds(camera).slopes
        return np.zeros(4) if slopes is None else slopes
    c = camera
    return np.array([-c.cx / c.fx, (c.width - c.cx) / c.fx, -c.cy / c.fy, (c.height - c.cy) / c.fy])


def visible_distance_m(diameter_mm: Float64[np.ndarray, " n"], focal_px: float) -> Float64[np.ndarray, " n"]:
    """Distance d_m = f D at which a drop covers exactly one pixel, in meters (paper, eq. 6)."""
    return focal_px * diameter_mm * 1e-3


_REACH = 4.8
"""Standard deviations at which even alpha 1 has fallen below a streak's cutoff of 1/65536 (exp(-4.8^2 / 2))."""


def streak_gaussians(
    positions_m: Float64[np.ndarray, "m 3"],
    diameters_mm: Float64[np.ndarray, " m"],
    velocities_m_s: Float64[np.ndarray, "m 3"],
    shutter: ShutterModel,
    rain: RainSettings,
    color: Float64[np.ndarray, "3"],
) -> Gaussians:
    """Turn drops into one to n_max Gaussians each along their path through the image; skip those outside the image.

    Opacity: eq. 5 with the speed perpendicular to the line of sight (the paper's form: V itself), times the
    distance attenuation of eq. 7. Copies: eq. 10-12. With the perpendicular speed, the integral of alpha over the image
    equals the drop's cross-section, pi D^2 / 4 (f / d)^2, at any distance and focus: the circle of confusion adds a
    sixteenth of its squared diameter to the variances, as a disc has.

    A rolling shutter exposes a drop in the middle of its streak at a time of its own: the drop is moved along its
    velocity by that time, and its streak gets as much longer as drops that move with the readout get rarer. Through a
    lens, depths are distances, and rows are those of the lens.
    """
    camera, max_copies = shutter.camera, rain.max_copies
    rows = np.empty((len(positions_m) * max_copies, 11), np.float32)
    is_drawn = np.zeros(len(rows), np.bool_)
    left, right, top, bottom = camera_slopes(camera)
    edges = np.array([-left, right, -top, bottom])
    moving = not rain.is_paper
    numbers = np.array([
        shutter.exposure_s, shutter.focal_px, rain.critical_haze_coefficient, rain.haze_opacity, rain.streak_gain,
        *shutter.lens, *shutter.readout,
    ])  # fmt: skip
    own_velocity, pose = shutter.velocity_m_s if moving else np.zeros(3), np.ascontiguousarray(camera.world_to_camera)
    if camera.is_pinhole:
        _fill(
            positions_m, diameters_mm, velocities_m_s, own_velocity, moving, pose, camera.position, edges, numbers,
            max_copies, rows, is_drawn,
        )  # fmt: skip
    else:
        turn, shift = np.zeros(3), pose[:3, :3] @ own_velocity * shutter.readout.time_s
        if camera.rolling is not None:
            turn, shift = np.array(camera.rolling.turn_rad), np.array(camera.rolling.shift_m)
        _fill_through_lens(
            positions_m, diameters_mm, velocities_m_s, own_velocity, moving, pose, camera.position, shift, turn,
            lens_numbers(camera.lens), camera.lens is not None, view_bounds(camera).angle_rad, numbers, max_copies,
            rows, is_drawn,
        )  # fmt: skip
    rows = rows[np.flatnonzero(is_drawn)]
    means, scales, quaternions = (np.ascontiguousarray(rows[:, a:b]) for a, b in ((0, 3), (3, 6), (6, 10)))
    return Gaussians(means, scales, quaternions, rows[:, 10].copy(), sh_of(color, len(rows)))


def sh_of(color: Float64[np.ndarray, "3"], count: int) -> Float32[np.ndarray, "{count} 1 3"]:
    """Spherical harmonics of equal Gaussians with a display color."""
    return np.broadcast_to(sh_from_color(color.astype(np.float32)[None]), (count, 1, 3)).copy()


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _streak(diameter_mm, speed, across, depth, moving, stretch, numbers, max_copies):
    """Opacity of each copy, length, number of copies, and standard deviations across and along the streak."""
    exposure, focal, phi, haze_opacity, gain, aperture, focus = numbers[:7]
    diameter = 1e-3 * diameter_mm
    alpha = min(1.0, diameter / max((across if moving else speed) * exposure, 1e-12))
    limit = focal * diameter
    alpha *= min(1.0, limit / max(depth, 1e-9))
    if depth > phi * limit:
        alpha = haze_opacity
    alpha = min(1.0, gain * alpha)
    # Copies overlap: their opacities would add up to sqrt(2 pi) alpha. This is exact on the streak's axis; off
    # the axis, where alpha is large, the sum is too high: a smaller width preserves the integral.
    opacity = 1 - (1 - alpha) ** (1 / np.sqrt(2 * np.pi))

    length = speed * exposure * stretch
    ratio = AXIS_RATIO_SLOPE * diameter_mm + AXIS_RATIO_OFFSET if diameter_mm > 1 else 1.0
    copies = int(min(max(1, np.rint(length / (ratio * diameter))), max_copies))
    narrowing = alpha / max(np.sqrt(2 * np.pi) * opacity, 1e-30)
    across_sigma = np.sqrt(np.pi / 32) * max(diameter, depth / focal) * narrowing
    along_sigma = max(length / copies, across_sigma)
    if aperture > 0:
        blur = aperture * abs(1 - depth / focus) / 4
        sine = across / max(speed, 1e-9)
        apparent_sigma = np.hypot(along_sigma * sine, across_sigma * np.sqrt(max(1 - sine * sine, 0.0)))
        opacity *= across_sigma / np.hypot(across_sigma, blur) * apparent_sigma / np.hypot(apparent_sigma, blur)
        across_sigma, along_sigma = np.hypot(across_sigma, blur), np.hypot(along_sigma, blur)
    return opacity, length, copies, across_sigma, along_sigma


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill(
    portion, positions, diameters, velocities, camera_velocity, moving, world_to_camera, eye, edges, numbers,
    max_copies, rows, is_drawn,
):  # fmt: skip
    readout, scan_right, scan_down, scan_offset = numbers[7:]
    chunk_size = 256
    for chunk in range_of(portion, (len(positions) + chunk_size - 1) // chunk_size):
        for m in range(chunk * chunk_size, min(len(positions), (chunk + 1) * chunk_size)):
            diameter_mm = diameters[m]
            vx = velocities[m, 0] - camera_velocity[0]
            vy = velocities[m, 1] - camera_velocity[1]
            vz = velocities[m, 2] - camera_velocity[2]
            dx, dy, dz = positions[m, 0] - eye[0], positions[m, 1] - eye[1], positions[m, 2] - eye[2]
            depth = world_to_camera[2, 0] * dx + world_to_camera[2, 1] * dy + world_to_camera[2, 2] * dz
            stretch = 1.0
            if readout > 0 and depth > 0:
                near = 1 / depth
                u = (world_to_camera[0, 0] * dx + world_to_camera[0, 1] * dy + world_to_camera[0, 2] * dz) * near
                v = (world_to_camera[1, 0] * dx + world_to_camera[1, 1] * dy + world_to_camera[1, 2] * dz) * near
                right = world_to_camera[0, 0] * vx + world_to_camera[0, 1] * vy + world_to_camera[0, 2] * vz
                down = world_to_camera[1, 0] * vx + world_to_camera[1, 1] * vy + world_to_camera[1, 2] * vz
                ahead = world_to_camera[2, 0] * vx + world_to_camera[2, 1] * vy + world_to_camera[2, 2] * vz
                rate = (scan_right * (right - u * ahead) + scan_down * (down - v * ahead)) * near
                stretch = 1 / max(1 - readout * rate, 1 / MAX_STRETCH)
                later = readout * stretch * (scan_right * u + scan_down * v + scan_offset)
                later = min(max(later, -readout), readout)  # the image needs half of that
                dx, dy, dz, depth = dx + later * vx, dy + later * vy, dz + later * vz, depth + later * ahead
            distance = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
            speed = np.sqrt(vx * vx + vy * vy + vz * vz)
            along_sight = (vx * dx + vy * dy + vz * dz) / distance
            across = np.sqrt(max(speed * speed - along_sight * along_sight, 0.0))
            opacity, length, copies, across_sigma, along_sigma = _streak(
                diameter_mm, speed, across, depth, moving, stretch, numbers, max_copies
            )
            reach = _REACH * along_sigma
            # Half-way quaternion from +z; the sign of a streak's axis is free, so never turn by over 90 degrees.
            scale = 1 / max(speed, 1e-9)
            ax, ay, az = vx * scale, vy * scale, vz * scale
            sign = -1.0 if az < 0 else 1.0
            qw, qx, qy = 1 + sign * az, -sign * ay, sign * ax
            norm = np.sqrt(qw * qw + qx * qx + qy * qy)
            for copy in range(copies):
                offset = (copy - (copies - 1) / 2) * (length / copies)
                x, y, z = dx + offset * ax, dy + offset * ay, dz + offset * az
                u = world_to_camera[0, 0] * x + world_to_camera[0, 1] * y + world_to_camera[0, 2] * z
                v = world_to_camera[1, 0] * x + world_to_camera[1, 1] * y + world_to_camera[1, 2] * z
                w = world_to_camera[2, 0] * x + world_to_camera[2, 1] * y + world_to_camera[2, 2] * z
                wide = max(w + reach, 0.0)
                if w < 0 or u < -edges[0] * wide - reach or u > edges[1] * wide + reach:
                    continue
                if v < -edges[2] * wide - reach or v > edges[3] * wide + reach:
                    continue
                n = m * max_copies + copy
                is_drawn[n] = True
                row = rows[n]
                row[0], row[1], row[2] = x + eye[0], y + eye[1], z + eye[2]
                row[3], row[4], row[5] = across_sigma, across_sigma, along_sigma
                row[6], row[7], row[8], row[9] = qw / norm, qx / norm, qy / norm, 0.0
                row[10] = opacity


# Lenses and rolling shutters

_ROW_STEPS = 6
_DERIVATIVE_STEP = 1e-3  # of the readout


@numba.njit(error_model="numpy")
@no_type_check
def _row_part(x, y, z, vx, vy, vz, part, turn, lens, scan):
    """Place of a drop in the frame of the camera at a part of the readout, and the part of the row where it is then."""
    x, y, z = turned_back(x + part * vx, y + part * vy, z + part * vz, part, turn)
    a, b, is_imaged = bent_place(x, y, z, lens)
    return x, y, z, scan[0] * a + scan[1] * b + scan[2], is_imaged


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _fill_through_lens(
    portion, positions, diameters, velocities, camera_velocity, moving, world_to_camera, eye, shift, turn, lens,
    by_distance, angle, numbers, max_copies, rows, is_drawn,
):  # fmt: skip
    """Write streaks as the camera has them at the times of their rows, in the world of its pose in the middle."""
    readout, scan = numbers[7], numbers[8:11]
    r = world_to_camera
    chunk_size = 256
    for chunk in range_of(portion, (len(positions) + chunk_size - 1) // chunk_size):
        for m in range(chunk * chunk_size, min(len(positions), (chunk + 1) * chunk_size)):
            px, py, pz = positions[m, 0] - eye[0], positions[m, 1] - eye[1], positions[m, 2] - eye[2]
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz
            vx, vy, vz = velocities[m, 0], velocities[m, 1], velocities[m, 2]
            # Over the whole readout, relative to the camera.
            dx = readout * (r[0, 0] * vx + r[0, 1] * vy + r[0, 2] * vz) - shift[0]
            dy = readout * (r[1, 0] * vx + r[1, 1] * vy + r[1, 2] * vz) - shift[1]
            dz = readout * (r[2, 0] * vx + r[2, 1] * vy + r[2, 2] * vz) - shift[2]
            part, stretch = 0.0, 1.0
            qx, qy, qz, row, is_imaged = _row_part(x, y, z, dx, dy, dz, 0.0, turn, lens, scan)
            if readout > 0 and is_imaged:
                for _ in range(_ROW_STEPS):  # Newton's method for the row in which the drop is when that is exposed
                    near = part + _DERIVATIVE_STEP
                    _, _, _, beyond, has_slope = _row_part(x, y, z, dx, dy, dz, near, turn, lens, scan)
                    slope = (beyond - row) / _DERIVATIVE_STEP if has_slope else 0.0
                    stretch = 1 / max(1 - slope, 1 / MAX_STRETCH)
                    part = min(max(part + stretch * (row - part), -1.0), 1.0)
                    qx, qy, qz, row, is_imaged = _row_part(x, y, z, dx, dy, dz, part, turn, lens, scan)
                    if not is_imaged:
                        break
            vx, vy, vz = vx - camera_velocity[0], vy - camera_velocity[1], vz - camera_velocity[2]
            ux = r[0, 0] * vx + r[0, 1] * vy + r[0, 2] * vz
            uy = r[1, 0] * vx + r[1, 1] * vy + r[1, 2] * vz
            uz = r[2, 0] * vx + r[2, 1] * vy + r[2, 2] * vz
            ux, uy, uz = turned_back(ux, uy, uz, part, turn)
            distance = max(np.sqrt(qx * qx + qy * qy + qz * qz), 1e-9)
            speed = np.sqrt(ux * ux + uy * uy + uz * uz)
            along_sight = (ux * qx + uy * qy + uz * qz) / distance
            across = np.sqrt(max(speed * speed - along_sight * along_sight, 0.0))
            depth = distance if by_distance else qz
            opacity, length, copies, across_sigma, along_sigma = _streak(
                diameters[m], speed, across, depth, moving, stretch, numbers, max_copies
            )
            reach = _REACH * along_sigma
            scale = 1 / max(speed, 1e-9)
            # Back to the world, in which the renderer has them.
            ax = scale * (r[0, 0] * ux + r[1, 0] * uy + r[2, 0] * uz)
            ay = scale * (r[0, 1] * ux + r[1, 1] * uy + r[2, 1] * uz)
            az = scale * (r[0, 2] * ux + r[1, 2] * uy + r[2, 2] * uz)
            sign = -1.0 if az < 0 else 1.0
            qw, q1, q2 = 1 + sign * az, -sign * ay, sign * ax
            norm = np.sqrt(qw * qw + q1 * q1 + q2 * q2)
            for copy in range(copies):
                offset = (copy - (copies - 1) / 2) * (length / copies) * scale
                wx, wy, wz = qx + offset * ux, qy + offset * uy, qz + offset * uz
                outside = np.sqrt(wx * wx + wy * wy) * np.cos(angle) - wz * np.sin(angle)
                if angle < np.pi and outside > reach and wx * wx + wy * wy + wz * wz > reach * reach:
                    continue
                n = m * max_copies + copy
                is_drawn[n] = True
                row_of = rows[n]
                row_of[0] = r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz + eye[0]
                row_of[1] = r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz + eye[1]
                row_of[2] = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz + eye[2]
                row_of[3], row_of[4], row_of[5] = across_sigma, across_sigma, along_sigma
                row_of[6], row_of[7], row_of[8], row_of[9] = qw / norm, q1 / norm, q2 / norm, 0.0
                row_of[10] = opacity

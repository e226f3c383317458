"""Rain as a medium: drops that are not drawn one by one extinguish light and scatter that of the sky.

A ray of length r through drops with the extinction coefficient beta keeps exp(-beta r) of its light; in exchange it
takes in as much of the airlight (Koschmieder 1924). Drops that are drawn as streaks take their own cross-section from
the ray, so that the medium is thinner where they are: both together extinguish exactly beta.
"""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float32, Float64

from ..kernels import kernel, range_of
from ..scene.camera import Camera
from ..scene.lens import PixelRays
from .settings import RainSettings

NEAREST_STREAK_M = 0.2  # nearer drops are not drawn
STEPS = 64  # of the table of the streaks' extinction over depth
_FAR_M = 1e9  # length of a ray to the sky
_LOWEST_M = 0.05  # height of a camera over a floor


@dataclass(frozen=True, slots=True, eq=False)
class RainMedium:
    """Extinction along the rays of one camera, and the light that takes the place of what is lost."""

    numbers: Float32[np.ndarray, "33"]
    """Extinction per m; step of the table in m; then, for the region of streaks and that of the medium, rotation from
    the camera's frame (rows), the camera's position in it, and half its edges; 1 if the medium has a region at the end.
    """
    drawn: Float32[np.ndarray, " steps"]
    """Optical depth that streaks take from the medium along the view axis, up to each step of depth."""
    airlight_linear: Float32[np.ndarray, "3"]
    floor: Float32[np.ndarray, "4"]
    """Upward direction in the camera's frame, and the camera's height in m over the floor; `_FAR_M` without one."""
    by_distance: bool = False
    """True if streaks reach up to a distance, as through a lens; false if up to a depth along the view axis."""

    @property
    def extinction_per_m(self) -> float:
        return float(self.numbers[0])

    def transmittance(self, points_m: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        """Share of light that arrives from points in the camera's frame (meters)."""
        kept = np.empty(len(points_m), np.float32)
        find = _transmittances_by_distance if self.by_distance else _transmittances
        find(np.ascontiguousarray(points_m, np.float32), self.numbers, self.drawn, kept)
        return kept

    def sky_transmittance(self, rays: PixelRays) -> Float32[np.ndarray, "h w"]:
        """Share of light from behind the scene that arrives at each pixel: from infinity, or from the floor."""
        directions = rays.directions
        fall = np.maximum(-(directions @ self.floor[:3]), np.float32(1 / _FAR_M))
        away = np.minimum(self.floor[3] / fall, np.float32(_FAR_M))
        return self.transmittance((directions * away[..., None]).reshape(-1, 3)).reshape(away.shape)

    @property
    def is_endless(self) -> bool:
        """True if all rays behind the scene go on to infinity."""
        return not self.has_region and bool(self.floor[3] >= _FAR_M)

    @property
    def has_region(self) -> bool:
        """True if the medium is limited to a box."""
        return bool(self.numbers[-1])


def make_medium(
    rain: RainSettings,
    extinction_per_m: float,
    camera: Camera,
    anchor_to_world: Float64[np.ndarray, "4 4"],
    streaks: tuple[float, Float64[np.ndarray, " steps"]],
    airlight_linear: Float32[np.ndarray, "3"],
    floor_m: float | None = None,
) -> RainMedium:
    """Make the medium of a camera; `streaks` is what `streak_depths` returns.

    At the height `floor_m`, rays that go down end, whatever the scene shows there: gaps in the ground of a capture are
    no view of distant air.
    """
    turn, origin = anchor_to_world[:3, :3], anchor_to_world[:3, 3]
    step_m, drawn = streaks
    numbers = [extinction_per_m, step_m]
    for box in (rain.streak_region, rain.haze_region):
        region = box or rain.streak_region
        center = turn @ np.array(region.center_m) + origin
        numbers += [*(turn.T @ camera.world_to_camera[:3, :3].T).ravel(), *(turn.T @ (camera.position - center))]
        numbers += [each / 2 for each in region.size_m]
    over_m = np.inf if floor_m is None else float(camera.position[2]) - floor_m
    numbers.append(float(rain.haze_region is not None))
    floor = np.array([*camera.world_to_camera[:3, 2], over_m if _LOWEST_M < over_m < _FAR_M else _FAR_M], np.float32)
    by_distance = camera.lens is not None
    return RainMedium(np.array(numbers, np.float32), drawn.astype(np.float32), airlight_linear, floor, by_distance)


NO_STREAKS = 1.0, np.zeros(STEPS)
"""Result of `streak_depths` where none are drawn."""


def streak_depths(
    rain: RainSettings,
    drops_per_m3: float,
    diameters_mm: Float64[np.ndarray, " classes"],
    class_far_m: Float64[np.ndarray, " classes"],
) -> tuple[float, Float64[np.ndarray, " steps"]]:
    """Step of depth in m, and the optical depth of streaks along the view axis up to each of `STEPS` steps."""
    reach_m = float(min(np.linalg.norm(rain.streak_region.size_m), class_far_m.max()))
    depths = np.linspace(0.0, reach_m, STEPS)
    # A drop takes its own cross-section from the image, half of what it extinguishes.
    areas_m2 = np.pi / 4 * (1e-3 * diameters_mm) ** 2
    order = np.argsort(class_far_m, kind="stable")  # nearly sorted
    far_m, area = class_far_m[order], np.append(np.cumsum(areas_m2[order][::-1])[::-1], 0.0) / len(areas_m2)
    fine = np.linspace(0.0, reach_m, 16 * STEPS + 1)
    per_m = rain.haze_gain * drops_per_m3 * area[np.searchsorted(far_m, fine)] * (fine >= NEAREST_STREAK_M)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (per_m[1:] + per_m[:-1]) * np.diff(fine))])
    return reach_m / (STEPS - 1), np.interp(depths, fine, total)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def optical_depth(x, y, z, numbers, drawn):
    """Optical depth of the medium up to a point in the camera's frame (meters)."""
    depth, first, last, slope = without_drawn(x, y, z, numbers)
    return less_drawn(depth, first, last, slope, numbers[1], drawn)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def depth_behind_scene(x, y, floor):
    """Depth in m at which the ray (x, y, 1) from the camera ends behind the scene: at the floor, or far away."""
    one, far = np.float32(1), np.float32(_FAR_M)
    z = one / np.sqrt(x * x + y * y + one)
    fall = -(floor[0] * x + floor[1] * y + floor[2]) * z
    return min(floor[3] / max(fall, one / far), far) * z


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def without_drawn(x, y, z, numbers):
    """Optical depth if no streak were drawn; depths between which streaks may be, and depth for a meter of ray.

    The last is infinite where there are none.
    """
    length = np.sqrt(x * x + y * y + z * z)
    enters, leaves = np.float32(0), length
    if numbers[32] > 0:
        enters, leaves = _within(x, y, z, length, numbers, 17)
    depth = numbers[0] * (leaves - enters)
    first, last = _within(x, y, z, length, numbers, 2)
    first, last = max(first, enters), min(last, leaves)
    slope = z / length
    return depth, first * slope, last * slope, slope if last > first and z > 0 else np.float32(np.inf)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def less_drawn(depth, first_m, last_m, slope, step_m, drawn):
    """Optical depth without the share that streaks between two depths carry."""
    taken = _drawn_up_to(last_m, step_m, drawn) - _drawn_up_to(first_m, step_m, drawn)
    return max(depth - (taken / slope if slope < np.float32(np.inf) else np.float32(0)), np.float32(0))


@numba.njit(error_model="numpy")
@no_type_check
def _optical_depth_by_distance(x, y, z, numbers, drawn):
    """Optical depth up to a point where streaks reach up to a distance, as `optical_depth`."""
    length = np.sqrt(x * x + y * y + z * z)
    enters, leaves = np.float32(0), length
    if numbers[32] > 0:
        enters, leaves = _within(x, y, z, length, numbers, 17)
    first, last = _within(x, y, z, length, numbers, 2)
    first, last = max(first, enters), min(last, leaves)
    taken = _drawn_up_to(last, numbers[1], drawn) - _drawn_up_to(first, numbers[1], drawn)
    return max(numbers[0] * (leaves - enters) - (taken if last > first else np.float32(0)), np.float32(0))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _within(x, y, z, length, n, at):
    """Distances in m at which a ray to a point enters and leaves a box, between 0 and its length."""
    enters, leaves = np.float32(0), length
    enters, leaves = _between(x, y, z, length, n[at], n[at + 1], n[at + 2], n[at + 9], n[at + 12], enters, leaves)
    enters, leaves = _between(x, y, z, length, n[at + 3], n[at + 4], n[at + 5], n[at + 10], n[at + 13], enters, leaves)
    enters, leaves = _between(x, y, z, length, n[at + 6], n[at + 7], n[at + 8], n[at + 11], n[at + 14], enters, leaves)
    return enters, max(leaves, enters)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _between(x, y, z, length, right, up, ahead, start, half, enters, leaves):
    """Cut a ray's distances to those between two faces of a box."""
    along = right * x + up * y + ahead * z
    inverse = length / (along if abs(along) > np.float32(1e-9) else np.float32(1e-9))
    near, far = (-half - start) * inverse, (half - start) * inverse
    return max(enters, min(near, far)), min(leaves, max(near, far))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _drawn_up_to(depth_m, step_m, drawn):
    at = min(max(np.float32(0), depth_m / step_m), np.float32(len(drawn) - 1))
    k = max(min(np.int32(at), np.int32(len(drawn) - 2)), np.int32(0))  # NaN has no row
    return drawn[k] + (at - np.float32(k)) * (drawn[k + 1] - drawn[k])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _transmittances(portion, points, numbers, drawn, kept):
    for i in range_of(portion, len(points)):
        kept[i] = np.exp(-optical_depth(points[i, 0], points[i, 1], points[i, 2], numbers, drawn))


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _transmittances_by_distance(portion, points, numbers, drawn, kept):
    for i in range_of(portion, len(points)):
        kept[i] = np.exp(-_optical_depth_by_distance(points[i, 0], points[i, 1], points[i, 2], numbers, drawn))

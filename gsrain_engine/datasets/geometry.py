"""Geometry of captures: rigid poses, projection, cameras, road height, up direction, lidar depth, tracked boxes."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from ..safe_io.errors import SceneFormatError
from ..scene.camera import Camera
from ..scene.geometry import matrices_from_quaternions, quaternions_from_matrices
from ..scene.lens import Lens, largest_tangent
from ..scene.scene import PoseTrack
from .capture import CaptureError, CaptureFrame, LidarSweep, TrackedBox

Pose = Float64[np.ndarray, "4 4"]
"""Rigid transform of points as columns."""

OPENCV_FROM_VEHICLE_AXES: Pose = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Rotates x forward, y left, z up into x right, y down, z forward."""

_NOT_RIGID, _FARTHEST_M = 1e-2, 1e9


def rigid_pose(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def heading_pose(center_m: Sequence[float], heading_rad: float) -> Pose:
    """Pose of an upright object, rotated about z from the x axis."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid_pose(turn, np.asarray(center_m, np.float64))


def translation_pose(translation: Float[np.ndarray, "3"]) -> Pose:
    """Pose without rotation."""
    return rigid_pose(np.eye(3), translation)


def rigid_from_quaternion(quaternion_wxyz: Any, translation: Any) -> Pose:
    """Pose of a quaternion (4 numbers, any length) and a translation (3); ValueError if invalid."""
    turn, place = np.asarray(quaternion_wxyz, np.float64), np.asarray(translation, np.float64)
    if turn.shape != (4,) or place.shape != (3,):
        raise ValueError("a pose has 4 numbers for its rotation (w x y z) and 3 for its translation")
    in_bounds = np.abs(turn).max() < _FARTHEST_M and np.abs(place).max() < _FARTHEST_M
    length = np.linalg.norm(turn) if in_bounds else 0.0
    if not length > 1e-6:
        raise ValueError("the numbers of a pose must be finite, its place on this planet and its quaternion not zero")
    return rigid_pose(matrices_from_quaternions(turn / length), place)


def rigid_from_numbers(values: Any) -> Pose:
    """Pose of 12 or 16 numbers by rows (nested or flat); ValueError if it is not rigid.

    Removes rounding errors of up to 1 % from the rotation.
    """
    numbers = np.asarray(values, np.float64)
    if numbers.size not in (12, 16):
        raise ValueError(f"a pose has 12 or 16 numbers, not {numbers.size}")
    rows = numbers.reshape(-1, 4)[:3]
    rotation = rows[:, :3]
    if not np.abs(rows).max() < _FARTHEST_M:
        raise ValueError("the numbers of a pose must be finite, and its place on this planet")
    if (
        np.abs(rotation).max() > 2
        or np.abs(rotation @ rotation.T - np.eye(3)).max() > _NOT_RIGID
        or np.linalg.det(rotation) < 0
    ):
        raise ValueError("a pose must be a rotation without scale or mirroring")
    return rigid_pose(matrices_from_quaternions(quaternions_from_matrices(rotation)), rows[:, 3])


def invert_pose(pose: Float[np.ndarray, "*n 4 4"]) -> Float64[np.ndarray, "*n 4 4"]:
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    matrix = np.zeros(pose.shape)
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = -(rotation @ pose[..., :3, 3:])[..., 0]
    matrix[..., 3, 3] = 1.0
    return matrix


@np.errstate(over="ignore", invalid="ignore")  # NaN stays NaN and is rejected by the caller
def transform_points(pose: Float[np.ndarray, "4 4"], points_m: Float[np.ndarray, "p 3"]) -> Float64[np.ndarray, "p 3"]:
    return points_m @ pose[:3, :3].T + pose[:3, 3]


def named_pose(values: Mapping[str, Any]) -> Pose:
    """Pose of {translation: {x y z}, rotation: {qw qx qy qz}}, as in DGP."""
    turn, place = values["rotation"], values["translation"]
    return rigid_from_quaternion([turn[f"q{axis}"] for axis in "wxyz"], [place[axis] for axis in "xyz"])


# Projection


def project_points(
    points: Float[np.ndarray, "p 3"], camera: Camera, lens: Lens | None = None
) -> tuple[Float64[np.ndarray, "p 2"], Float64[np.ndarray, " p"]]:
    """Pixel and depth along the view axis of each point; pixels are NaN behind the camera and outside the lens's range.

    Pixel centers are at half-integers: column and row are the integer parts.
    """
    local = np.asarray(points, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depths = np.ascontiguousarray(local[:, 2])
    pixels = np.full((len(local), 2), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangents = np.hypot(local[:, 0], local[:, 1]) / depths
        seen = (depths > 0) & (tangents <= largest_tangent(lens))
    if seen.any():
        pixels[seen] = _bent(local[seen], camera, lens)
    return pixels, depths


def _bent(local: Float64[np.ndarray, "p 3"], camera: Camera, lens: Lens | None) -> Float64[np.ndarray, "p 2"]:
    if lens is None:
        return local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    coefficients, still = np.array(lens.coefficients), np.zeros(3)
    rows = np.ascontiguousarray(local).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
    bent, _ = project(rows, still, still, intrinsics(camera), coefficients)
    return np.asarray(bent, np.float64).reshape(-1, 2)


def intrinsics(camera: Camera, first_center: float = 0.5) -> Float64[np.ndarray, "3 3"]:
    """Return K for pixels with the first center at `first_center`: 0.5 in GSRAIN, 0 in OpenCV."""
    shift = first_center - 0.5
    return np.array([[camera.fx, 0, camera.cx + shift], [0, camera.fy, camera.cy + shift], [0, 0, 1.0]])


# OpenCV calibrations: the first pixel's center is (0, 0), not (0.5, 0.5)


def opencv_camera(
    focal_px: tuple[float, float], center_px: tuple[float, float], size: tuple[int, int], world_to_camera: Pose
) -> Camera:
    """Build a camera (`size` is width, height); ValueError for an invalid calibration."""
    if not np.isfinite([*focal_px, *center_px]).all() or min(focal_px) <= 0:
        raise ValueError("its calibration has no focal length above 0 px")
    return Camera(*size, *focal_px, center_px[0] + 0.5, center_px[1] + 0.5, world_to_camera)


def opencv_camera_of_matrix(matrix: Float64[np.ndarray, "..."], size: tuple[int, int], world_to_camera: Pose) -> Camera:
    """Build a camera from a 3x3, 3x4 or 4x4 camera matrix."""
    if matrix.shape not in ((3, 3), (3, 4), (4, 4)):
        raise ValueError("its calibration has no 3x3 matrix of a camera")
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return opencv_camera((fx, fy), (cx, cy), size, world_to_camera)


_MAX_RADIAL_PX = 0.1  # error of a lens that another one stands for, in pixels; calibrations are rarely better


def radial_lens(radial: Sequence[float], tangential: tuple[float, float], camera: Camera) -> Lens:
    """OpenCV's lens for a polynomial 1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8, whose last term OpenCV lacks.

    OpenCV's rational function is fitted to it over the image (RealityCapture, Metashape and nerfstudio have k4).
    Raises ValueError if that is off by more than 0.1 px, or if the polynomial folds back inside the image.
    """
    farthest = [max(center, side - center) for center, side in ((camera.cx, camera.width), (camera.cy, camera.height))]
    corner = float(np.hypot(farthest[0] / camera.fx, farthest[1] / camera.fy))
    radii = np.linspace(0, 4 * corner, 4001)
    bent = radii * np.polynomial.polynomial.polyval(radii**2, [1.0, *radial])
    rising = np.maximum.accumulate(bent)
    end = int(np.searchsorted(rising, corner))
    if end == len(radii) or np.any(np.diff(bent[: end + 1]) <= 0):
        raise ValueError("has distortion (k1 to k4) that folds back inside the picture")
    squares, factors = radii[: end + 1] ** 2, bent[1 : end + 1] / radii[1 : end + 1]
    powers = np.stack([(squares[1:] / squares[-1]) ** k for k in (1, 2, 3)], axis=1)
    fitted = np.linalg.lstsq(np.hstack([powers, -powers * factors[:, None]]), factors - 1, rcond=None)[0]
    above, below = 1 + powers @ fitted[:3], 1 + powers @ fitted[3:]
    k1, k2, k3, k4, k5, k6 = np.concatenate([fitted[:3], fitted[3:]]) / np.tile(squares[-1] ** np.array([1, 2, 3.0]), 2)
    off_px = max(camera.fx, camera.fy) * float(np.max(np.abs(above / below - factors) * radii[1 : end + 1]))
    if np.any(below <= 0) or off_px > _MAX_RADIAL_PX:
        raise ValueError(
            f"has a fourth radial coefficient k4 = {radial[3]:g}, which OpenCV's lens is {off_px:.2g} px off"
        )
    return Lens("opencv", tuple(map(float, (k1, k2, *tangential, k3, k4, k5, k6))))


# Scaled images and checks of calibrations


def scaled_camera(camera: Camera, width: int, height: int) -> Camera:
    """Camera of the image scaled to another size in pixels, with unchanged field of view."""
    sx, sy = width / camera.width, height / camera.height
    return replace(
        camera, width=width, height=height, fx=camera.fx * sx, fy=camera.fy * sy, cx=camera.cx * sx, cy=camera.cy * sy
    )


def camera_of_image(camera: Camera, size: tuple[int, int], picture: str) -> Camera:
    """Adapt a calibration to an image that was scaled afterwards; `CaptureError` if the aspect ratio differs."""
    width, height = size
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        says = f"its camera says {camera.width}x{camera.height}, which has other proportions"
        raise CaptureError(f"{picture}: is {width}x{height} px, {says}")
    return scaled_camera(camera, width, height)


def checked_camera(camera: Camera, what: str) -> Camera:
    """Return the camera; `CaptureError` for impossible values (a size of 0, a pose that is not a rotation)."""
    try:
        return Camera.from_json({**camera.to_json(), "exposure_s": camera.exposure_s}, what)
    except SceneFormatError as error:
        raise CaptureError(str(error)) from None


# Road height

_NEAR_M, _LANE_M, _OWN_LENGTH_M, _OWN_WIDTH_M = 15.0, 4.0, 2.0, 1.2
_SLACK_M, _BIN_M, _MINIMUMS = 1.0, 0.05, 50


def road_height(clouds: Iterable[Float[np.ndarray, "_ 3"]], expected_m: float) -> float:
    """Height (m) of the road under the vehicle's origin, in the vehicle's frame (x forward, y left, z up).

    `clouds` are points of some sweeps in that frame, `expected_m` is the dataset's value. Fits a plane to the lowest
    well-filled layer within 15 m and the width of a lane (curbs lie outside it), and evaluates it below the origin.
    Returns `expected_m` if too few points lie within 1 m of it.
    """
    points = np.concatenate([np.zeros((0, 3)), *(_near_road(cloud, expected_m) for cloud in clouds)])
    if len(points) < _MINIMUMS:
        return expected_m
    count, edges = np.histogram(points[:, 2], np.arange(-_SLACK_M, _SLACK_M + _BIN_M, _BIN_M) + expected_m)
    layer = edges[int(np.argmax(count >= 0.5 * count.max()))] + _BIN_M
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    plane, width = np.array([layer, 0.0, 0.0]), 0.3
    for _ in range(4):
        inside = np.abs(points[:, 2] - design @ plane) < width
        if np.count_nonzero(inside) < _MINIMUMS:
            break
        plane = np.linalg.lstsq(design[inside], points[inside, 2], rcond=None)[0]
        width = max(width / 1.5, 0.1)
    return float(np.clip(plane[0], expected_m - _SLACK_M, expected_m + _SLACK_M))


def _near_road(cloud: Float[np.ndarray, "p 3"], expected_m: float) -> Float[np.ndarray, "q 3"]:
    flat = np.abs(cloud[:, :2])
    near = (flat[:, 0] < _NEAR_M) & (flat[:, 1] < _LANE_M) & (np.abs(cloud[:, 2] - expected_m) < _SLACK_M)
    own = (flat[:, 0] < _OWN_LENGTH_M) & (flat[:, 1] < _OWN_WIDTH_M)
    return np.asarray(cloud[near & ~own], np.float64)


# Up direction

_TIE_BREAK = 0.02  # weight of the images' mean up direction relative to level right axes: it only resolves ambiguities
_FLAT = 0.02  # positions are coplanar or collinear if their smallest variance is below this fraction of the largest
_STEEPEST_DRIVE = 0.5
"""Maximum cosine between course and image up for a road; steeper courses are those of lifts or drones."""


def estimate_up_direction(cameras: Sequence[Camera]) -> tuple[float, float, float]:
    """Estimate the unit upward direction in the world's axes.

    Image rows are usually level, so up is the direction most orthogonal to all right axes. Cameras that all look one
    way leave the pitch undetermined; then up is also orthogonal to a flat course, otherwise the images' mean up.
    """
    rotations = np.stack([camera.world_to_camera[:3, :3] for camera in cameras])
    right, upright = rotations[:, 0], -rotations[:, 1].mean(axis=0)
    length = np.linalg.norm(upright)
    if length < 1e-9:
        return (0.0, 0.0, 1.0)
    upright = upright / length
    against = right.T @ right / len(right) + _course(cameras, upright)
    against += _TIE_BREAK * (np.eye(3) - np.outer(upright, upright))
    up = np.linalg.eigh(against)[1][:, 0]
    up = up if up @ upright > 0 else -up
    return (float(up[0]), float(up[1]), float(up[2]))


def _course(cameras: Sequence[Camera], upright: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Penalty on the course direction of the cameras; zero if they moved upward, or in all directions."""
    places = np.stack([camera.position for camera in cameras])
    scatter = np.cov(places.T, bias=True) if len(places) > 2 else np.zeros((3, 3))
    variances, directions = np.linalg.eigh(scatter)
    course = directions[:, 2]
    is_flat = variances[2] > 1e-12 and variances[0] <= _FLAT * variances[2]
    is_level = abs(course @ upright) <= _STEEPEST_DRIVE
    return np.outer(course, course) if is_flat and is_level else np.zeros((3, 3))


# Lidar depth

_BEAM_GAP_DEG = (0.6, 1.5)
"""Largest gap between adjacent beams to be bridged, horizontal and vertical, for a lidar with 32 beams."""

_NEARER_PART, _NEARER_M, _NEAREST_M = 0.05, 0.3, 0.1


def lidar_depth(view: CaptureFrame, sweeps: Sequence[LidarSweep]) -> Float32[np.ndarray, "h w"]:
    """Meters along the view axis at the nearest lidar point of each pixel; 0 elsewhere. Includes the lens distortion.

    The lidar's position differs from the camera's, so it also measures surfaces occluded from the camera: a point
    counts as occluded if nearer points lie in three of the four quadrants around it, within the gaps between beams.
    """
    nearest = _nearest(view, [sweep.points_m for sweep in sweeps], _NEAREST_M)
    nearest[_hidden(nearest, view)] = np.inf
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def point_depth(view: CaptureFrame, points: Float[np.ndarray, "p 3"]) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis, in the world's unit, of the nearest point in each pixel; 0 without a point."""
    nearest = _nearest(view, [points], 0.0)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def _nearest(
    view: CaptureFrame, clouds: Sequence[Float[np.ndarray, "_ 3"]], from_depth: float
) -> Float32[np.ndarray, "h w"]:
    size = (view.camera.height, view.camera.width)
    nearest = np.full(size, np.inf, np.float32)
    for cloud in clouds:
        pixels, depths = project_points(cloud, view.camera, view.lens)
        rows, columns, inside = pixels_inside(pixels, size)
        used = inside & (depths > from_depth)
        np.minimum.at(nearest, (rows[used], columns[used]), depths[used].astype(np.float32))
    return nearest


def pixels_inside(
    pixels: Float64[np.ndarray, "p 2"], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, Bool[np.ndarray, " p"]]:
    """Rows and columns of pixels (0 if outside), and a mask of those inside an image of (height, width)."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < size[1]) & (pixels[:, 1] < size[0])
    whole = np.where(inside[:, None], pixels, 0).astype(np.int64)
    return whole[:, 1], whole[:, 0], inside


def nearest_sweep(view: CaptureFrame, sweeps: Sequence[LidarSweep]) -> LidarSweep | None:
    return min(sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s), default=None)


def _hidden(nearest: Float32[np.ndarray, "h w"], view: CaptureFrame) -> Bool[np.ndarray, "h w"]:
    """Mask of points with nearer ones in three of the four quadrants, which exclude the point's own row."""
    across, up = np.tan(np.radians(_BEAM_GAP_DEG))
    columns = max(round(view.camera.fx * across), 1) + 1
    rows = max(round(view.camera.fy * up), 1)
    window = np.ones((rows, columns), np.uint8)
    edge = np.full((1, nearest.shape[1]), np.inf, np.float32)
    above, below = np.concatenate([edge, nearest[:-1]]), np.concatenate([nearest[1:], edge])
    far_enough = nearest * (1 - _NEARER_PART) - _NEARER_M
    around = np.zeros(nearest.shape, np.uint8)
    for next_row, anchor_row in ((above, rows - 1), (below, 0)):
        for anchor_column in (0, columns - 1):
            minimum = cv2.erode(next_row, window, anchor=(anchor_column, anchor_row), borderValue=np.inf)
            around += minimum < far_enough
    return (around >= 3) & np.isfinite(nearest)


# Boxes over time

_LONGEST_M = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class BoxSample:
    """One annotation: a box at one time."""

    id: str
    class_name: str
    time_s: float
    size_lwh: tuple[float, float, float]
    """Length, width and height in meters."""
    center_to_world: Pose
    """Box (x forward, y left, z up, origin at its center) to world."""

    def __post_init__(self) -> None:
        if not all(0 < side < _LONGEST_M for side in self.size_lwh):
            raise ValueError(f"box {self.id!r} has sides {self.size_lwh}, expected 0 to {_LONGEST_M:g} m")
        if not (np.isfinite(self.center_to_world).all() and np.isfinite(self.time_s)):
            raise ValueError(f"box {self.id!r} has a pose or a time that is not finite")


def tracked_boxes(samples: Iterable[BoxSample], times_s: Sequence[float]) -> tuple[TrackedBox, ...]:
    """Join the annotations of each object; `times_s` are all annotated times, with or without boxes.

    An object exists from half-way after the last time without it to half-way before the next one. Its motion is
    extrapolated there, and as far outside the annotated times, because cameras fire between sweeps. Sizes are medians.
    """
    stamps = np.unique([time for time in times_s if np.isfinite(time)])
    by_id: dict[str, dict[int, BoxSample]] = defaultdict(dict)
    for sample in samples:
        by_id[sample.id][int(np.argmin(np.abs(stamps - sample.time_s)))] = sample
    return tuple(_tracked(found, stamps) for found in by_id.values())


def _tracked(found: dict[int, BoxSample], stamps: Float64[np.ndarray, " t"]) -> TrackedBox:
    rows: list[tuple[float, Pose, bool]] = []
    indices = sorted(found)
    for run in (part.tolist() for part in np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)):
        poses = [_bottom_to_world(found[index]) for index in run]
        before, after = _half_gap(stamps, run[0], -1), _half_gap(stamps, run[-1], +1)
        if not rows and run[0] > 0:
            rows.append((float(stamps[run[0] - 1]), poses[0], False))
        times = [float(stamps[index]) for index in run]
        if before:
            rows.append((times[0] - before, _moved_on(poses[0], poses[1:2], times[:2], -before), True))
        rows += [(time, pose, True) for time, pose in zip(times, poses, strict=True)]
        if after:
            ended = run[-1] < len(stamps) - 1
            rows.append((times[-1] + after, _moved_on(poses[-1], poses[-2:-1], times[-2:], after), not ended))
    matrices = np.stack([pose for _, pose, _ in rows])
    quaternions = quaternions_from_matrices(matrices[:, :3, :3])
    valid = np.array([present for _, _, present in rows])
    track = PoseTrack(np.array([time for time, _, _ in rows]), matrices[:, :3, 3].copy(), quaternions, valid)
    length, width, height = np.median([each.size_lwh for each in found.values()], axis=0).tolist()
    first = next(iter(found.values()))
    return TrackedBox(first.id, first.class_name, (length, width, height), track)


def _bottom_to_world(box: BoxSample) -> Pose:
    """Pose with the same axes, origin at the bottom center."""
    matrix = box.center_to_world.copy()
    matrix[:3, 3] -= matrix[:3, 2] * (box.size_lwh[2] / 2)
    return matrix


def _half_gap(stamps: Float64[np.ndarray, " t"], index: int, side: int) -> float:
    """Half the time to the neighbor on one side; at an end of the drive, to that on the other side."""
    other = index + side if 0 <= index + side < len(stamps) else index - side
    return float(abs(stamps[other] - stamps[index]) / 2) if 0 <= other < len(stamps) else 0.0


def _moved_on(pose: Pose, neighbors: Sequence[Pose], times: Sequence[float], by_s: float) -> Pose:
    """Extrapolate a pose in time by the velocity between it and its neighbor."""
    matrix = pose.copy()
    if neighbors:
        step = pose[:3, 3] - neighbors[0][:3, 3]
        matrix[:3, 3] += step / abs(times[1] - times[0]) * abs(by_s)
    return matrix

"""Orientation and scale of a scene: up direction and ground from points or RANSAC, and the unit length."""

import logging
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np
from jaxtyping import Float64

from ...choices import UNIT_M, Axis
from ...scene.camera_path_edit import WALKING_M_S, with_constant_speed
from ...scene.geometry import matrices_from_quaternions
from ...scene.scene import Scene

"""Range of valid lengths of a scene unit, in meters."""

_SAMPLES, _TRIES = 100_000, 400
_STEEPEST_COS = 0.5  # minimum cosine of the ground's slope; steeper ground means that `up` is entirely wrong
_FLAT = 0.6  # maximum ratio of the thinnest axis of a flat Gaussian to its middle one
_TOLERANCE = 0.008  # maximum distance of ground points from the plane, as a share of the scene's extent
_BELOW = 2.0  # votes that a plane loses per sample below it: a roof has more of the scene below it than lies on it
_FEWEST_SHARE = 0.05
_PART = 0.2  # share of a plane that is ground in any case; less above much else is part of an object, as soil in a pot
_PREFERENCE = 1.5  # of the present axis over others, whose walls are large, too
_CAMERA_HEIGHT_M = 1.5
_STRAY_SHARE = 0.005  # of the samples, which the lowest point leaves out
logger = logging.getLogger("gsrain")


class GroundPlaneFit(NamedTuple):
    """A plane of the world, meters."""

    up: Float64[np.ndarray, "3"]
    """Unit normal, upward."""
    point_m: Float64[np.ndarray, "3"]
    share: float
    """Share of the scene's samples that lie on the plane."""
    share_below: float
    """Share of the samples that lie clearly below it."""


def oriented(scene: Scene, up: str | None = None, metres_per_unit: float | None = None) -> Scene:
    """Return the scene with another up axis and unit length; None leaves either unchanged.

    Files of Gaussians contain neither. A new up axis resets the ground height. Raises `ValueError` for an invalid axis
    or length.
    """
    if up is not None:
        if up not in get_args(Axis):
            raise ValueError(f"up {up!r}: expected one of {', '.join(get_args(Axis))}")
        sign, component = (-1.0 if up.startswith("-") else 1.0), "xyz".index(up[-1])
        x, y, z = (sign if axis == component else 0.0 for axis in range(3))
        if (x, y, z) != scene.up:
            scene = _with_water_found(replace(scene, up=(x, y, z), ground_m=None, water=None))
        scene = replace(scene, up_is_assumed=False) if scene.up_is_assumed else scene
    if metres_per_unit is None:
        return scene
    low, high = UNIT_M
    if not low <= metres_per_unit <= high:
        raise ValueError(f"scale {metres_per_unit:g}: must be within {low:f}..{high:.0f} meters per unit")
    return set_length(scene, scene.metres_per_unit, metres_per_unit)


def level_to(scene: Scene, up: Float64[np.ndarray, "3"], point_m: Float64[np.ndarray, "3"]) -> Scene:
    """Rotate the world so that a direction points up, and set the ground to the height of a point."""
    rotation = scene.scene_to_world[:3, :3] / scene.metres_per_unit
    x, y, z = np.round(rotation.T @ (up / np.linalg.norm(up)), 12).tolist()  # exact axes stay exact
    turned = replace(scene, up=(x, y, z), up_is_assumed=False, water=None)
    to_new = turned.scene_to_world @ np.linalg.inv(scene.scene_to_world)
    return _with_water_found(replace(turned, ground_m=float(to_new[2, :3] @ point_m + to_new[2, 3])))


def _with_water_found(scene: Scene) -> Scene:
    """Scene whose map of water is found anew in another world, if it has wet colors."""
    if not scene.has_rainy_light:
        return scene
    from ...appearance.wet_look.water_map import with_water_map  # loads slow parts of scipy

    return with_water_map(scene)


def level_from_points(scene: Scene, points_m: Float64[np.ndarray, "3 3"]) -> Scene:
    """Level a scene by three points of the ground, in the world; raises `ValueError` if they are collinear."""
    across, along = points_m[1] - points_m[0], points_m[2] - points_m[0]
    normal = np.cross(across, along)
    if np.linalg.norm(normal) < 1e-3 * np.linalg.norm(across) * np.linalg.norm(along) or not normal.any():
        raise ValueError("The three points lie on one line: pick them in a triangle, as large as can be.")
    return level_to(scene, normal if normal[2] >= 0 else -normal, points_m.mean(axis=0))


def level_from_ground(scene: Scene) -> Scene:
    """Level a scene by its detected ground; raises `ValueError` if none is found."""
    ground = find_ground(scene)
    return level_to(scene, ground.up, ground.point_m)


def guess_orientation(scene: Scene) -> Scene:
    """Level a scene by its ground below the most likely of the six axes, and scale it by its camera path.

    The present axis stays up unless another one has a ground that holds half as much more of the scene, less twice the
    share of what lies below it. Where the unit is assumed and the scene has a camera path above the ground, that
    becomes 1.5 m high, as of a person or a car.

    Without ground below any axis, as below an object that was cut out, the present axis stays up, and the ground is at
    the lowest point of what can be seen.
    """
    candidates: list[tuple[float, Scene]] = []
    for turned in (scene, *(oriented(scene, axis) for axis in get_args(Axis))):
        try:
            ground = find_ground(turned)
        except ValueError:
            continue
        score = max(ground.share - _BELOW * ground.share_below, 0.0)
        if score > 0 or ground.share > _PART:
            candidates.append((_PREFERENCE * score if turned is scene else score, turned))
    if not candidates:
        return _on_lowest_point(scene)
    leveled = level_from_ground(max(candidates, key=lambda each: each[0])[1])
    try:
        return set_camera_height(leveled, _CAMERA_HEIGHT_M) if scene.unit_is_assumed else leveled
    except ValueError:  # without a camera path, nothing tells the scale
        return leveled


def _on_lowest_point(scene: Scene) -> Scene:
    """Set the ground to the lowest point of what can be seen, but for a few strays; nothing without any."""
    points, _ = _samples(scene, np.random.default_rng(0))
    if not len(points):
        points, _ = _samples(scene, np.random.default_rng(0), min_opacity=0.0)
    if not len(points):
        return scene
    logger.info("No ground was found below the scene: it is at the lowest point. Up and Ground correct it.")
    return set_ground_height(scene, float(np.quantile(points[:, 2], _STRAY_SHARE)))


def set_ground_height(scene: Scene, height_m: float) -> Scene:
    """Set the height of the ground above the origin of the world, in meters."""
    return replace(scene, ground_m=float(height_m))


def find_ground(scene: Scene, seed: int = 0) -> GroundPlaneFit:
    """Find the lowest large plane of the visible background by RANSAC (Fischler and Bolles 1981).

    Flat Gaussians whose normals are within 60 degrees of vertical vote; a plane loses two votes for each sample below
    it. A least-squares fit to its voters refines the best plane.

    Raises `ValueError` if fewer than a twentieth of the samples lie on it.
    """
    points, normals = _samples(scene, np.random.default_rng(seed))
    facing = np.abs(normals[:, 2]) > _STEEPEST_COS
    voters = points[facing] if facing.sum() > _FEWEST_SHARE * len(points) else points
    if len(voters) < 3:
        raise ValueError("No ground was found: too little of the scene can be seen.")
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    tolerance = _TOLERANCE * float(np.linalg.norm(high - low))
    up, point = _winner(points, voters, tolerance, np.random.default_rng(seed))
    for width in (1.0, 0.5, 0.25):  # converge to the middle of a thick ground
        near = voters[np.abs((voters - point) @ up) < width * tolerance]
        if len(near) < 3:
            break
        point = near.mean(axis=0)
        up = np.linalg.svd(near - point, full_matrices=False)[2][2]
        up = up if up[2] >= 0 else -up
    share = float((np.abs((voters - point) @ up) < tolerance).sum() / len(points))
    if share < _FEWEST_SHARE or up[2] < _STEEPEST_COS:  # the refined plane of a wall has its slope
        raise ValueError("No ground was found: no plane holds enough of the scene. Level it by three points (window).")
    return GroundPlaneFit(up, point, share, float(((points - point) @ up < -3 * tolerance).mean()))


def _winner(
    points: Float64[np.ndarray, "n 3"],
    voters: Float64[np.ndarray, "m 3"],
    tolerance: float,
    random: np.random.Generator,
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Unit normal and a point of the plane with the most votes, from a few thousand samples."""
    few = points[random.permutation(len(points))[:4000]]
    few_voters = voters[random.permutation(len(voters))[:4000]]
    weight = len(voters) / len(few_voters), len(points) / len(few)
    best, winner = -np.inf, (np.array([0.0, 0.0, 1.0]), voters[np.argmin(voters[:, 2])])
    for three in random.integers(0, len(voters), (_TRIES, 3)):
        a, b, c = voters[three]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-12 or abs(normal[2]) < _STEEPEST_COS * length:
            continue
        normal = normal / (length if normal[2] > 0 else -length)
        on_plane = np.abs((few_voters - a) @ normal) < tolerance
        below = (few - a) @ normal < -3 * tolerance
        votes = weight[0] * on_plane.sum() - _BELOW * weight[1] * below.sum()
        if votes > best:
            best, winner = votes, (normal, a)
    return winner


def _samples(
    scene: Scene, random: np.random.Generator, min_opacity: float = 0.5
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Centers of Gaussians above an opacity in the world, and their normals, which are zero if not flat."""
    points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for layer in scene.layers:
        part = scene.part(layer)
        if not layer.visible or layer.kind == "sky" or part is None:
            continue
        solid = part.gaussians.opacities > min_opacity
        if part.left_out is not None:
            solid &= ~part.left_out.flags
        where = random.permutation(np.flatnonzero(solid))[:_SAMPLES]
        gaussians = part.gaussians.take(where)
        scale = float(np.cbrt(np.linalg.det(part.to_world[:3, :3])))
        ordered = np.sort(gaussians.scales, axis=1)
        axes = matrices_from_quaternions(gaussians.quaternions.astype(np.float64))
        thinnest = np.take_along_axis(axes, np.argmin(gaussians.scales, axis=1)[:, None, None], axis=2)[..., 0]
        flat = ordered[:, 0] < _FLAT * ordered[:, 1]
        points.append(gaussians.means.astype(np.float64) @ part.to_world[:3, :3].T + part.to_world[:3, 3])
        normals.append(np.where(flat[:, None], thinnest @ (part.to_world[:3, :3] / scale).T, 0.0))
    return np.concatenate(points), np.concatenate(normals)


def set_length(scene: Scene, measured_m: float, true_m: float) -> Scene:
    """Scale the world so that a measured length becomes its true length.

    Everything in scene units scales along: layers, tracks, the ego's drive, camera paths, and the ground height. Values
    in meters stay: rig mounts and rain regions. An untimed camera path gets new times. Raises `ValueError` if a length
    is not above 0.
    """
    if not (measured_m > 0 and true_m > 0 and np.isfinite(measured_m * true_m)):
        raise ValueError(f"Lengths must be above 0 m, not {measured_m:g} m and {true_m:g} m.")
    factor = true_m / measured_m
    ground = None if scene.ground_m is None else scene.ground_m * factor
    metres_per_unit, path = scene.metres_per_unit * factor, scene.path
    if path is not None and not path.is_timed:
        path = with_constant_speed(path, WALKING_M_S / metres_per_unit)
    water = None if scene.water is None else scene.water.scaled(factor)
    return replace(
        scene, metres_per_unit=metres_per_unit, ground_m=ground, water=water, path=path, unit_is_assumed=False
    )


def set_camera_height(scene: Scene, height_m: float) -> Scene:
    """Scale the world so that the median height of the camera path above the ground is `height_m`.

    Photogrammetry of a drive has no scale, but the mounting height of a camera on a car is known. Raises `ValueError`
    if path or ground are missing, or if the path is not above the ground.
    """
    if scene.path is None or scene.ground_m is None:
        missing = "camera path" if scene.path is None else "known height of the ground: level it first"
        raise ValueError(f"The scene has no {missing}.")
    up = scene.scene_to_world[2]
    above_m = float(np.median(scene.path.positions @ up[:3] + up[3])) - scene.ground_m
    if not above_m > 0:
        raise ValueError(f"The camera path is {-above_m:.3g} m below the ground: which way is up must be wrong.")
    return set_length(scene, above_m, height_m)

"""How long a metre is: the scene's unit from a length that is known."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.paths.pace import WALKING_M_S, paced
from gsrain_engine.scene.scene import Scene


def distance_m(first: Float64[np.ndarray, "3"], second: Float64[np.ndarray, "3"]) -> float:
    """Distance between two points of the world."""
    return float(np.linalg.norm(second - first))


def set_length(scene: Scene, measured_m: float, true_m: float) -> Scene:
    """Scale the world so that what measured so many metres is as long as it truly is.

    Everything that stands in scene units grows along: layers, tracks, the ego's drive, camera paths. What is in metres
    stays as it is: rig mounts and rain regions; the ground's height follows, and so do the times of a camera path that
    has none of its own. Raises `ValueError` where a length is not above 0.
    """
    if not (measured_m > 0 and true_m > 0 and np.isfinite(measured_m * true_m)):
        raise ValueError(f"Lengths must be above 0 m, not {measured_m:g} m and {true_m:g} m.")
    factor = true_m / measured_m
    ground = None if scene.ground_m is None else scene.ground_m * factor
    metres_per_unit = scene.metres_per_unit * factor
    path = scene.path
    if path is not None and not path.is_timed:
        path = paced(path, WALKING_M_S / metres_per_unit)
    return replace(scene, metres_per_unit=metres_per_unit, ground_m=ground, path=path, unit_is_assumed=False)


def set_camera_height(scene: Scene, height_m: float) -> Scene:
    """Scale the world so that the scene's camera path is so high above its ground, at the median.

    A camera on a car is where one knows how high: photogrammetry of a drive gets its metre from that. Raises
    `ValueError` where path or ground aren't known, or the path is not above the ground.
    """
    if scene.path is None or scene.ground_m is None:
        lacking = "camera path" if scene.path is None else "known height of the ground: level it first"
        raise ValueError(f"The scene has no {lacking}.")
    up = scene.scene_to_world[2]
    above_m = float(np.median(scene.path.positions @ up[:3] + up[3])) - scene.ground_m
    if not above_m > 0:
        raise ValueError(f"The camera path is {-above_m:.3g} m below the ground: which way is up must be wrong.")
    return set_length(scene, above_m, height_m)

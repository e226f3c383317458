"""How long a metre is: the scene's unit from a length that is known."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene


def distance_m(first: Float64[np.ndarray, "3"], second: Float64[np.ndarray, "3"]) -> float:
    """Distance between two points of the world."""
    return float(np.linalg.norm(second - first))


def set_length(scene: Scene, measured_m: float, true_m: float) -> Scene:
    """Scale the world so that what measured so many metres is as long as it truly is.

    Everything that stands in scene units grows along: layers, tracks, the ego's drive, camera paths. What is in metres
    stays as it is: rig mounts and rain regions; the ground's height follows. Raises `ValueError` where a length is not
    above 0.
    """
    if not (measured_m > 0 and true_m > 0 and np.isfinite(measured_m * true_m)):
        raise ValueError(f"Lengths must be above 0 m, not {measured_m:g} m and {true_m:g} m.")
    factor = true_m / measured_m
    ground = None if scene.ground_m is None else scene.ground_m * factor
    return replace(scene, metres_per_unit=scene.metres_per_unit * factor, ground_m=ground)

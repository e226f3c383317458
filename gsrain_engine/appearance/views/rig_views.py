"""Views from the ego vehicle's rig, spread over the way it drives. World frame (metres, z up)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import RigCamera, Scene

from .placed_camera import PlacedCamera


def along_the_way(scene: Scene, count: int, sensors: Sequence[str] = ()) -> list[PlacedCamera]:
    """Spread views over the way driven: the camera that looks forward at every other one, the others in turn between.

    Args:
        scene: With an ego vehicle and a rig.
        count: Of views; those at times when there is no ego are left out.
        sensors: Only these cameras of the rig; empty for all.

    Raises:
        ValueError: Where there is no rig, no such camera in it, or no way.
    """
    rig = next((cameras for cameras in scene.rigs.values() if cameras), ())
    if scene.ego is None or not scene.ego.valid.any() or not rig:
        raise ValueError(f"scene {scene.name!r} has no ego vehicle with a camera rig")
    chosen = [each for each in rig if not sensors or each.name in sensors]
    if not chosen:
        names = ", ".join(each.name for each in rig)
        raise ValueError(f"scene {scene.name!r}: its rig has no camera {', '.join(sensors)}, only {names}")
    ordered = sorted(chosen, key=lambda each: -each.camera_to_ego[0, 2])  # forward is +x of the ego frame
    front, others = ordered[0], ordered[1:] or ordered
    placed: list[PlacedCamera] = []
    for i, time_s in enumerate(_evenly_driven(scene.ego.times, scene.ego.positions, count)):
        mounted = front if i % 2 == 0 else others[i // 2 % len(others)]
        ego_to_world = scene.ego_to_world(time_s)
        if ego_to_world is not None:
            camera = _placed(mounted, ego_to_world @ mounted.camera_to_ego)
            placed.append(PlacedCamera(f"{mounted.name}_{i:03d}", camera, time_s, mounted.name))
    return placed


def _evenly_driven(times: Float64[np.ndarray, " t"], positions: Float64[np.ndarray, "t 3"], count: int) -> list[float]:
    """Times at which equal shares of the way are driven; of time, where the vehicle stands still."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    if driven[-1] <= 0:
        driven = times - times[0]
    shares = (np.arange(count) + 0.5) / count
    return [float(t) for t in np.interp(shares * driven[-1], driven, times)]


def _placed(mounted: RigCamera, camera_to_world: Float64[np.ndarray, "4 4"]) -> Camera:
    return Camera(
        mounted.width, mounted.height, mounted.fx, mounted.fy, mounted.cx, mounted.cy,
        np.linalg.inv(camera_to_world), mounted.exposure_s,
    )  # fmt: skip

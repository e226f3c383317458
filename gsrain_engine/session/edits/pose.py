"""Where a layer lies as numbers a person edits: position, turn, scale in the world."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene

from .members import unlocked
from .moving import move_member


@dataclass(frozen=True)
class Pose:
    """A similarity of the world, taken apart."""

    position_m: tuple[float, float, float]
    """Where the origin of the layer's own axes lies."""
    turn_deg: tuple[float, float, float]
    """About the world's x, y and z, one after the other."""
    scale: float
    """Factor of size."""

    @property
    def matrix(self) -> Float64[np.ndarray, "4 4"]:
        matrix = np.eye(4)
        matrix[:3, :3] = (
            self.scale * scipy.spatial.transform.Rotation.from_euler("xyz", self.turn_deg, degrees=True).as_matrix()
        )
        matrix[:3, 3] = self.position_m
        return matrix


def pose_of(matrix: Float64[np.ndarray, "4 4"]) -> Pose:
    """Take a similarity apart; where the turn about y is a right angle, the one about z is 0."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    rotation = scipy.spatial.transform.Rotation.from_matrix(matrix[:3, :3] / scale)
    sine = (rotation.as_matrix())[2, 0]
    if abs(sine) > 1 - 1e-12:  # SciPy would warn: two of the angles turn about the same axis
        m = rotation.as_matrix()
        turn = (float(np.degrees(np.arctan2(-sine * m[0, 1], m[1, 1]))), float(-90.0 * np.sign(sine)), 0.0)
    else:
        x, y, z = rotation.as_euler("xyz", degrees=True).tolist()
        turn = (x, y, z)
    x, y, z = matrix[:3, 3].tolist()
    return Pose((x, y, z), turn, scale)


def layer_pose(scene: Scene, key: str, time_s: float = 0.0) -> Pose | None:
    """How far a member was moved from where its file, or its track, has it in a world of the scene's axes.

    For a layer that was never moved: position 0, turn 0, scale 1. An actor's is its pose at a time in the world, with
    scale 1; None while it is not there.
    """
    member, to_world = scene.member(key), scene.scene_to_world
    if key.startswith("layers/"):
        way = member.way(time_s)
        assert way is not None
        return pose_of(to_world @ way @ np.linalg.inv(to_world))
    way = member.way(time_s)
    if way is None:
        return None
    pose = to_world @ way
    pose[:3, :3] /= scene.metres_per_unit
    return pose_of(pose)


def set_layer_pose(scene: Scene, key: str, pose: Pose, time_s: float = 0.0) -> Scene:
    """Move a member to where `layer_pose` gives these numbers; an actor with its whole track.

    Raises `ValueError` where there is none, it is locked, it is not there at the time, or the scale is not above 0.
    """
    member = unlocked(scene, key)
    if not pose.scale > 0:
        raise ValueError(f"The scale of {member.name} must be above 0, not {pose.scale:g}.")
    before = layer_pose(scene, key, time_s)
    if before is None:
        raise ValueError(f"{member.name} is not there at {time_s:.2f} s.")
    return move_member(scene, key, pose.matrix @ np.linalg.inv(before.matrix))

"""Actors as things that drive: moved with their whole track, turned, driving at other times."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.flattening import moved
from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.rotations import quaternion_product
from gsrain_engine.scene.scene import Scene

from .members import unlocked


def moved_actor(actor: Actor, similarity: Float64[np.ndarray, "4 4"]) -> Actor:
    """Move an actor with its whole track by a similarity of the scene; its Gaussians take the scale."""
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    scaling = np.diag([scale, scale, scale, 1.0])
    is_rigid = abs(scale - 1) < 1e-12
    length, width, height = actor.size_lwh
    return replace(
        actor,
        track=actor.track.moved(similarity),
        gaussians=actor.gaussians if is_rigid else moved(actor.gaussians, scaling),
        size_lwh=actor.size_lwh if is_rigid else (scale * length, scale * width, scale * height),
    )


def turn_actor(scene: Scene, key: str, left_deg: float) -> Scene:
    """Turn an actor in place, to the left about its own z axis, at every moment; it drives where it drove.

    Raises `ValueError` where there is no such actor or it is locked.
    """
    actor = _unlocked_actor(scene, key)
    half = np.radians(left_deg) / 2
    turn = np.broadcast_to([np.cos(half), 0.0, 0.0, np.sin(half)], actor.track.quaternions_wxyz.shape)
    quaternions = quaternion_product(actor.track.quaternions_wxyz, turn)
    return scene.with_member(key, track=replace(actor.track, quaternions_wxyz=quaternions))


def retime_actor(scene: Scene, key: str, start_s: float, duration_s: float) -> Scene:
    """Let an actor drive its track from one time on, in so many seconds; a track of one sample only shifts.

    Raises `ValueError` where there is no such actor, it is locked, or the duration is not above 0.
    """
    actor = _unlocked_actor(scene, key)
    if not (duration_s > 0 and np.isfinite([start_s, duration_s]).all()):
        raise ValueError(f"The drive of {actor.name} must last longer than 0 s, not {duration_s:g} s.")
    times = actor.track.times
    span = duration_of(actor)
    stretch = duration_s / span if span > 0 else 1.0
    return scene.with_member(key, track=replace(actor.track, times=start_s + stretch * (times - times[:1])))


def start_of(actor: Actor) -> float:
    """Seconds at which its track begins."""
    return float(actor.track.times[0]) if len(actor.track.times) else 0.0


def duration_of(actor: Actor) -> float:
    """Seconds from the first sample of its track to the last."""
    times = actor.track.times
    return float(times[-1] - times[0]) if len(times) else 0.0


def _unlocked_actor(scene: Scene, key: str) -> Actor:
    actor = unlocked(scene, key)
    if not isinstance(actor, Actor):
        raise ValueError(f"{actor.name} is a layer: it stands still.")
    return actor

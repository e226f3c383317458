"""Transforms of a member or the selection by a similarity of the world, drag previews, and numeric poses."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from jaxtyping import Float32, Float64

from ...scene.flags import BitMask, SelectionFlags, mask_union
from ...scene.gaussians import Gaussians, rotate_sh, scene_cache
from ...scene.geometry import quaternion_product, quaternions_from_matrices
from ...scene.scene import Actor, Layer, Scene
from .actors import moved_actor
from .lamps import remounted
from .members import edit_members, find_unlocked_member, is_editable

Similarity = Float64[np.ndarray, "4 4"]


def move_member(scene: Scene, key: str, delta: Similarity) -> Scene:
    """Move an unlocked layer, or actor with its whole track, by a similarity of the world (meters, z up)."""
    member, step = find_unlocked_member(scene, key), _in_scene(scene, delta)
    if isinstance(member, Layer):
        return scene.with_member(key, to_scene=step @ member.to_scene)
    there = moved_actor(member, step)
    lamps = remounted(scene.lamps, member.id, member.id, float(np.cbrt(np.linalg.det(step[:3, :3]))))
    moved = scene.with_member(key, track=there.track, gaussians=there.gaussians, size_lwh=there.size_lwh)
    return moved if lamps == scene.lamps else replace(moved, lamps=lamps)


def move_selected(scene: Scene, delta: Similarity, time_s: float = 0.0) -> Scene:
    """Move the selected Gaussians by a similarity of the world, those of actors at a time; copies only what changes."""
    step = _in_scene(scene, delta)

    def placed(member: Layer | Actor) -> Layer | Actor:
        to_scene = member.pose_at(time_s)
        if to_scene is None or not member.marks.selected:
            return member
        own = np.linalg.inv(to_scene) @ step @ to_scene
        wet_sh = None if member.wet_sh is None else _partly_turned(member.wet_sh, member.marks.selected, own)
        return replace(member, gaussians=_partly_moved(member.gaussians, member.marks.selected, own), wet_sh=wet_sh)

    return edit_members(scene, placed)


def preview_move(scene: Scene, key: str | None, delta: Similarity, time_s: float = 0.0) -> Scene:
    """Scene while a member, or with None the selection, is dragged by a similarity of the world.

    It shares all arrays with the scene, so it is created at once for any number of Gaussians. It is for display only:
    the dragged Gaussians are in a layer of their own.
    """
    if key is not None:
        return move_member(scene, key, delta)
    step = _in_scene(scene, delta)
    dragged = [
        _dragged(member, member.marks.selected, step @ to_scene)
        for member in scene.members
        if is_editable(member) and member.marks.selected and (to_scene := member.pose_at(time_s)) is not None
    ]

    def at_rest(member: Layer | Actor) -> Layer | Actor:
        marks = member.marks
        return replace(member, marks=_hiding(marks, marks.selected)) if marks.selected else member

    scene = edit_members(scene, at_rest)
    return replace(scene, layers=(*scene.layers, *dragged))


def pivot(scene: Scene, key: str | None, time_s: float = 0.0) -> Float64[np.ndarray, "3"] | None:
    """Median center, in the world, of a member, or with None of the selection; None if it is empty."""
    places: list[Float64[np.ndarray, "n 3"]] = []
    for member in scene.members:
        to_scene = member.pose_at(time_s)
        is_meant = member.key == key if key is not None else is_editable(member) and bool(member.marks.selected)
        if to_scene is None or not is_meant or not len(member.gaussians):
            continue
        to_world = scene.scene_to_world @ to_scene
        if isinstance(member, Actor) and key is not None:
            return to_world[:3, 3]
        middle = _middle(member.gaussians, None if key is not None else member.marks.selected)
        places.append((to_world[:3, :3] @ middle + to_world[:3, 3])[None])
    return np.concatenate(places).mean(axis=0) if places else None


@scene_cache(maxsize=32)
def _middle(gaussians: Gaussians, selected: BitMask | None) -> Float64[np.ndarray, "3"]:
    means = gaussians.means if selected is None else gaussians.means[selected.indices]
    return np.median(means[:: -(-len(means) // 100_000) or 1], axis=0).astype(np.float64)  # of that many at most


def _in_scene(scene: Scene, delta: Similarity) -> Similarity:
    """Convert a similarity of the world to the scene's units and axes."""
    return np.linalg.inv(scene.scene_to_world) @ delta @ scene.scene_to_world


def _partly_moved(gaussians: Gaussians, selected: BitMask, similarity: Similarity) -> Gaussians:
    where = selected.indices
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    means, scales, quaternions = gaussians.means.copy(), gaussians.scales, gaussians.quaternions
    means[where] = means[where].astype(np.float64) @ similarity[:3, :3].T + similarity[:3, 3]
    if abs(scale - 1) > 1e-9:
        scales = scales.copy()
        scales[where] *= np.float32(scale)
    rotation = _turn_of(similarity)
    if rotation is not None:
        turn = np.broadcast_to(quaternions_from_matrices(rotation), (len(where), 4))
        quaternions = quaternions.copy()
        quaternions[where] = quaternion_product(turn, quaternions[where].astype(np.float64))
    sh = _partly_turned(gaussians.sh, selected, similarity)
    return replace(gaussians, means=means, scales=scales, quaternions=quaternions, sh=sh)


def _partly_turned(
    sh: Float32[np.ndarray, "n k 3"], selected: BitMask, similarity: Similarity
) -> Float32[np.ndarray, "n k 3"]:
    """Rotate the harmonics of some Gaussians; returns the same array if nothing rotates."""
    rotation = _turn_of(similarity)
    if rotation is None or sh.shape[1] == 1:
        return sh
    where, turned = selected.indices, sh.copy()
    turned[where] = rotate_sh(sh[where], rotation)
    return turned


def _turn_of(similarity: Similarity) -> Float64[np.ndarray, "3 3"] | None:
    """Rotation of a similarity; None if it is the identity within 1e-9."""
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    is_straight = np.allclose(similarity[:3, :3], scale * np.eye(3), rtol=0, atol=1e-9 * scale)
    return None if is_straight else similarity[:3, :3] / scale


def _hiding(marks: SelectionFlags, mask: BitMask) -> SelectionFlags:
    return replace(marks, hidden=mask if marks.hidden is None else mask_union(marks.hidden, mask))


def _dragged(member: Layer | Actor, selected: BitMask, to_scene: Similarity) -> Layer:
    kind = member.kind if isinstance(member, Layer) else "background"
    marks = _hiding(member.marks, _complement(selected))
    return Layer(
        f"{member.key} dragged", member.gaussians, kind, to_scene, opacity=member.opacity, grading=member.grading,
        marks=marks, wet_sh=member.wet_sh,
    )  # fmt: skip


@scene_cache(maxsize=64)
def _complement(mask: BitMask) -> BitMask:
    return ~mask  # the same object each time: renderers cache arrays by identity


# Numeric poses


@dataclass(frozen=True)
class Pose:
    """Position, rotation and scale of a similarity of the world."""

    position_m: tuple[float, float, float]
    """Position of the origin of the layer's own axes."""
    turn_deg: tuple[float, float, float]
    """About the world's x, y and z, in this order."""
    scale: float

    @property
    def matrix(self) -> Float64[np.ndarray, "4 4"]:
        matrix, rotation = np.eye(4), scipy.spatial.transform.Rotation.from_euler("xyz", self.turn_deg, degrees=True)
        matrix[:3, :3] = self.scale * rotation.as_matrix()
        matrix[:3, 3] = self.position_m
        return matrix


def pose_of(matrix: Float64[np.ndarray, "4 4"]) -> Pose:
    """Decompose a similarity; if the rotation about y is a right angle, the one about z is 0."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    rotation = scipy.spatial.transform.Rotation.from_matrix(matrix[:3, :3] / scale)
    m = rotation.as_matrix()
    sine = m[2, 0]
    if abs(sine) > 1 - 1e-12:  # SciPy would warn about gimbal lock
        turn = (float(np.degrees(np.arctan2(-sine * m[0, 1], m[1, 1]))), float(-90.0 * np.sign(sine)), 0.0)
    else:
        x, y, z = rotation.as_euler("xyz", degrees=True).tolist()
        turn = (x, y, z)
    x, y, z = matrix[:3, 3].tolist()
    return Pose((x, y, z), turn, scale)


def layer_pose(scene: Scene, key: str, time_s: float = 0.0) -> Pose | None:
    """Displacement of a layer from its file's pose, or world pose of an actor at a time.

    A layer that was never moved has position 0, rotation 0, scale 1. An actor has scale 1; None while it is absent.
    """
    member, to_world = scene.member(key), scene.scene_to_world
    to_scene = member.pose_at(time_s)
    if to_scene is None:
        return None
    if isinstance(member, Layer):
        return pose_of(to_world @ to_scene @ np.linalg.inv(to_world))
    pose = to_world @ to_scene
    pose[:3, :3] /= scene.metres_per_unit
    return pose_of(pose)


def set_layer_pose(scene: Scene, key: str, pose: Pose, time_s: float = 0.0) -> Scene:
    """Move an unlocked member, present at the time, to a pose as `layer_pose` returns it; actors with their track."""
    member = find_unlocked_member(scene, key)
    if not pose.scale > 0:
        raise ValueError(f"The scale of {member.name} must be above 0, not {pose.scale:g}.")
    before = layer_pose(scene, key, time_s)
    if before is None:
        raise ValueError(f"{member.name} is not there at {time_s:.2f} s.")
    return move_member(scene, key, pose.matrix @ np.linalg.inv(before.matrix))

"""Transformation and flattening of Gaussians, and wet colors."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, Float64

from .gaussians import Gaussians, rotate_sh
from .geometry import quaternion_product, quaternions_from_matrices
from .scene import Actor, DrawItem, Layer, Scene, grade_sh, is_sky, rotation_to_z_up

FILE_UP = (0.0, -1.0, 0.0)
"""Up direction in files that don't store one: y points down, as in COLMAP and thus in 3DGS captures."""


def transform_gaussians(gaussians: Gaussians, similarity: Float64[np.ndarray, "4 4"]) -> Gaussians:
    """Translate, rotate and scale Gaussians; their spherical harmonics rotate with them.

    `similarity` is a rotation times one scale above 0, and a translation. The identity returns the identical object.
    """
    if np.array_equal(similarity, np.eye(4)):
        return gaussians
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    rotation = similarity[:3, :3] / scale
    turn = quaternions_from_matrices(rotation)
    means = gaussians.means.astype(np.float64) @ similarity[:3, :3].T + similarity[:3, 3]
    quaternions = quaternion_product(np.broadcast_to(turn, gaussians.quaternions.shape), gaussians.quaternions)
    return replace(
        gaussians,
        means=means.astype(np.float32),
        scales=gaussians.scales * np.float32(scale),
        quaternions=quaternions.astype(np.float32),
        sh=rotate_sh(gaussians.sh, rotation),
    )


def moved_gaussians(gaussians: Gaussians, offset: Float64[np.ndarray, "3"]) -> Gaussians:
    """Translate Gaussians; those that stay are the identical object."""
    if not offset.any():
        return gaussians
    return replace(gaussians, means=(gaussians.means.astype(np.float64) + offset).astype(np.float32))


# Scenes far from the origin of their coordinates

_FAR = 1 << 14
"""Units from which on 32-bit floats are coarser than a thousandth of a unit."""

_FARTHEST = 1e12  # units; larger numbers come from damaged files
_SAMPLES = 100_000
_FAR_EXTENTS = 4.0  # times the extent of a scene that is far out, not just large or in small units


def far_place(positions: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Place in whole units in the middle of positions that are far from the origin, such as in UTM; else 0."""
    finite = positions[np.isfinite(positions).all(axis=1)]
    if not len(finite):
        return np.zeros(3)
    middle = np.median(finite[:: -(-len(finite) // _SAMPLES)].astype(np.float64), axis=0)
    return np.round(middle) if _FAR <= np.abs(middle).max() < _FARTHEST else np.zeros(3)


def recentered(scene: Scene) -> Scene:
    """Scene of a file with its origin moved to its middle, if that is farther out than 32-bit floats hold details.

    Layers, tracks and the ego vehicle move along, and `Scene.origin` has the place. Other scenes are unchanged.
    """
    centers = [np.zeros((0, 3))]
    for layer in scene.layers:
        means = layer.gaussians.means[:: -(-len(layer.gaussians) // _SAMPLES) or 1].astype(np.float64)
        centers.append(means @ layer.to_scene[:3, :3].T + layer.to_scene[:3, 3])
    positions = np.concatenate(centers)
    place = far_place(positions)
    extent = np.median(np.abs(positions - place), axis=0).max() if len(positions) else 0.0
    if np.abs(place).max() <= _FAR_EXTENTS * extent:
        return scene
    back = np.eye(4)
    back[:3, 3] = -place
    layers: list[Layer] = []
    for layer in scene.layers:
        gaussians, to_scene = layer.gaussians, back @ layer.to_scene
        if np.array_equal(to_scene[:3, :3], np.eye(3)):
            gaussians, to_scene = moved_gaussians(gaussians, to_scene[:3, 3]), np.eye(4)
        layers.append(replace(layer, gaussians=gaussians, to_scene=to_scene))
    x, y, z = (np.array(scene.origin) + place).tolist()
    return replace(
        scene,
        layers=tuple(layers),
        actors=tuple(replace(each, track=each.track.moved(back)) for each in scene.actors),
        ego=scene.ego and scene.ego.moved(back),
        path=scene.path and scene.path.moved(back),
        origin=(x, y, z),
    )


def origin_in_file(scene: Scene) -> tuple[float, float, float]:
    """Place of the scene's origin in the frame of single-file scenes, in meters."""
    x, y, z = (world_to_file()[:3, :3] @ scene.scene_to_world[:3, :3] @ np.array(scene.origin)).tolist()
    return x + 0.0, y + 0.0, z + 0.0  # no -0


def flatten_scene(scene: Scene, time_s: float = 0.0) -> Gaussians:
    """Merge all that is visible at a time, in meters with `FILE_UP` upwards: the frame of single-file scenes.

    A scene read from a single file is unchanged, and every scene looks the same from the same world camera before and
    after a round trip through a single file.
    """
    return Gaussians.concatenate(
        [transform_gaussians(bake_item(part), world_to_file() @ part.to_world) for part in scene.parts(time_s)]
    )


def world_to_file() -> Float64[np.ndarray, "4 4"]:
    """Rotation from the world (meters, z up) to the frame of single-file scenes, in which `FILE_UP` is up."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_to_z_up(FILE_UP).T
    return matrix


def lost_when_flattened(scene: Scene, time_s: float = 0.0) -> list[str]:
    """Phrases for what `flatten_scene` omits from a scene; empty if a single file holds all of it."""
    shown = [each for each in scene.members if each.visible]
    layers = [each for each in scene.layers if each.visible]
    there = [each for each in scene.actors if each.visible and each.pose_at(time_s) is not None]
    gone = [each for each in scene.actors if each.visible and each.pose_at(time_s) is None]
    hidden_members = len(scene.members) - len(shown)
    hidden = sum(each.marks.hidden.size for each in shown if each.marks.hidden is not None)
    keys = len(scene.weather.get("keys", ())) if scene.weather is not None else 0
    cameras = sum(len(rig) for rig in scene.rigs.values())
    bent = sum(each.is_bent for rig in scene.rigs.values() for each in rig)
    path_keys = len(scene.path.times_s) if scene.path is not None else 0
    found = {
        f"the division into {len(layers)} layers": len(layers) > 1,
        "which layer is the sky": any(each.kind == "sky" for each in layers),
        _counted(len(there), "moving actor, who stands still", "moving actors, who stand still"): bool(there),
        _counted(len(gone), f"actor who is not there at {time_s:g} s", f"actors not there at {time_s:g} s"): bool(gone),
        _counted(hidden_members, "hidden layer or actor", "hidden layers and actors"): hidden_members > 0,
        _counted(hidden, "hidden Gaussian"): hidden > 0,
        "wet colors": scene.has_wet_colors,
        _counted(path_keys, "camera key"): path_keys > 0,
        _counted(len(scene.views), "named view"): bool(scene.views),
        "the rain": scene.rain is not None,
        f"{_counted(keys, 'key')} of the rain over time": keys > 0,
        _counted(cameras, "rig camera"): cameras > 0,
        _counted(bent, "lens or rolling shutter", "lenses or rolling shutters"): bent > 0,
        "the drive of the ego vehicle": scene.ego is not None,
        _counted(len(scene.lamps), "lamp"): bool(scene.lamps),
        "the map of water": scene.water is not None,
        _counted(len(scene.selections), "selection set"): bool(scene.selections),
        _FAR_PLACE: any(scene.origin),
    }
    return [phrase for phrase, is_there in found.items() if is_there]


_FAR_PLACE = "the place of the scene's origin in its coordinates"


def lost_far_out(lost: list[str]) -> list[str]:
    """Phrases of `lost_when_flattened` without that of the origin, for formats that keep it."""
    return [phrase for phrase in lost if phrase != _FAR_PLACE]


def _counted(count: int, one: str, several: str = "") -> str:
    return f"{count:,} {one if count == 1 else several or one + 's'}"


def bake_item(part: DrawItem) -> Gaussians:
    """Bake an item's opacity, wetness and grading into its Gaussians, without those left out."""
    gaussians = part.remaining
    if part.is_wet and part.wet_sh is not None:
        wet_sh = part.wet_sh if not part.left_out else part.wet_sh[(~part.left_out).indices]
        gaussians = gaussians.with_sh(blend_wet_sh(gaussians.sh, wet_sh, part.wetness))
    if part.opacity != 1:
        gaussians = replace(gaussians, opacities=gaussians.opacities * np.float32(part.opacity))
    return gaussians if part.colors is None else gaussians.with_sh(grade_sh(gaussians.sh, part.colors))


# Wet colors
# Harmonics of a surface's appearance when fully wet, stored with the clear ones, and blends of both.


def blend_wet_sh(
    clear: Float32[np.ndarray, "n k 3"], wet: Float32[np.ndarray, "n k 3"], wetness: float
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics between clear (wetness 0) and fully wet (1); exact at both ends."""
    w = np.float32(wetness)
    blend = clear * (np.float32(1) - w)
    blend += w * wet
    return blend


def wet_sh_of(member: Layer | Actor) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of a member when fully wet: the clear ones if it has no wet colors."""
    return member.gaussians.sh if member.wet_sh is None else member.wet_sh


def with_wetness_baked(scene: Scene, wetness: float, overcast: float | None = None) -> Scene:
    """Return the scene as it looks at one wetness (0..1), without wet colors, for formats with only one color.

    `overcast` is that of sky layers; None takes the wetness.
    """
    for each in scene.members:
        if each.wet_sh is not None:
            share = overcast if overcast is not None and is_sky(each) else wetness
            gaussians = each.gaussians.with_sh(blend_wet_sh(each.gaussians.sh, each.wet_sh, share))
            scene = scene.with_member(each.key, gaussians=gaussians, wet_sh=None)
    return scene


def without_wet_colors(scene: Scene, key: str) -> Scene:
    """Return the scene without a member's wet colors. Raises `KeyError` if there is no such member."""
    scene.member(key)
    return scene.with_member(key, wet_sh=None)


def with_wet_colors_of(scene: Scene, other: Scene) -> Scene:
    """Return the scene with the wet colors of another version of it, and nothing else of that.

    Members that are missing in the other, or have other Gaussians or harmonics there, are unchanged. Raises
    `ValueError` if that applies to all.
    """
    given, changed = {each.key: each.wet_sh for each in other.members}, scene
    for each in scene.members:
        wet_sh = given.get(each.key)
        if wet_sh is not None and wet_sh.shape == each.gaussians.sh.shape:
            changed = changed.with_member(each.key, wet_sh=wet_sh)
    if changed is scene:
        raise ValueError("The scene has changed so much that the new wet colors fit none of its layers and actors.")
    return changed

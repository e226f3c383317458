"""Wet colours: harmonics of what something looks like when it is soaked, beside its clear ones, and blends of both."""

import numpy as np
from jaxtyping import Float32

from .members import Actor, Layer
from .scene import Scene


def blended_sh(
    clear: Float32[np.ndarray, "n k 3"], wet: Float32[np.ndarray, "n k 3"], wetness: float
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of colours between clear (wetness 0) and soaked (1); at both ends the very numbers of either."""
    w = np.float32(wetness)
    blend = clear * (np.float32(1) - w)
    blend += w * wet
    return blend


def soaked_sh(member: Layer | Actor) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of a member when it is soaked: the clear ones where it has no wet colours."""
    return member.gaussians.sh if member.wet_sh is None else member.wet_sh


def with_wetness_baked(scene: Scene, wetness: float) -> Scene:
    """Return the scene as it looks at one wetness (0..1), without wet colours: for what knows one colour alone."""
    for each in scene.members:
        if each.wet_sh is not None:
            gaussians = each.gaussians.with_sh(blended_sh(each.gaussians.sh, each.wet_sh, wetness))
            scene = scene.with_member(each.key, gaussians=gaussians, wet_sh=None)
    return scene


def without_wet_colors(scene: Scene, key: str) -> Scene:
    """Return the scene with a member that looks the same wet and dry. Raises `KeyError` where there is none."""
    scene.member(key)
    return scene.with_member(key, wet_sh=None)


def with_wet_colors_of(scene: Scene, other: Scene) -> Scene:
    """Return the scene with the wet colours of another version of it, and nothing else of that.

    Members that the other does not know, or knows with other Gaussians or harmonics, stay as they are. Raises
    `ValueError` where that is so of all.
    """
    given, changed = {each.key: each.wet_sh for each in other.members}, scene
    for each in scene.members:
        wet_sh = given.get(each.key)
        if wet_sh is not None and wet_sh.shape == each.gaussians.sh.shape:
            changed = changed.with_member(each.key, wet_sh=wet_sh)
    if changed is scene:
        raise ValueError("The scene has changed so much that the new wet colours fit none of its layers and actors.")
    return changed

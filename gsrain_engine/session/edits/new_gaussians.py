"""New Gaussians for the members of a scene, from another version of it."""

from gsrain_engine.scene.marks import UNMARKED
from gsrain_engine.scene.scene import Scene


def with_gaussians_of(scene: Scene, other: Scene) -> Scene:
    """Return the scene with the Gaussians of another version of it; what only one of them has stays as it is."""
    given = {each.key: each.gaussians for each in other.members}
    wet = {each.key: each.wet_sh for each in other.members}
    for each in scene.members:
        new = given.get(each.key, each.gaussians)
        marks = each.marks if len(new) == len(each.gaussians) else UNMARKED
        wet_sh = wet[each.key] if each.key in given else each.wet_sh
        scene = scene.with_member(each.key, gaussians=new, wet_sh=wet_sh, marks=marks)
    return scene

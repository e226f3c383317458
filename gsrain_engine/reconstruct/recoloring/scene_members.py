"""Everything in a scene that has colours of its own, as one list of Gaussians that counts through."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Layer, Part
from gsrain_engine.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A layer or an actor."""

    key: str
    """`layers/NAME` or `actors/ID`."""
    gaussians: Gaussians
    is_sky: bool
    first: int
    """Row of its first Gaussian among those of all members."""

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + len(self.gaussians))


def scene_members(scene: Scene) -> list[Member]:
    """Layers first, then actors, in the scene's order, hidden ones too."""
    members: list[Member] = []
    first = 0
    for each in scene.members:
        is_sky = isinstance(each, Layer) and each.kind == "sky"
        members.append(Member(each.key, each.gaussians, is_sky, first))
        first += len(each.gaussians)
    return members


@dataclass(frozen=True, slots=True, eq=False)
class VisibleMembers:
    """The members that stand in the scene at one time, ready to be drawn."""

    members: list[Member]
    parts: list[Part]
    rows: Int64[np.ndarray, " n"]
    """Row among all members of each Gaussian of `parts`, counted through."""
    is_sky: Bool[np.ndarray, " n"]


def visible_members(scene: Scene, members: list[Member], time_s: float) -> VisibleMembers:
    """Pick what can be seen at a time, with its way to the world; grading comes on top of colours that are solved."""
    placed = [
        (member, part._replace(colors=None))
        for member, shown in zip(members, scene.members, strict=True)
        if shown.visible and (part := scene.part(shown, time_s)) is not None
    ]
    none = np.zeros(0, np.int64)
    return VisibleMembers(
        [member for member, _ in placed],
        [part for _, part in placed],
        np.concatenate([none, *(np.arange(len(member.gaussians)) + member.first for member, _ in placed)]),
        np.concatenate([none > 0, *(np.full(len(member.gaussians), member.is_sky) for member, _ in placed)]),
    )


def world_heights(scene: Scene, member: Member) -> Float32[np.ndarray, " n"]:
    """World z of a layer's Gaussians in metres; for an actor, z above its own bottom, as if it stood at height 0."""
    shown = scene.member(member.key)
    if isinstance(shown, Layer):
        to_world = scene.scene_to_world @ shown.to_scene
        up, offset = to_world[2, :3], to_world[2, 3]
    else:
        up, offset = np.array([0, 0, scene.metres_per_unit]), 0.0
    return (member.gaussians.means @ up + offset).astype(np.float32)

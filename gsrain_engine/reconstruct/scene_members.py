"""Everything in a scene that has colours of its own, as one list of Gaussians that counts through."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Part, Scene


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
        """Its rows among the Gaussians of all members."""
        return slice(self.first, self.first + len(self.gaussians))


def scene_members(scene: Scene) -> list[Member]:
    """Layers first, then actors, in the scene's order, hidden ones too."""
    members: list[Member] = []
    first = 0
    named = [(f"layers/{each.name}", each.gaussians, each.kind == "sky") for each in scene.layers]
    named += [(f"actors/{each.id}", each.gaussians, False) for each in scene.actors]
    for key, gaussians, is_sky in named:
        members.append(Member(key, gaussians, is_sky, first))
        first += len(gaussians)
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
    """Pick what can be seen at a time, with its way to the world."""
    placed = [
        (member, to_world)
        for member, to_world in zip(members, _ways_to_world(scene, time_s), strict=True)
        if to_world is not None
    ]
    none = np.zeros(0, np.int64)
    return VisibleMembers(
        [member for member, _ in placed],
        [Part(member.gaussians, to_world) for member, to_world in placed],
        np.concatenate([none, *(np.arange(len(member.gaussians)) + member.first for member, _ in placed)]),
        np.concatenate([none > 0, *(np.full(len(member.gaussians), member.is_sky) for member, _ in placed)]),
    )


def _ways_to_world(scene: Scene, time_s: float) -> list[Float64[np.ndarray, "4 4"] | None]:
    to_world = scene.scene_to_world
    ways = [to_world if layer.visible else None for layer in scene.layers]
    for actor in scene.actors:
        pose = actor.track.pose(time_s) if actor.visible else None
        ways.append(None if pose is None else to_world @ pose)
    return ways


def world_heights(scene: Scene, member: Member) -> Float32[np.ndarray, " n"]:
    """World z of a layer's Gaussians in metres; for an actor, z above its own bottom, as if it stood at height 0."""
    to_world = scene.scene_to_world
    up = to_world[2, :3] if member.key.startswith("layers/") else np.array([0, 0, scene.metres_per_unit])
    return (member.gaussians.means @ up).astype(np.float32)

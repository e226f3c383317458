"""What can be selected: Gaussians that are shown, of members that are neither hidden nor locked."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Actor, Layer, Part
from gsrain_engine.scene.scene import Scene

Found = Mapping[str, Mask]
"""Gaussians that a tool has found, by the keys of their members; members without any may be absent."""


class Candidate(NamedTuple):
    """A member as it is at a moment."""

    key: str
    part: Part
    """Its Gaussians, and their similarity to the world (metres)."""


def is_editable(member: Layer | Actor) -> bool:
    return member.visible and not member.locked


def editable(scene: Scene) -> Iterator[Layer | Actor]:
    return (member for member in scene.members if is_editable(member))


def shown(member: Layer | Actor) -> Mask:
    """Gaussians of a member that are neither hidden nor deleted."""
    left_out = member.marks.left_out
    return Mask.all(len(member.gaussians)) if left_out is None else ~left_out


def candidates(scene: Scene, time_s: float) -> list[Candidate]:
    """Members that can be selected from at a time; actors that are not there then are not among them."""
    parts = [(member.key, scene.part(member, time_s)) for member in editable(scene)]
    return [Candidate(key, part) for key, part in parts if part is not None]

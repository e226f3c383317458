"""What can be selected: Gaussians that are shown, of members that are neither hidden nor locked."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float32

from ...scene.flags import Mask
from ...scene.gaussians import SH_C0
from ...scene.scene import Actor, Layer, Part, Scene

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


# § Selections put together: what is found sets, joins, leaves or narrows what is selected.

Mode = Literal["set", "add", "remove", "intersect"]


def combined(scene: Scene, found: Found, mode: Mode) -> Scene:
    """Select what a tool has found; the very same scene where that changes nothing.

    Hidden and deleted Gaussians never become selected; members that are hidden or locked keep what they have.
    """
    for member in editable(scene):
        own = found.get(member.key) or Mask.none(len(member.gaussians))
        scene = _with_selected(scene, member, _put_together(selected(member), own & shown(member), mode))
    return scene


def all_selected(scene: Scene) -> Scene:
    return combined(scene, {member.key: shown(member) for member in editable(scene)}, "set")


def none_selected(scene: Scene) -> Scene:
    return combined(scene, {}, "set")


def inverted(scene: Scene) -> Scene:
    """Select what is shown and was not selected."""
    return combined(scene, {member.key: shown(member) - selected(member) for member in editable(scene)}, "set")


def selected(member: Layer | Actor) -> Mask:
    return member.marks.selected or Mask.none(len(member.gaussians))


def selections(scene: Scene) -> dict[str, Mask]:
    """What is selected of the members that edits take in; only those with anything selected."""
    return {member.key: selected(member) for member in editable(scene) if member.marks.selected}


def selected_count(scene: Scene) -> int:
    """How many Gaussians are selected of the members that edits take in."""
    return sum(mask.size for mask in selections(scene).values())


def selectable_count(scene: Scene) -> int:
    """How many Gaussians can be selected."""
    return sum(shown(member).size for member in editable(scene))


def _put_together(now: Mask, found: Mask, mode: Mode) -> Mask:
    if mode == "add":
        return now | found
    if mode == "remove":
        return now - found
    return found if mode == "set" else now & found


def _with_selected(scene: Scene, member: Layer | Actor, mask: Mask) -> Scene:
    if mask.same_as(selected(member)):
        return scene
    return scene.with_member(member.key, marks=replace(member.marks, selected=mask if mask else None))


# § Base colours of Gaussians, and those that are alike.


def base_colors(part: Part) -> Float32[np.ndarray, "n 3"]:
    """Display colour of each Gaussian without what changes with direction, graded as it is drawn, within 0..1."""
    colors = part.gaussians.sh[:, 0].copy()
    colors *= np.float32(SH_C0)
    colors += np.float32(0.5)
    if part.colors is not None:
        matrix = part.colors.astype(np.float32)
        colors = colors @ matrix[:, :3].T + matrix[:, 3]
    return np.clip(colors, 0, 1, out=colors)


def base_color(part: Part, index: int) -> Float32[np.ndarray, "3"]:
    """Display colour of one Gaussian, see `base_colors`."""
    return base_colors(part._replace(gaussians=part.gaussians.take(np.array([index]))))[0]


def alike(scene: Scene, time_s: float, color: Float32[np.ndarray, "3"], tolerance: float) -> dict[str, Mask]:
    """Find Gaussians whose base colour differs by no more than `tolerance` (0..1) in red, green and blue each."""
    found: dict[str, Mask] = {}
    for each in candidates(scene, time_s):
        difference = base_colors(each.part)
        difference -= color
        near = np.abs(difference, out=difference) <= tolerance
        found[each.key] = Mask.of(near[:, 0] & near[:, 1] & near[:, 2])
    return found

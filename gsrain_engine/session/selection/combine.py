"""Selections put together: what is found sets, joins, leaves or narrows what is selected."""

from dataclasses import replace
from typing import Literal

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.scene.scene import Scene

from .candidates import Found, editable, shown

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

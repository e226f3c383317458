"""Members of a scene in edits: access to editable ones, unique names, selection sets, new Gaussians."""

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from itertools import count

from ...scene.flags import UNMARKED, BitMask
from ...scene.scene import Actor, Layer, Scene


def is_editable(member: Layer | Actor) -> bool:
    """Return whether selection and edits apply to a member: visible and not locked."""
    return member.visible and not member.locked


def find_member(scene: Scene, key: str) -> Layer | Actor:
    """Find a member; raises `ValueError` if there is none."""
    try:
        return scene.member(key)
    except KeyError:
        raise ValueError(f"There is no {key!r} in the scene.") from None


def find_unlocked_member(scene: Scene, key: str) -> Layer | Actor:
    """Find an unlocked member, visible or not; raises `ValueError` if there is none or it is locked."""
    member = find_member(scene, key)
    if member.locked:
        raise ValueError(f"{member.name} is locked.")
    return member


def with_members(scene: Scene, members: Iterable[Layer | Actor]) -> Scene:
    """Return the scene with other members; layers and actors each in their order."""
    members = tuple(members)
    return replace(
        scene,
        layers=tuple(each for each in members if isinstance(each, Layer)),
        actors=tuple(each for each in members if isinstance(each, Actor)),
    )


def edit_members(scene: Scene, edit: Callable[[Layer | Actor], Layer | Actor]) -> Scene:
    """Apply a function to every editable member; returns the same scene object if nothing changed."""
    members = tuple(edit(each) if is_editable(each) else each for each in scene.members)
    unchanged = all(new is old for new, old in zip(members, scene.members, strict=True))
    return scene if unchanged else with_members(scene, members)


def with_selections(scene: Scene, change: Callable[[Mapping[str, BitMask]], Mapping[str, BitMask]]) -> Scene:
    """Apply a function to each selection set of a scene."""
    return replace(scene, selections={name: change(masks) for name, masks in scene.selections.items()})


def insert_after(scene: Scene, key: str, added: Layer | Actor) -> Scene:
    at = next((i for i, each in enumerate(scene.members) if each.key == key), len(scene.members) - 1)
    return with_members(scene, (*scene.members[: at + 1], added, *scene.members[at + 1 :]))


def with_unique_name(scene: Scene, member: Layer | Actor, name: str | None = None) -> Layer | Actor:
    """Return a member under a name that no other of its kind has; with `name`, a member of the scene is renamed."""
    used = {each.name for each in scene.members if type(each) is type(member)}
    new = unique_name(member.name, used) if name is None else unique_name(name, used - {member.name})
    return replace(member, name=new) if isinstance(member, Layer) else replace(member, id=new)


def unique_name(name: str, used: Collection[str]) -> str:
    """Return `name`, with a number appended if it is in use: "road", "road 2", "road 3"."""
    if name not in used:
        return name
    stem = re.sub(r" \d+$", "", name) or name
    return next(each for number in count(2) if (each := f"{stem} {number}") not in used)


def with_gaussians_of(scene: Scene, other: Scene) -> Scene:
    """Return the scene with the Gaussians of another version of it; unmatched members stay unchanged."""
    others = {each.key: each for each in other.members}
    for each in scene.members:
        new = others.get(each.key, each)
        marks = each.marks if len(new.gaussians) == len(each.gaussians) else UNMARKED
        scene = scene.with_member(each.key, gaussians=new.gaussians, wet_sh=new.wet_sh, marks=marks)
    return scene

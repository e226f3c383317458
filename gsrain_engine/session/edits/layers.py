"""Layers and actors as wholes: copied, parted, joined, named, ordered. Each function makes a new scene."""

from dataclasses import replace

from gsrain_engine.scene.marks import UNMARKED
from gsrain_engine.scene.members import Layer, rows_of
from gsrain_engine.scene.scene import Scene

from .importing import import_scene
from .marking import delete_selected
from .members import behind, found, is_editable, named, names, unlocked, with_members, with_selections
from .merging import merge
from .names import unique_name

__all__ = ["duplicate", "import_scene", "merge", "move_down", "move_up", "remove", "rename", "separate"]


def duplicate(scene: Scene, key: str) -> Scene:
    """Return the scene with a copy of a member behind it, under a name of its own; its arrays are shared.

    Raises `ValueError` where there is no such member.
    """
    member = found(scene, key)
    copy = replace(named(member, unique_name(member.name, names(scene, member))), locked=False)
    return with_members(scene, behind(scene, key, (copy,)))


def separate(scene: Scene) -> Scene:
    """Take what is selected out into a layer of its own, behind the first one that it comes from.

    The Gaussians stay where they were, marked as deleted, so that selection sets stay true. What comes from one layer
    keeps its similarity, opacity and grading; what comes from several is joined as `merge` does. What is selected of
    an actor becomes an actor on the same track. Raises `ValueError` where nothing is selected.
    """
    sources = [each for each in scene.members if is_editable(each) and each.marks.selected]
    if not sources:
        raise ValueError("Nothing is selected.")
    result, parted = delete_selected(scene), list[str]()
    for source in sources:
        assert source.marks.selected is not None
        kept = source.marks.selected if source.marks.left_out is None else source.marks.selected - source.marks.left_out
        if not kept:
            continue
        name = unique_name(source.name, names(result, source))
        gaussians, wet_sh = rows_of(source, kept.indices)
        piece = replace(named(source, name), gaussians=gaussians, wet_sh=wet_sh, marks=UNMARKED)
        result = with_members(result, behind(result, source.key, (piece,)))
        if isinstance(source, Layer) and source.kind == "background":
            parted.append(piece.key)
    return merge(result, parted) if len(parted) > 1 else result


def remove(scene: Scene, key: str) -> Scene:
    """Return the scene without a member. Raises `ValueError` where there is none or it is locked."""
    unlocked(scene, key)
    members = tuple(each for each in scene.members if each.key != key)
    return with_selections(
        with_members(scene, members), lambda masks: {each: mask for each, mask in masks.items() if each != key}
    )


def rename(scene: Scene, key: str, name: str) -> Scene:
    """Give a member another name, with a number behind it where that is taken; selection sets follow.

    Raises `ValueError` where there is no such member, and for an empty name.
    """
    member, name = found(scene, key), name.strip()
    if not name:
        raise ValueError("A name can't be empty.")
    renamed = named(member, unique_name(name, names(scene, member) - {member.name}))
    members = tuple(renamed if each is member else each for each in scene.members)
    return with_selections(
        with_members(scene, members),
        lambda masks: {renamed.key if each == key else each: mask for each, mask in masks.items()},
    )


def move_up(scene: Scene, key: str) -> Scene:
    """Let a member stand one place earlier among its kind. Raises `ValueError` where there is none or it is first."""
    return _shifted(scene, key, -1, "is the first already")


def move_down(scene: Scene, key: str) -> Scene:
    """Let a member stand one place later among its kind. Raises `ValueError` where there is none or it is last."""
    return _shifted(scene, key, +1, "is the last already")


def _shifted(scene: Scene, key: str, by: int, trouble: str) -> Scene:
    member = found(scene, key)
    kind = [each for each in scene.members if type(each) is type(member)]
    at = kind.index(member)
    if not 0 <= at + by < len(kind):
        raise ValueError(f"{member.name} {trouble}.")
    kind[at], kind[at + by] = kind[at + by], kind[at]
    return with_members(scene, (*(each for each in scene.members if type(each) is not type(member)), *kind))

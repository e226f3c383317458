"""Edits of whole layers and actors: duplicate, separate, merge, rename, reorder, import. Each returns a new scene."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...scene.flags import UNMARKED, BitMask, SelectionFlags
from ...scene.gaussians import Gaussians
from ...scene.lod_order import lod_order
from ...scene.scene import UNCHANGED, Actor, DrawItem, Layer, Scene, take_gaussians
from ...scene.transforms import bake_item, transform_gaussians, wet_sh_of
from .actors import moved_actor
from .gaussians import delete_selected
from .lamps import moved_lamps, remounted
from .members import (
    Keys,
    find_member,
    find_members,
    find_unlocked_member,
    insert_after,
    is_editable,
    unique_name,
    with_members,
    with_selections,
    with_unique_name,
)


def duplicate(scene: Scene, key: Keys) -> Scene:
    """Insert a copy of each layer or actor after it, under a unique name; its arrays are shared."""
    for member in find_members(scene, key):
        copy = replace(with_unique_name(scene, member), locked=False)
        scene = insert_after(scene, member.key, copy)
    return scene


def separate(scene: Scene) -> Scene:
    """Move the selection to a layer of its own, after the first one that it comes from.

    The source Gaussians stay and are marked as deleted, so that selection sets stay valid. A piece of one layer keeps
    its similarity, opacity and grading; pieces of several are joined as by `merge`. The selection of an actor becomes
    an actor on the same track. Raises `ValueError` if nothing is selected.
    """
    sources = [each for each in scene.members if is_editable(each) and each.marks.selected]
    if not sources:
        raise ValueError("Nothing is selected.")
    result, parted = delete_selected(scene), list[str]()
    for source in sources:
        assert source.marks.selected is not None
        mask = source.marks.selected if source.marks.left_out is None else source.marks.selected - source.marks.left_out
        if not mask:
            continue
        gaussians, wet_sh = take_gaussians(source, mask.indices)
        piece = with_unique_name(result, source)
        piece = replace(piece, gaussians=gaussians, wet_sh=wet_sh, marks=UNMARKED)
        result = insert_after(result, source.key, piece)
        if isinstance(source, Layer) and source.kind == "background":
            parted.append(piece.key)
    return merge(result, parted) if len(parted) > 1 else result


def remove(scene: Scene, key: Keys) -> Scene:
    """Remove layers and actors. Raises `ValueError` if there is none of them or one is locked."""
    gone = {find_unlocked_member(scene, each.key).key for each in find_members(scene, key)}
    members = tuple(each for each in scene.members if each.key not in gone)
    return with_selections(
        with_members(scene, members), lambda masks: {each: mask for each, mask in masks.items() if each not in gone}
    )


def rename(scene: Scene, key: str, name: str) -> Scene:
    """Rename a member, with a number appended if the name is in use; selection sets and lamps follow."""
    member, name = find_member(scene, key), name.strip()
    if not name:
        raise ValueError("A name can't be empty.")
    renamed = with_unique_name(scene, member, name)
    members = tuple(renamed if each is member else each for each in scene.members)
    if isinstance(member, Actor) and isinstance(renamed, Actor):
        scene = replace(scene, lamps=remounted(scene.lamps, member.id, renamed.id))
    return with_selections(
        with_members(scene, members),
        lambda masks: {renamed.key if each == key else each: mask for each, mask in masks.items()},
    )


def move_up(scene: Scene, key: str) -> Scene:
    """Move a member one place forward among its kind. Raises `ValueError` if there is none or it is first."""
    return _shifted(scene, key, -1, "is the first already")


def move_down(scene: Scene, key: str) -> Scene:
    """Move a member one place back among its kind. Raises `ValueError` if there is none or it is last."""
    return _shifted(scene, key, +1, "is the last already")


def _shifted(scene: Scene, key: str, by: int, trouble: str) -> Scene:
    member = find_member(scene, key)
    kind = [each for each in scene.members if type(each) is type(member)]
    at = kind.index(member)
    if not 0 <= at + by < len(kind):
        raise ValueError(f"{member.name} {trouble}.")
    kind[at], kind[at + by] = kind[at + by], kind[at]
    return with_members(scene, (*(each for each in scene.members if type(each) is not type(member)), *kind))


# Merging


def merge(scene: Scene, keys: Sequence[str]) -> Scene:
    """Join layers into the first of them, in its frame; deleted Gaussians are removed.

    Opacity and grading stay if all layers agree, otherwise they are applied to the Gaussians. If only some layers have
    wet colors, the others contribute their clear colors. Marks and selection sets stay valid. Raises `ValueError` for
    fewer than two layers, for actors, for locked layers, and for a sky with anything else.
    """
    layers = [find_unlocked_member(scene, key) for key in dict.fromkeys(keys)]
    if len(layers) < 2:
        raise ValueError("Merging takes two layers or more.")
    joined = [each for each in layers if isinstance(each, Layer)]
    if len(joined) < len(layers):
        raise ValueError("Actors move on their own, so they can't be merged.")
    if len({each.kind for each in joined}) > 1:
        raise ValueError("A sky can't be merged with what is no sky.")
    first, agree = joined[0], len({(each.opacity, each.grading) for each in joined}) == 1
    undeleted = [slice(None) if each.marks.deleted is None else ~each.marks.deleted.flags for each in joined]
    every = Gaussians.concatenate([_in_frame_of(first, each, bake=not agree) for each in joined])
    order = lod_order(every).astype(np.int64)
    wet_sh = None
    if any(each.wet_sh is not None for each in joined):
        soaked = [replace(each, gaussians=each.gaussians.with_sh(wet_sh_of(each))) for each in joined]
        wet_sh = Gaussians.concatenate([_in_frame_of(first, each, bake=not agree) for each in soaked]).sh[order]

    def join(masks: Sequence[BitMask | None]) -> BitMask | None:
        flags = [
            np.zeros(len(each.gaussians), np.bool_) if mask is None else mask.flags
            for mask, each in zip(masks, joined, strict=True)
        ]
        whole = BitMask.of(np.concatenate([own[rows] for own, rows in zip(flags, undeleted, strict=True)])[order])
        return whole if whole else None

    whole = replace(
        first,
        gaussians=every.take(order),
        wet_sh=wet_sh,
        marks=SelectionFlags(
            join([each.marks.selected for each in joined]), join([each.marks.hidden for each in joined])
        ),
        opacity=first.opacity if agree else 1.0,
        grading=first.grading if agree else UNCHANGED,
    )
    others = {each.key for each in joined[1:]}
    members = tuple(whole if each is first else each for each in scene.members if each.key not in others)

    def change(masks: Mapping[str, BitMask]) -> Mapping[str, BitMask]:
        mask = join([masks.get(each.key) for each in joined])
        rest = {key: each for key, each in masks.items() if key != first.key and key not in others}
        return rest if mask is None else rest | {first.key: mask}

    return with_selections(with_members(scene, members), change)


def _in_frame_of(first: Layer, layer: Layer, *, bake: bool) -> Gaussians:
    part = DrawItem(layer.gaussians, layer.to_scene, left_out=layer.marks.deleted)
    if bake:
        part = part._replace(opacity=layer.opacity, colors=layer.grading.matrix)
    same = np.array_equal(first.to_scene, layer.to_scene)
    return transform_gaussians(bake_item(part), np.eye(4) if same else np.linalg.inv(first.to_scene) @ layer.to_scene)


def import_scene(scene: Scene, other: Scene) -> Scene:
    """Add members, lamps and selection sets of another scene, so that the world frames agree, under unique names.

    Where both have an origin in the coordinates of their files, those agree. Lamps of its ego vehicle are left out.
    """
    if not scene.members:
        return other
    to_scene = np.linalg.inv(scene.scene_to_world) @ other.scene_to_world
    if any(scene.origin) and any(other.origin):
        to_scene[:3, 3] += to_scene[:3, :3] @ np.array(other.origin) - np.array(scene.origin)
    if np.allclose(to_scene, np.eye(4), rtol=0, atol=1e-12):
        to_scene = np.eye(4)
    result, keys, lamps = scene, dict[str, str](), other.lamps
    scale = float(np.cbrt(np.linalg.det(to_scene[:3, :3])))
    for member in other.members:
        added = with_unique_name(result, member)
        keys[member.key] = added.key
        is_layer = isinstance(added, Layer)
        placed = replace(added, to_scene=to_scene @ added.to_scene) if is_layer else moved_actor(added, to_scene)
        result = with_members(result, (*result.members, placed))
        if isinstance(member, Actor) and isinstance(added, Actor):
            lamps = remounted(lamps, member.id, added.id, scale)
    sets = dict(scene.selections)
    for name, masks in other.selections.items():
        sets[unique_name(name, sets)] = {keys[key]: mask for key, mask in masks.items() if key in keys}
    own = tuple(lamp for lamp in moved_lamps(lamps, to_scene) if lamp.mount != "ego")
    return replace(result, selections=sets, lamps=(*scene.lamps, *own))

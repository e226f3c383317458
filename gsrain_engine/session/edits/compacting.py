"""What is deleted, taken out of the arrays for good; undo still has it."""

from collections.abc import Mapping
from dataclasses import replace

from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Actor, Layer, rows_of
from gsrain_engine.scene.scene import Scene

from .members import with_members, with_selections


def deleted_count(scene: Scene) -> int:
    """How many Gaussians are only marked as deleted."""
    masks = [each.marks.deleted for each in scene.members]
    return sum(mask.size for mask in masks if mask is not None)


def compact(scene: Scene) -> Scene:
    """Make new arrays without what is deleted, of locked and hidden members too; marks and selection sets follow."""
    kept = {each.key: ~each.marks.deleted for each in scene.members if each.marks.deleted}

    def change(masks: Mapping[str, Mask]) -> Mapping[str, Mask]:
        return {key: mask.take(kept[key].indices) if key in kept else mask for key, mask in masks.items()}

    members = tuple(_compacted(each, kept[each.key]) if each.key in kept else each for each in scene.members)
    return with_selections(with_members(scene, members), change) if kept else scene


def _compacted(member: Layer | Actor, kept: Mask) -> Layer | Actor:
    where, marks = kept.indices, member.marks
    masks = [each.take(where) if each is not None else None for each in (marks.selected, marks.hidden)]
    selected, hidden = (each if each else None for each in masks)
    gaussians, wet_sh = rows_of(member, where)
    return replace(member, gaussians=gaussians, wet_sh=wet_sh, marks=Marks(selected, hidden))

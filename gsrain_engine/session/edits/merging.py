"""Several layers as one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gsrain_engine.scene.drawing_order import drawing_order
from gsrain_engine.scene.flattening import baked, moved
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.grading import UNCHANGED
from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Layer, Part
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.wet_colors import soaked_sh

from .members import unlocked, with_members, with_selections


def merge(scene: Scene, keys: Sequence[str]) -> Scene:
    """Join layers into the first of them; what is deleted falls out for good.

    All come into the frame of the first. Opacity and grading stay as they are where all agree, else they are put into
    the Gaussians. Wet colours of one go along with the clear colours of another that has none. Marks and selection sets
    stay true. Raises `ValueError` for fewer than two, for actors, for locked
    ones, and for a sky with anything else.
    """
    layers = [unlocked(scene, key) for key in dict.fromkeys(keys)]
    if len(layers) < 2:
        raise ValueError("Merging takes two layers or more.")
    joined = [each for each in layers if isinstance(each, Layer)]
    if len(joined) < len(layers):
        raise ValueError("Actors move on their own, so they can't be merged.")
    if len({each.kind for each in joined}) > 1:
        raise ValueError("A sky can't be merged with what is no sky.")
    first, agree = joined[0], _agree(joined)
    kept = [_undeleted(each) for each in joined]
    pieces = [_brought_to(first, each, bake=not agree) for each in joined]
    every = Gaussians.concatenate(pieces)
    order = drawing_order(every).astype(np.int64)
    wet_sh = None
    if any(each.wet_sh is not None for each in joined):
        soaked = [replace(each, gaussians=each.gaussians.with_sh(soaked_sh(each))) for each in joined]
        wet_sh = Gaussians.concatenate([_brought_to(first, each, bake=not agree) for each in soaked]).sh[order]

    def put_together(masks: Sequence[Mask | None]) -> Mask | None:
        mask = _joined(masks, kept)
        return mask.take(order) if mask else None

    whole = replace(
        first,
        gaussians=every.take(order),
        wet_sh=wet_sh,
        marks=Marks(
            put_together([each.marks.selected for each in joined]), put_together([each.marks.hidden for each in joined])
        ),
        opacity=first.opacity if agree else 1.0,
        grading=first.grading if agree else UNCHANGED,
    )
    others = {each.key for each in joined[1:]}
    members = tuple(whole if each is first else each for each in scene.members if each.key not in others)

    def change(masks: Mapping[str, Mask]) -> Mapping[str, Mask]:
        mask = put_together([masks.get(each.key) for each in joined])
        rest = {key: each for key, each in masks.items() if key != first.key and key not in others}
        return rest if mask is None else rest | {first.key: mask}

    return with_selections(with_members(scene, members), change)


def _agree(layers: list[Layer]) -> bool:
    return len({(each.opacity, each.grading) for each in layers}) == 1


def _undeleted(layer: Layer) -> Mask:
    return Mask.all(len(layer.gaussians)) if layer.marks.deleted is None else ~layer.marks.deleted


def _brought_to(first: Layer, layer: Layer, *, bake: bool) -> Gaussians:
    part = Part(layer.gaussians, layer.to_scene, left_out=layer.marks.deleted)
    if bake:
        part = part._replace(opacity=layer.opacity, colors=layer.grading.matrix)
    same = np.array_equal(first.to_scene, layer.to_scene)
    return moved(baked(part), np.eye(4) if same else np.linalg.inv(first.to_scene) @ layer.to_scene)


def _joined(masks: Sequence[Mask | None], kept: Sequence[Mask]) -> Mask:
    """One mask of several, in their order, without what is not kept."""
    flags = [
        np.zeros(keep.size, np.bool_) if mask is None else mask.flags[keep.flags]
        for mask, keep in zip(masks, kept, strict=True)
    ]
    return Mask.of(np.concatenate(flags))

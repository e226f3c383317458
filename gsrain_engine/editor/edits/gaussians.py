"""Edits that only mark Gaussians: delete, hide, show, isolate. No array is copied."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from ...scene.flags import BitMask, SelectionFlags
from ...scene.scene import Actor, Layer, Scene, core_bounds, take_gaussians
from .members import edit_members, is_editable, with_members, with_selections


def selected_count(scene: Scene) -> int:
    """How many Gaussians an edit of the selection would change."""
    masks = [_meant(each) for each in scene.members if is_editable(each)]
    return sum(mask.size for mask in masks if mask is not None)


def delete_selected(scene: Scene) -> Scene:
    """Mark what is selected as deleted; nothing is selected afterwards."""
    return edit_members(
        scene, lambda each: _with(each, selected=None, deleted=_either(each.marks.deleted, _meant(each)))
    )


def hide_selected(scene: Scene) -> Scene:
    return edit_members(scene, lambda each: _with(each, selected=None, hidden=_either(each.marks.hidden, _meant(each))))


def show_all(scene: Scene) -> Scene:
    """Show what is hidden of every member that may be edited."""
    return edit_members(scene, lambda each: each if each.marks.hidden is None else _with(each, hidden=None))


def isolate_selected(scene: Scene) -> Scene:
    """Hide everything that may be edited but what is selected. Raises `ValueError` where nothing is."""
    if not selected_count(scene):
        raise ValueError("Nothing is selected.")

    def isolated(member: Layer | Actor) -> Layer | Actor:
        meant = _meant(member) or BitMask.none(len(member.gaussians))
        return _with(member, selected=member.marks.selected, hidden=_either(member.marks.hidden, ~meant))

    return edit_members(scene, isolated)


def _meant(member: Layer | Actor) -> BitMask | None:
    """What is selected and can be seen; None where nothing is."""
    selected, left_out = member.marks.selected, member.marks.left_out
    meant = selected if selected is None or left_out is None else selected - left_out
    return meant if meant else None


def _either(first: BitMask | None, second: BitMask | None) -> BitMask | None:
    if first is None or second is None:
        return second if first is None else first
    return first | second


_NO_FLAGS = BitMask.none(0)  # stands for a mark that stays as it is


def _with(
    member: Layer | Actor,
    *,
    selected: BitMask | None = _NO_FLAGS,
    hidden: BitMask | None = _NO_FLAGS,
    deleted: BitMask | None = _NO_FLAGS,
) -> Layer | Actor:
    old = member.marks
    marks = SelectionFlags(
        old.selected if selected is _NO_FLAGS else selected,
        old.hidden if hidden is _NO_FLAGS else hidden,
        old.deleted if deleted is _NO_FLAGS else deleted,
    )
    same = marks.selected is old.selected and marks.hidden is old.hidden and marks.deleted is old.deleted
    return member if same else replace(member, marks=marks)


# § Cutting a scene down to a box.


@dataclass(frozen=True)
class CropBox:
    """A box in the world, metres, that stands upright and is turned about z."""

    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    """To the left."""

    @property
    def to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Takes (-1..1)^3 to the box."""
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        matrix = np.eye(4)
        matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) * (np.array(self.size_m) / 2)
        matrix[:3, 3] = self.center_m
        return matrix

    @property
    def corners_m(self) -> Float64[np.ndarray, "8 3"]:
        """Corner i is on the upper side of x, y, z where bits 4, 2, 1 of i are set."""
        signs = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
        return signs @ self.to_world[:3, :3].T + self.to_world[:3, 3]

    def face_m(self, axis: int, upper: bool) -> Float64[np.ndarray, "3"]:
        return self.to_world[:3, 3] + (1.0 if upper else -1.0) * self.to_world[:3, axis]

    def pulled(
        self, axis: int, upper: bool, eye_m: Float64[np.ndarray, "3"], sight: Float64[np.ndarray, "3"]
    ) -> "CropBox":
        """Pull one face to where its axis passes a line of sight closest; the opposite face stays, none passes it."""
        direction = self.to_world[:3, axis] / (self.size_m[axis] / 2) * (1.0 if upper else -1.0)
        face = self.face_m(axis, upper)
        across = sight - (sight @ direction) * direction
        if across @ across < 1e-6:  # seen end-on
            return self
        # The point of the axis that is nearest to the sight, counted from the face along `direction`.
        by_m = float((eye_m - face) @ (direction - (sight @ direction) / (across @ across) * across))
        by_m = max(by_m, _THINNEST_M - self.size_m[axis])
        size = list(self.size_m)
        size[axis] += by_m
        x, y, z = (self.to_world[:3, 3] + 0.5 * by_m * direction).tolist()
        return CropBox((x, y, z), (size[0], size[1], size[2]), self.yaw_deg)


_THINNEST_M = 0.01


def box_around(scene: Scene) -> CropBox:
    """Box around the core of what stands still and can be seen, sky apart; of an empty scene 10 m at the origin."""
    layers = [each for each in scene.layers if each.visible and each.kind == "background" and len(each.gaussians)]
    if not layers:
        return CropBox((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
    core = core_bounds([part for each in layers if (part := scene.part(each)) is not None])
    x, y, z = core.middle.tolist()
    a, b, c = np.maximum(core.high - core.low, _THINNEST_M).tolist()
    return CropBox((x, y, z), (a, b, c))


def crop(scene: Scene, box: CropBox) -> Scene:
    """Mark as deleted what lies outside of a box with its centre; of background layers that may be edited."""

    def cropped(member: Layer | Actor) -> Layer | Actor:
        if isinstance(member, Actor) or member.kind != "background":
            return member
        outside = BitMask.of(~_inside(member.gaussians.means, scene.scene_to_world @ member.to_scene, box))
        marks = member.marks
        if not (outside if marks.deleted is None else outside - marks.deleted):
            return member
        deleted = outside if marks.deleted is None else marks.deleted | outside
        selected = marks.selected - outside if marks.selected is not None else None
        return replace(member, marks=SelectionFlags(selected if selected else None, marks.hidden, deleted))

    return edit_members(scene, cropped)


def _inside(
    means: Float32[np.ndarray, "n 3"], to_world: Float64[np.ndarray, "4 4"], box: CropBox
) -> Bool[np.ndarray, " n"]:
    to_box = np.linalg.inv(box.to_world) @ to_world
    inside = np.ones(len(means), np.bool_)
    for row in to_box[:3]:
        inside &= np.abs(means @ row[:3] + row[3]) <= 1
    return inside


# § What is deleted, taken out of the arrays for good; undo still has it.


def deleted_count(scene: Scene) -> int:
    """How many Gaussians are only marked as deleted."""
    masks = [each.marks.deleted for each in scene.members]
    return sum(mask.size for mask in masks if mask is not None)


def compact(scene: Scene) -> Scene:
    """Make new arrays without what is deleted, of locked and hidden members too; marks and selection sets follow."""
    kept = {each.key: ~each.marks.deleted for each in scene.members if each.marks.deleted}

    def change(masks: Mapping[str, BitMask]) -> Mapping[str, BitMask]:
        return {key: mask.take(kept[key].indices) if key in kept else mask for key, mask in masks.items()}

    members = tuple(_compacted(each, kept[each.key]) if each.key in kept else each for each in scene.members)
    return with_selections(with_members(scene, members), change) if kept else scene


def _compacted(member: Layer | Actor, kept: BitMask) -> Layer | Actor:
    where, marks = kept.indices, member.marks
    masks = [each.take(where) if each is not None else None for each in (marks.selected, marks.hidden)]
    selected, hidden = (each if each else None for each in masks)
    gaussians, wet_sh = take_gaussians(member, where)
    return replace(member, gaussians=gaussians, wet_sh=wet_sh, marks=SelectionFlags(selected, hidden))

"""Edits of the selected Gaussians: delete, hide, isolate, crop, and compaction. Only compaction copies arrays."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from ...scene.flags import BitMask, SelectionFlags
from ...scene.scene import Actor, Layer, Scene, core_bounds, take_gaussians
from .members import edit_members, is_editable, with_members, with_selections


def selected_count(scene: Scene) -> int:
    """Number of Gaussians that an edit of the selection would change."""
    masks = [_meant(each) for each in scene.members if is_editable(each)]
    return sum(mask.size for mask in masks if mask is not None)


def delete_selected(scene: Scene) -> Scene:
    """Mark the selection as deleted, and clear it."""
    return edit_members(scene, lambda each: _with(each, selected=None, deleted=_or(each.marks.deleted, _meant(each))))


def hide_selected(scene: Scene) -> Scene:
    """Hide the selection, and clear it."""
    return edit_members(scene, lambda each: _with(each, selected=None, hidden=_or(each.marks.hidden, _meant(each))))


def show_all(scene: Scene) -> Scene:
    """Show all hidden Gaussians of editable members."""
    return edit_members(scene, lambda each: _with(each, hidden=None))


def isolate_selected(scene: Scene) -> Scene:
    """Hide all editable Gaussians except the selected ones. Raises `ValueError` if nothing is selected."""
    if not selected_count(scene):
        raise ValueError("Nothing is selected.")

    def isolated(member: Layer | Actor) -> Layer | Actor:
        meant = _meant(member) or BitMask.none(len(member.gaussians))
        return _with(member, hidden=_or(member.marks.hidden, ~meant))

    return edit_members(scene, isolated)


def _meant(member: Layer | Actor) -> BitMask | None:
    """Selected and visible Gaussians, or None."""
    selected, left_out = member.marks.selected, member.marks.left_out
    meant = selected if selected is None or left_out is None else selected - left_out
    return meant if meant else None


def _or(first: BitMask | None, second: BitMask | None) -> BitMask | None:
    if first is None or second is None:
        return second if first is None else first
    return first | second


def _with(member: Layer | Actor, **masks: BitMask | None) -> Layer | Actor:
    """Return a member with other masks in its marks, the same object if they are identical."""
    same = all(getattr(member.marks, name) is mask for name, mask in masks.items())
    return member if same else replace(member, marks=replace(member.marks, **masks))


@dataclass(frozen=True)
class CropBox:
    """An upright box in the world, meters, rotated about z."""

    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_deg: float = 0.0
    """Counterclockwise seen from above."""

    @property
    def to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Transform from (-1..1)^3 to the box."""
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        matrix = np.eye(4)
        matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) * (np.array(self.size_m) / 2)
        matrix[:3, 3] = self.center_m
        return matrix

    @property
    def corners_m(self) -> Float64[np.ndarray, "8 3"]:
        """Corners; corner i is on the upper side of x, y, z if bits 4, 2, 1 of i are set."""
        signs = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
        return signs @ self.to_world[:3, :3].T + self.to_world[:3, 3]

    def face_m(self, axis: int, upper: bool) -> Float64[np.ndarray, "3"]:
        return self.to_world[:3, 3] + (1.0 if upper else -1.0) * self.to_world[:3, axis]

    def pulled(
        self, axis: int, upper: bool, eye_m: Float64[np.ndarray, "3"], sight: Float64[np.ndarray, "3"]
    ) -> "CropBox":
        """Move one face to where its axis passes a line of sight closest; it stays beyond the opposite, fixed face."""
        direction = self.to_world[:3, axis] / (self.size_m[axis] / 2) * (1.0 if upper else -1.0)
        face = self.face_m(axis, upper)
        across = sight - (sight @ direction) * direction
        if across @ across < 1e-6:  # the axis points at the eye
            return self
        # Signed distance along `direction` from the face to the axis point nearest to the line of sight.
        by_m = float((eye_m - face) @ (direction - (sight @ direction) / (across @ across) * across))
        by_m = max(by_m, _THINNEST_M - self.size_m[axis])
        size = list(self.size_m)
        size[axis] += by_m
        x, y, z = (self.to_world[:3, 3] + 0.5 * by_m * direction).tolist()
        return CropBox((x, y, z), (size[0], size[1], size[2]), self.yaw_deg)


_THINNEST_M = 0.01
_RIM = 0.2  # of the core's radius: what ends within it belongs to the core as a leaf to its plant


def box_around(scene: Scene) -> CropBox:
    """Box around the core of the visible background layers and what ends near it, without sky; 10 m if it is empty.

    The core alone leaves out some hundredths of a thing on each side.
    """
    layers = [each for each in scene.layers if each.visible and each.kind == "background" and len(each.gaussians)]
    parts = [part for each in layers if (part := scene.part(each)) is not None]
    if not parts:
        return CropBox((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
    core = core_bounds(parts)
    low, high = core.low, core.high
    rim_m = _RIM * core.radius_m
    for part in parts:
        means = part.remaining.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        near = means[np.all((means > core.low - rim_m) & (means < core.high + rim_m), axis=1)]
        low = np.minimum(low, near.min(axis=0, initial=np.inf))
        high = np.maximum(high, near.max(axis=0, initial=-np.inf))
    x, y, z = ((low + high) / 2).tolist()
    a, b, c = np.maximum(high - low, _THINNEST_M).tolist()
    return CropBox((x, y, z), (a, b, c))


def crop(scene: Scene, box: CropBox) -> Scene:
    """Mark Gaussians with centers outside of a box as deleted, in editable background layers."""

    def cropped(member: Layer | Actor) -> Layer | Actor:
        if isinstance(member, Actor) or member.kind != "background":
            return member
        to_box = np.linalg.inv(box.to_world) @ (scene.scene_to_world @ member.to_scene)
        means, marks = member.gaussians.means, member.marks
        inside = np.ones(len(means), np.bool_)
        for row in to_box[:3]:
            inside &= np.abs(means @ row[:3] + row[3]) <= 1
        outside = BitMask.of(~inside)
        if not (outside if marks.deleted is None else outside - marks.deleted):
            return member
        selected = marks.selected - outside if marks.selected is not None else None
        return _with(member, selected=selected if selected else None, deleted=_or(marks.deleted, outside))

    return edit_members(scene, cropped)


def deleted_count(scene: Scene) -> int:
    masks = [each.marks.deleted for each in scene.members]
    return sum(mask.size for mask in masks if mask is not None)


def deletions(steps: Iterable[tuple[str, Scene]]) -> list[tuple[str, int]]:
    """Return the numbers of Gaussians that are marked as deleted after some steps, by the steps that have marked them.

    `steps` are labels with the scene after each, the opened one first.
    """
    found, before = list[tuple[str, int]](), 0
    for label, scene in steps:
        count = deleted_count(scene)
        if count > before:
            found.append((label, count - before))
        while count < sum(size for _, size in found):  # purged, merged or removed: the oldest first
            (first, size), over = found[0], sum(size for _, size in found) - count
            found[:1] = [(first, size - over)] if size > over else []
        before = count
    return found


def compact(scene: Scene) -> Scene:
    """Remove deleted Gaussians from the arrays, also of locked and hidden members; marks and selection sets follow."""
    rows = {each.key: (~each.marks.deleted).indices for each in scene.members if each.marks.deleted}

    def compacted(member: Layer | Actor) -> Layer | Actor:
        if member.key not in rows:
            return member
        where, marks = rows[member.key], member.marks
        masks = [each.take(where) if each is not None else None for each in (marks.selected, marks.hidden)]
        gaussians, wet_sh = take_gaussians(member, where)
        marks = SelectionFlags(*(each if each else None for each in masks))
        return replace(member, gaussians=gaussians, wet_sh=wet_sh, marks=marks)

    def compacted_masks(masks: Mapping[str, BitMask]) -> Mapping[str, BitMask]:
        return {key: mask.take(rows[key]) if key in rows else mask for key, mask in masks.items()}

    members = tuple(compacted(each) for each in scene.members)
    return with_selections(with_members(scene, members), compacted_masks) if rows else scene

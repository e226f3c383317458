"""Edits that only mark Gaussians: delete, hide, show, isolate. No array is copied."""

from dataclasses import replace

from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.scene.scene import Scene

from .members import edited, is_editable


def selected_count(scene: Scene) -> int:
    """How many Gaussians an edit of the selection would change."""
    masks = [_meant(each) for each in scene.members if is_editable(each)]
    return sum(mask.size for mask in masks if mask is not None)


def delete_selected(scene: Scene) -> Scene:
    """Mark what is selected as deleted; nothing is selected afterwards."""
    return edited(scene, lambda each: _with(each, selected=None, deleted=_either(each.marks.deleted, _meant(each))))


def hide_selected(scene: Scene) -> Scene:
    return edited(scene, lambda each: _with(each, selected=None, hidden=_either(each.marks.hidden, _meant(each))))


def show_all(scene: Scene) -> Scene:
    """Show what is hidden of every member that may be edited."""
    return edited(scene, lambda each: each if each.marks.hidden is None else _with(each, hidden=None))


def isolate_selected(scene: Scene) -> Scene:
    """Hide everything that may be edited but what is selected. Raises `ValueError` where nothing is."""
    if not selected_count(scene):
        raise ValueError("Nothing is selected.")

    def isolated(member: Layer | Actor) -> Layer | Actor:
        meant = _meant(member) or Mask.none(len(member.gaussians))
        return _with(member, selected=member.marks.selected, hidden=_either(member.marks.hidden, ~meant))

    return edited(scene, isolated)


def _meant(member: Layer | Actor) -> Mask | None:
    """What is selected and can be seen; None where nothing is."""
    selected, left_out = member.marks.selected, member.marks.left_out
    meant = selected if selected is None or left_out is None else selected - left_out
    return meant if meant else None


def _either(first: Mask | None, second: Mask | None) -> Mask | None:
    if first is None or second is None:
        return second if first is None else first
    return first | second


_KEPT = Mask.none(0)  # stands for a mark that stays as it is


def _with(
    member: Layer | Actor, *, selected: Mask | None = _KEPT, hidden: Mask | None = _KEPT, deleted: Mask | None = _KEPT
) -> Layer | Actor:
    old = member.marks
    marks = Marks(
        old.selected if selected is _KEPT else selected,
        old.hidden if hidden is _KEPT else hidden,
        old.deleted if deleted is _KEPT else deleted,
    )
    same = marks.selected is old.selected and marks.hidden is old.hidden and marks.deleted is old.deleted
    return member if same else replace(member, marks=marks)

"""Selectable Gaussians (visible, of unlocked members), and selections combined or by color."""

import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float32

from ...scene.flags import BitMask
from ...scene.gaussians import SH_C0
from ...scene.scene import Actor, DrawItem, Layer, Scene
from ..edits.members import is_editable

Found = Mapping[str, BitMask]
"""Gaussians found by a tool, by the keys of their members; members without any may be absent."""


def candidates(scene: Scene, time_s: float) -> dict[str, DrawItem]:
    """Parts of selectable members at a time, by their keys, without actors that are absent then."""
    parts = {member.key: scene.part(member, time_s) for member in editable(scene)}
    return {key: part for key, part in parts.items() if part is not None}


def editable(scene: Scene) -> Iterator[Layer | Actor]:
    return filter(is_editable, scene.members)


def visible_gaussians(member: Layer | Actor) -> BitMask:
    """Gaussians of a member that are neither hidden nor deleted."""
    left_out = member.marks.left_out
    return BitMask.all(len(member.gaussians)) if left_out is None else ~left_out


def selected(member: Layer | Actor) -> BitMask:
    return member.marks.selected or BitMask.none(len(member.gaussians))


# Combination of selections

Mode = Literal["set", "add", "remove", "intersect"]
_COMBINE: dict[Mode, Callable[[BitMask, BitMask], BitMask]] = {
    "set": lambda _, found: found, "add": operator.or_, "remove": operator.sub, "intersect": operator.and_
}  # fmt: skip


def combine_selection(scene: Scene, found: Found, mode: Mode) -> Scene:
    """Combine found, shown Gaussians with the selection of editable members; the same scene if nothing changes."""
    for member in editable(scene):
        own = found.get(member.key) or BitMask.none(len(member.gaussians))
        mask = _COMBINE[mode](selected(member), own & visible_gaussians(member))
        if not mask.same_as(selected(member)):
            scene = scene.with_member(member.key, marks=replace(member.marks, selected=mask if mask else None))
    return scene


def all_selected(scene: Scene) -> Scene:
    """Select all shown Gaussians of editable members."""
    return combine_selection(scene, {member.key: visible_gaussians(member) for member in editable(scene)}, "set")


def none_selected(scene: Scene) -> Scene:
    """Clear the selection."""
    return combine_selection(scene, {}, "set")


def inverted(scene: Scene) -> Scene:
    """Select the shown Gaussians that were not selected."""
    rest = {member.key: visible_gaussians(member) - selected(member) for member in editable(scene)}
    return combine_selection(scene, rest, "set")


def selections(scene: Scene) -> dict[str, BitMask]:
    """Selected Gaussians of editable members; only members with a selection."""
    return {member.key: selected(member) for member in editable(scene) if member.marks.selected}


def selected_count(scene: Scene) -> int:
    """Number of selected Gaussians of editable members."""
    return sum(mask.size for mask in selections(scene).values())


def selectable_count(scene: Scene) -> int:
    """Number of Gaussians of editable members that are neither hidden nor deleted."""
    left_out = ((len(member.gaussians), member.marks.left_out) for member in editable(scene))
    return sum(count - (0 if mask is None else mask.size) for count, mask in left_out)


def base_colors(part: DrawItem) -> Float32[np.ndarray, "n 3"]:
    """Display color of each Gaussian from its degree-0 harmonics, graded as drawn, within 0..1."""
    colors = part.gaussians.sh[:, 0].copy()
    colors *= np.float32(SH_C0)
    colors += np.float32(0.5)
    if part.colors is not None:
        matrix = part.colors.astype(np.float32)
        colors = colors @ matrix[:, :3].T + matrix[:, 3]
    return np.clip(colors, 0, 1, out=colors)


def base_color(part: DrawItem, index: int) -> Float32[np.ndarray, "3"]:
    """Display color of one Gaussian, see `base_colors`."""
    return base_colors(part._replace(gaussians=part.gaussians.take(np.array([index]))))[0]


def select_similar_colors(
    scene: Scene, time_s: float, color: Float32[np.ndarray, "3"], tolerance: float
) -> dict[str, BitMask]:
    """Find Gaussians whose base color differs by at most `tolerance` (0..1) in each channel."""
    found: dict[str, BitMask] = {}
    for key, part in candidates(scene, time_s).items():
        difference = base_colors(part)
        difference -= color
        near = np.abs(difference, out=difference) <= tolerance
        found[key] = BitMask.of(near[:, 0] & near[:, 1] & near[:, 2])
    return found

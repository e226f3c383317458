"""Selection commands, each one labeled undo step; selection sets; and the options of the tools."""

from dataclasses import dataclass, field, replace

from ...scene.flags import BitMask
from ...scene.scene import Scene
from ..document import EditedDocument
from ..edits.gaussians import CropBox
from .attributes import AttributeHistogram
from .candidates import (
    Found,
    Mode,
    all_selected,
    combine_selection,
    inverted,
    none_selected,
    selected_count,
    selections,
)
from .screen import DepthMode, Depths
from .volume import Sphere, expand, selection_boundary


def select(session: EditedDocument, found: Found, mode: Mode, by: str) -> None:
    """Combine found Gaussians with the selection; no undo step if nothing changes. `by` ends the step's label."""
    before, after = session.scene, combine_selection(session.scene, found, mode)
    if after is before:
        return
    now, then = selected_count(after), selected_count(before)
    named = {
        "set": f"Select {now:,} by {by}" if now else f"Select none by {by}",
        "add": f"Add {now - then:,} by {by}",
        "remove": f"Remove {then - now:,} by {by}",
        "intersect": f"Keep {now:,} by {by}",
    }
    session.set_scene(named[mode], after)


def select_all(session: EditedDocument) -> None:
    scene = all_selected(session.scene)
    _go_to(session, f"Select all {selected_count(scene):,}", scene)


def select_none(session: EditedDocument) -> None:
    _go_to(session, "Select none", none_selected(session.scene))


def invert(session: EditedDocument) -> None:
    scene = inverted(session.scene)
    _go_to(session, f"Invert selection to {selected_count(scene):,}", scene)


def grow(session: EditedDocument, distance_m: float) -> None:
    """Add Gaussians within a distance of the selection."""
    found = expand(session.scene, session.clock.time_s, distance_m)
    scene = combine_selection(session.scene, found, "add")
    _go_to(session, f"Grow selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def shrink(session: EditedDocument, distance_m: float) -> None:
    """Deselect Gaussians within a distance of unselected ones."""
    found = selection_boundary(session.scene, session.clock.time_s, distance_m)
    scene = combine_selection(session.scene, found, "remove")
    _go_to(session, f"Shrink selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def save_set(session: EditedDocument, name: str | None = None) -> bool:
    """Save the selection as a set (name None: an unused one).

    On error, sets `problem` and returns False.
    """
    name = unused_set_name(session.scene) if name is None else name
    try:
        scene = save_selection_set(session.scene, name)
    except ValueError as error:
        session.problem = f"The selection set is not saved: {error}"
        return False
    session.set_scene(f"Save set {name.strip()}", scene)
    return True


def recall_set(session: EditedDocument, name: str, mode: Mode) -> None:
    select(session, selection_set_contents(session.scene, name), mode, f"set {name}")


def rename_set(session: EditedDocument, name: str, other: str) -> bool:
    """Rename a set; on error, sets `problem` and returns False."""
    try:
        scene = rename_selection_set(session.scene, name, other)
    except ValueError as error:
        session.problem = f"The selection set keeps its name: {error}"
        return False
    if other.strip() != name:
        session.set_scene(f"Rename set {name} to {other.strip()}", scene)
    return True


def remove_set(session: EditedDocument, name: str) -> None:
    session.set_scene(f"Delete set {name}", remove_selection_set(session.scene, name))


def has_selection(session: EditedDocument) -> bool:
    return bool(selections(session.scene))


def _go_to(session: EditedDocument, label: str, scene: Scene) -> None:
    if scene is not session.scene:
        session.set_scene(label, scene)


# Selection sets


def save_selection_set(scene: Scene, name: str) -> Scene:
    """Save the selection as a set; replaces a set of that name.

    Raises `ValueError` if the name is empty or nothing is selected.
    """
    now = selections(scene)
    if not now:
        raise ValueError("nothing is selected that a selection set could keep")
    return replace(scene, selections={**scene.selections, _checked(name): now})


def selection_set_contents(scene: Scene, name: str) -> dict[str, BitMask]:
    """Return the Gaussians of a set; skips members that are gone or whose number of Gaussians changed."""
    counts = {member.key: len(member.gaussians) for member in scene.members}
    return {key: mask for key, mask in scene.selections[name].items() if counts.get(key) == mask.count}


def rename_selection_set(scene: Scene, name: str, other: str) -> Scene:
    """Rename a set in its place. Raises `ValueError` if the name is empty or in use."""
    other = _checked(other)
    if other != name and other in scene.selections:
        raise ValueError(f"there is a selection set named {other!r} already")
    return replace(scene, selections={other if each == name else each: own for each, own in scene.selections.items()})


def remove_selection_set(scene: Scene, name: str) -> Scene:
    """Delete a set; the selection is unchanged."""
    return replace(scene, selections={each: own for each, own in scene.selections.items() if each != name})


def unused_set_name(scene: Scene) -> str:
    number = 1
    while f"selection {number}" in scene.selections:
        number += 1
    return f"selection {number}"


def _checked(name: str) -> str:
    if not name.strip():
        raise ValueError("a selection set needs a name")
    return name.strip()


# Tool options


@dataclass(slots=True)
class SelectionOptions:
    """Settings of the selection tools; not part of the document."""

    mode: Mode = "set"
    """Mode without a modifier key."""
    depths: Depths = "all through"
    depth_m: float = 20.0
    touching: bool = False
    brush_radius_px: float = 24.0
    tolerance: float = 0.1
    """Color tolerance of the flood and color tools, 0..1."""
    flood_reach: float = 2.0
    """In spacings of the Gaussians."""
    distance_m: float = 0.1
    """Distance to grow and shrink by."""
    attribute: str = "opacity"
    range: tuple[float, float] | None = None
    """Range of the attribute, in its unit; None until the user has chosen one."""
    set_name: str = ""
    """Name of the next selection set; empty for a numbered one."""
    renamed_set: str = ""
    """Set being renamed; empty for none."""
    new_name: str = ""
    ball: Sphere | None = None
    """Sphere that is placed but not yet applied."""
    box: CropBox | None = None
    """Box that is placed but not yet applied."""
    histogram: AttributeHistogram = field(default_factory=AttributeHistogram)

    @property
    def reach(self) -> DepthMode:
        """Depth reach of shapes drawn in the image."""
        return DepthMode(self.depths, self.depth_m, self.touching)

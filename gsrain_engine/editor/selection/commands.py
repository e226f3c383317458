"""Selection commands, each one labeled undo step; selection sets; and the options of the tools."""

from dataclasses import dataclass, field, replace
from itertools import count

from ...scene.scene import Scene
from ..document import EditedDocument
from ..edits.gaussians import CropBox
from . import candidates
from .attributes import AttributeHistogram
from .candidates import Found, Mode
from .screen import DepthMode, Depths
from .volume import Sphere, near_selection


def select(session: EditedDocument, found: Found, mode: Mode, by: str) -> None:
    """Combine found Gaussians with the selection; no undo step if nothing changes. `by` ends the step's label."""
    before, after = session.scene, candidates.combine_selection(session.scene, found, mode)
    if after is before:
        return
    now, then = candidates.selected_count(after), candidates.selected_count(before)
    named = {
        "set": f"Select {now:,} by {by}" if now else f"Select none by {by}",
        "add": f"Add {now - then:,} by {by}",
        "remove": f"Remove {then - now:,} by {by}",
        "intersect": f"Keep {now:,} by {by}",
    }
    session.set_scene(named[mode], after)


def select_all(session: EditedDocument) -> None:
    _change(session, "Select all {:,}", candidates.all_selected(session.scene))


def select_none(session: EditedDocument) -> None:
    _change(session, "Select none", candidates.none_selected(session.scene))


def invert(session: EditedDocument) -> None:
    _change(session, "Invert selection to {:,}", candidates.inverted(session.scene))


def grow(session: EditedDocument, distance_m: float) -> None:
    """Add Gaussians within a distance of the selection."""
    found = near_selection(session.scene, session.clock.time_s, distance_m)
    scene = candidates.combine_selection(session.scene, found, "add")
    _change(session, f"Grow selection by {distance_m:.3g} m to {{:,}}", scene)


def shrink(session: EditedDocument, distance_m: float) -> None:
    """Deselect Gaussians within a distance of unselected ones."""
    found = near_selection(session.scene, session.clock.time_s, distance_m, inside=True)
    scene = candidates.combine_selection(session.scene, found, "remove")
    _change(session, f"Shrink selection by {distance_m:.3g} m to {{:,}}", scene)


def _change(session: EditedDocument, label: str, scene: Scene) -> None:
    """Make a scene with another selection an undo step; `label` has a place for the number of selected Gaussians."""
    if scene is not session.scene:
        session.set_scene(label.format(candidates.selected_count(scene)), scene)


def has_selection(session: EditedDocument) -> bool:
    return bool(candidates.selections(session.scene))


# Selection sets


def save_set(session: EditedDocument, name: str | None = None) -> bool:
    """Save the selection as a set (None: an unused name); on error sets `problem` and returns False."""
    sets, now = session.scene.selections, candidates.selections(session.scene)
    name = (unused_set_name(session.scene) if name is None else name).strip()
    if not (now and name):
        trouble = "a selection set needs a name" if now else "nothing is selected that a selection set could keep"
        session.problem = f"The selection set is not saved: {trouble}"
        return False
    session.set_scene(f"Save set {name}", replace(session.scene, selections={**sets, name: now}))
    return True


def unused_set_name(scene: Scene) -> str:
    return next(each for number in count(1) if (each := f"selection {number}") not in scene.selections)


def recall_set(session: EditedDocument, name: str, mode: Mode) -> None:
    """Combine a set with the selection, without members that are gone or whose number of Gaussians has changed."""
    counts = {member.key: len(member.gaussians) for member in session.scene.members}
    own = session.scene.selections[name]
    select(session, {key: mask for key, mask in own.items() if counts.get(key) == mask.count}, mode, f"set {name}")


def rename_set(session: EditedDocument, name: str, other: str) -> bool:
    """Rename a set in its place; without a name, or if it is in use, sets `problem` and returns False."""
    sets, other = session.scene.selections, other.strip()
    if not other or (other != name and other in sets):
        trouble = f"there is a selection set named {other!r} already" if other else "a selection set needs a name"
        session.problem = f"The selection set keeps its name: {trouble}"
        return False
    if other != name:
        renamed = {other if each == name else each: own for each, own in sets.items()}
        session.set_scene(f"Rename set {name} to {other}", replace(session.scene, selections=renamed))
    return True


def remove_set(session: EditedDocument, name: str) -> None:
    """Delete a set; the selection is unchanged."""
    rest = {each: own for each, own in session.scene.selections.items() if each != name}
    session.set_scene(f"Delete set {name}", replace(session.scene, selections=rest))


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

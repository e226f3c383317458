"""What a person does with the selection, each as one step of the history with a name that tells what happened."""

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
    """Take in what a tool has found; no step where that changes nothing. `by` ends the step's name."""
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
    """Select what was not selected."""
    scene = inverted(session.scene)
    _go_to(session, f"Invert selection to {selected_count(scene):,}", scene)


def grow(session: EditedDocument, distance_m: float) -> None:
    """Take in what is at most so far from what is selected."""
    found = expand(session.scene, session.clock.time_s, distance_m)
    scene = combine_selection(session.scene, found, "add")
    _go_to(session, f"Grow selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def shrink(session: EditedDocument, distance_m: float) -> None:
    """Let go of what is at most so far from what is not selected."""
    found = selection_boundary(session.scene, session.clock.time_s, distance_m)
    scene = combine_selection(session.scene, found, "remove")
    _go_to(session, f"Shrink selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def save_set(session: EditedDocument, name: str | None = None) -> bool:
    """Keep what is selected under a name (None: one that is free).

    What is wrong with that is told as `problem`, and False returned.
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
    """Call a set otherwise; what is wrong with that is told as `problem`, and False returned."""
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


# § Selection sets: selections that the scene keeps under a name.


def save_selection_set(scene: Scene, name: str) -> Scene:
    """Keep what is selected under a name; a set of that name is replaced.

    Raises `ValueError` where the name is empty or nothing is selected.
    """
    now = selections(scene)
    if not now:
        raise ValueError("nothing is selected that a selection set could keep")
    return replace(scene, selections={**scene.selections, _checked(name): now})


def selection_set_contents(scene: Scene, name: str) -> dict[str, BitMask]:
    """Find the Gaussians of a set; members that are gone, or have other Gaussians now, are passed by."""
    counts = {member.key: len(member.gaussians) for member in scene.members}
    return {key: mask for key, mask in scene.selections[name].items() if counts.get(key) == mask.count}


def rename_selection_set(scene: Scene, name: str, other: str) -> Scene:
    """Call a set otherwise; it keeps its place. Raises `ValueError` where the name is empty or taken."""
    other = _checked(other)
    if other != name and other in scene.selections:
        raise ValueError(f"there is a selection set named {other!r} already")
    return replace(scene, selections={other if each == name else each: own for each, own in scene.selections.items()})


def remove_selection_set(scene: Scene, name: str) -> Scene:
    """Forget a set; what is selected stays."""
    return replace(scene, selections={each: own for each, own in scene.selections.items() if each != name})


def unused_set_name(scene: Scene) -> str:
    """Return a name that no set has."""
    number = 1
    while f"selection {number}" in scene.selections:
        number += 1
    return f"selection {number}"


def _checked(name: str) -> str:
    if not name.strip():
        raise ValueError("a selection set needs a name")
    return name.strip()


# § How a person selects now: what the tools and the panel share.


@dataclass(slots=True)
class SelectionOptions:
    """Settings of the selection tools; not part of the document."""

    mode: Mode = "set"
    """What a tool does without a key held."""
    depths: Depths = "all through"
    depth_m: float = 20.0
    touching: bool = False
    brush_radius_px: float = 24.0
    tolerance: float = 0.1
    """Of flood and colour pick, 0..1."""
    flood_reach: float = 2.0
    """In spacings of the Gaussians."""
    distance_m: float = 0.1
    """By which to grow and shrink."""
    attribute: str = "opacity"
    range: tuple[float, float] | None = None
    """Of the attribute, in its unit; None until a person has chosen one."""
    set_name: str = ""
    """What the next selection set is to be called; empty: by a number."""
    renamed_set: str = ""
    """Which set is being called otherwise; empty: none."""
    new_name: str = ""
    """What it is to be called."""
    ball: Sphere | None = None
    """What the sphere tool has placed and not yet applied."""
    box: CropBox | None = None
    """What the box tool has placed and not yet applied."""
    histogram: AttributeHistogram = field(default_factory=AttributeHistogram)

    @property
    def reach(self) -> DepthMode:
        """How far shapes of the picture reach."""
        return DepthMode(self.depths, self.depth_m, self.touching)

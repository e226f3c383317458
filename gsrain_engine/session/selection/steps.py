"""What a person does with the selection, each as one step of the history with a name that tells what happened."""

from gsrain_engine.scene.scene import Scene

from ..document.edited_document import EditedDocument
from .candidates import Found
from .combine import Mode, all_selected, combined, inverted, none_selected, selected_count, selections
from .neighbourhood import grown, rim
from .saved_sets import found_in_set, free_name, removed, renamed, saved


def select(session: EditedDocument, found: Found, mode: Mode, by: str) -> None:
    """Take in what a tool has found; no step where that changes nothing. `by` ends the step's name."""
    before, after = session.scene, combined(session.scene, found, mode)
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
    found = grown(session.scene, session.clock.time_s, distance_m)
    scene = combined(session.scene, found, "add")
    _go_to(session, f"Grow selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def shrink(session: EditedDocument, distance_m: float) -> None:
    """Let go of what is at most so far from what is not selected."""
    found = rim(session.scene, session.clock.time_s, distance_m)
    scene = combined(session.scene, found, "remove")
    _go_to(session, f"Shrink selection by {distance_m:.3g} m to {selected_count(scene):,}", scene)


def save_set(session: EditedDocument, name: str | None = None) -> bool:
    """Keep what is selected under a name (None: one that is free).

    What is wrong with that is told as `problem`, and False returned.
    """
    name = free_name(session.scene) if name is None else name
    try:
        scene = saved(session.scene, name)
    except ValueError as error:
        session.problem = f"The selection set is not saved: {error}"
        return False
    session.set_scene(f"Save set {name.strip()}", scene)
    return True


def recall_set(session: EditedDocument, name: str, mode: Mode) -> None:
    select(session, found_in_set(session.scene, name), mode, f"set {name}")


def rename_set(session: EditedDocument, name: str, other: str) -> bool:
    """Call a set otherwise; what is wrong with that is told as `problem`, and False returned."""
    try:
        scene = renamed(session.scene, name, other)
    except ValueError as error:
        session.problem = f"The selection set keeps its name: {error}"
        return False
    if other.strip() != name:
        session.set_scene(f"Rename set {name} to {other.strip()}", scene)
    return True


def remove_set(session: EditedDocument, name: str) -> None:
    session.set_scene(f"Delete set {name}", removed(session.scene, name))


def has_selection(session: EditedDocument) -> bool:
    return bool(selections(session.scene))


def _go_to(session: EditedDocument, label: str, scene: Scene) -> None:
    if scene is not session.scene:
        session.set_scene(label, scene)

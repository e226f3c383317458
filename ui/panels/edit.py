"""Edit panel, floater cleanup, placement, actor motion, and the History panel."""

from dataclasses import replace

import msgspec
from imgui_bundle import imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits import gaussians
from gsrain_engine.editor.edits.actors import duration_of, retime_actor, start_of, turn_actor
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.edits.layers import duplicate, remove
from gsrain_engine.editor.edits.transform import Pose, layer_pose, set_layer_pose
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.floaters import FLOATERS_TITLE, FloaterFinder
from gsrain_engine.editor.jobs.job import JobRunner
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.steps import EditStep, python_program, shell_command, steps_since
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.scene.scene import Actor, Layer

from ..widgets.fields import (
    CLAMPED,
    LOGARITHMIC,
    button,
    checkbox,
    copy_buttons,
    disabled,
    end_gesture_when_released,
    faint,
    field_label,
    plain_label,
    share_of_width,
    text_color,
)
from ..widgets.numbers import slide
from ..widgets.text import label
from .layers import grading_fields

_OPEN = imgui.TreeNodeFlags_.default_open


class _State:
    """State of the panels that is not part of the document."""

    rules = FloaterRules()
    scrolled_to = -1
    """Step that the history was scrolled to."""


def edit_panel(
    document: Document, viewport: ViewportState, playback: Playback, floaters: FloaterFinder, jobs: JobRunner
) -> None:
    _selection(document)
    member = viewport.active_member
    if member is None:
        imgui.separator_text("Layer")
        with text_color(imgui.Col_.text_disabled):
            imgui.text_wrapped("Select a layer or an actor in Layers.")
    else:
        _member(document, viewport, playback, member)
    if imgui.collapsing_header("Floaters", _OPEN):
        _floaters(document, floaters, jobs)


def _selection(document: Document) -> None:
    scene, half = document.scene, share_of_width(2)
    count, deleted = gaussians.selected_count(scene), gaussians.deleted_count(scene)
    has_hidden = any(each.marks.hidden for each in scene.members)
    imgui.separator_text(f"{count:,} selected" if count else "Nothing selected")
    if button("Delete", "Delete the selection (Delete); undo restores it.", width=half, enabled=count > 0):
        document.edit(f"Delete {count:,} selected", gaussians.delete_selected)
    imgui.same_line()
    if button("Hide", "Do not draw the selection (H).", width=half, enabled=count > 0):
        document.edit("Hide selection", gaussians.hide_selected)
    help_text = "Hide everything else; locked layers are not changed (Shift+I)."
    if button("Isolate", help_text, width=half, enabled=count > 0):
        document.edit("Isolate selection", gaussians.isolate_selected)
    imgui.same_line()
    if button("Show all", "Draw all hidden Gaussians (Shift+H).", width=half, enabled=has_hidden):
        document.edit("Show all", gaussians.show_all)
    if deleted and button(f"Purge {deleted:,} Gaussians###purge", "", width=-1):
        document.edit("Purge deleted", gaussians.compact)
    if deleted and imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        imgui.set_tooltip(_purge_help(document))


def _purge_help(document: Document) -> str:
    """List by step what *Purge* would remove: a crop deletes, too, and what was separated is a copy."""
    steps = document.history.steps[: document.history.cursor + 1]
    found = gaussians.deletions((each.label, each.document.scene) for each in steps)
    rows = "".join(f"\n    {count:,}: {label}" for label, count in found)
    return (
        "Remove from memory and files the Gaussians that are no longer in the picture, but are there for undo:"
        f"{rows}\nFrames hardly get faster, since they are not drawn. Undo restores them."
    )


def _member(document: Document, viewport: ViewportState, playback: Playback, member: Layer | Actor) -> None:
    imgui.separator_text(viewport.chosen_title)
    if len(viewport.chosen_members) > 1:
        faint(f"Color acts on all of them, the rest on {member.name}, which was clicked last.")
    if member.locked:
        imgui.text_disabled(f"{member.name} is locked.")
    with disabled(member.locked):
        if imgui.collapsing_header("Place", _OPEN):
            _place_fields(document, playback, member)
        if isinstance(member, Actor) and imgui.collapsing_header("Drive", _OPEN):
            _actor_fields(document, viewport, member)
    if imgui.collapsing_header("Color", _OPEN):
        grading_fields(document, viewport)


# Floater cleanup

_RANGES = {"opacity_below": (1.0, "%.3g"), "size_above_m": (20.0, "%.3g"), "isolation_above": (50.0, "%.3g")}
"""Upper bound and number format of each slider."""


def _floaters(document: Document, floaters: FloaterFinder, jobs: JobRunner) -> None:
    for name, (high, form) in _RANGES.items():
        field_label(name, FloaterRules)
        value = getattr(_State.rules, name)
        changed, value = slide(f"##{name}", value, 0.0, high, form if value else "off", LOGARITHMIC)
        if changed:
            _State.rules = msgspec.structs.replace(_State.rules, **{name: value})
    job, count = jobs.newest("floaters"), floaters.count
    if job is not None and job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), job.progress.message)
        if button("Cancel##floaters", "Stop the search; the selection does not change.", width=-1):
            job.cancel()
        return
    help_text = "Select Gaussians that meet any of the rules, in background layers that are not locked."
    if button(FLOATERS_TITLE, help_text, width=-1):
        floaters.find(_State.rules)
    is_latest = document.history.undo_label == FLOATERS_TITLE
    if job is not None and count is not None and (is_latest or not count):
        marked = " Faint ones are marked by dots." if count else ""
        imgui.text_wrapped(f"{job.progress.message}.{marked}")
        title = f"Delete {count:,} floaters"
        if count and button(title, "Delete the found floaters; undo restores them.", width=-1):
            document.edit("Delete floaters", gaussians.delete_selected)


# Position, rotation and scale


def _place_fields(document: Document, playback: Playback, member: Layer | Actor) -> None:
    time_s, key = playback.clock.time_s, member.key
    pose = layer_pose(document.scene, key, time_s)
    if pose is None:
        imgui.text_disabled(f"Not in the scene at {time_s:.2f} s.")
        return

    def place(changed: bool, moved: Pose) -> None:
        if changed:
            document.edit(f"Place {member.name}", set_layer_pose, key, moved, time_s, gesture=f"place {key}")
        end_gesture_when_released(document)

    origin = "at this time; the whole drive moves along" if isinstance(member, Actor) else "relative to its file"
    plain_label("Position (m)", f"x, y, z in the world, {origin}.")
    moved, (x, y, z) = imgui.drag_float3("##position", list(pose.position_m), 0.02, -1e6, 1e6, "%.2f")
    place(moved, replace(pose, position_m=(x, y, z)))
    plain_label("Rotation (deg)", f"In degrees about the world's x, then y, then z, {origin}.")
    turned, (x, y, z) = imgui.drag_float3("##turn", list(pose.turn_deg), 0.25, -360, 360, "%.1f")
    place(turned, replace(pose, turn_deg=(x, y, z)))
    plain_label("Scale", "Factor of size, equal along all axes.")
    scaled, scale = imgui.drag_float("##scale", pose.scale, 0.005, 0.001, 1000, "%.3f", LOGARITHMIC)
    place(scaled, replace(pose, scale=scale))


# Actor motion


def _actor_fields(document: Document, viewport: ViewportState, actor: Actor) -> None:
    key, start, duration = actor.key, start_of(actor), duration_of(actor)
    plain_label("Starts at (s)", "Time of the scene at which its drive starts.")
    changed, typed = imgui.drag_float("##start", start, 0.02, -3600, 3600, "%.2f")
    if changed:
        document.edit(f"Re-time {actor.name}", retime_actor, key, typed, max(duration, 0.01), gesture=f"start {key}")
    end_gesture_when_released(document)
    plain_label("Duration (s)", "Duration of its drive in seconds: shorter is faster.")
    with disabled(duration == 0):
        changed, typed = imgui.drag_float("##duration", duration, 0.02, 0.05, 3600, "%.2f", CLAMPED)
        if changed:
            document.edit(f"Re-time {actor.name}", retime_actor, key, start, typed, gesture=f"duration {key}")
        end_gesture_when_released(document)
    half = share_of_width(2)
    help_text = "Turn it by 15 degrees in place, at all times; its path does not change."
    for number, (title, degrees) in enumerate((("Turn left", 15.0), ("Turn right", -15.0))):
        if number:
            imgui.same_line()
        if button(title, help_text, width=half):
            document.edit(f"Turn {actor.name}", turn_actor, key, degrees)
    if button("Copy##actor", "Add a copy on the same drive; move or re-time it next.", width=half):
        document.edit(f"Copy {actor.name}", duplicate, key)
    imgui.same_line()
    if button("Remove##actor", "Remove it from the scene; undo restores it.", width=half):
        document.edit(f"Remove {actor.name}", remove, key)
    follows = viewport.following.key == key
    help_text = "The camera moves and turns with it; a drag still looks around."
    if checkbox("Follow actor with camera", follows, help_text) != follows:
        viewport.following.follow("" if follows else key)
        viewport.options.follow_path = False


# History panel


def history_panel(document: Document, files: Files, status: StatusBus) -> None:
    history, chosen = document.history, None
    _copy_buttons(document, files, status)
    for number, step in enumerate(history.labels):
        with text_color(imgui.Col_.text_disabled if number > history.cursor else imgui.Col_.text):
            if imgui.selectable(label(step, str(number)), number == history.cursor)[0]:
                chosen = number
        imgui.set_item_tooltip("Go to this step." if number != history.cursor else "The present state.")
        if number == history.cursor != _State.scrolled_to:
            imgui.set_scroll_here_y(0.8)
        if number and (change := history.steps[number - 1].document.rain_change(history.steps[number].document)):
            imgui.same_line()
            imgui.text_disabled(change)
    _State.scrolled_to = history.cursor
    if chosen is not None:
        document.go_to_step(chosen)


def _copy_buttons(document: Document, files: Files, status: StatusBus) -> None:
    """Draw the buttons that copy all steps since the scene was opened or saved."""

    def steps() -> list[EditStep]:
        return steps_since(document.history, files.saved)

    why_not = None if files.has_changes else "There are no steps since the scene was opened or saved."
    why_not = "The scene is not in a file yet: save it first." if files.source is None else why_not
    source = files.source or ""
    forms = {"command": lambda: shell_command(source, steps()), "Python": lambda: python_program(source, steps())}
    copy_buttons("the steps since the scene was opened or saved", forms, status, why_not)
    imgui.separator()

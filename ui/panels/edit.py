"""Edit panel, floater cleanup, placement, actor motion, and the History panel."""

from dataclasses import dataclass

import msgspec
from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.editor import FLOATERS_TITLE, Editor
from gsrain_engine.editor.edits.actors import duration_of, retime_actor, start_of, turn_actor
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.edits.gaussians import (
    compact,
    delete_selected,
    deleted_count,
    hide_selected,
    isolate_selected,
    selected_count,
    show_all,
)
from gsrain_engine.editor.edits.layers import duplicate, remove
from gsrain_engine.editor.edits.transform import Pose, layer_pose, set_layer_pose
from gsrain_engine.scene.scene import Actor, Layer

from ..widgets.fields import end_gesture_when_released, field_info, plain_label
from ..widgets.text import label
from .layers import grading_fields


def edit_panel(session: Editor) -> None:
    _selection(session)
    member = next((each for each in session.scene.members if each.key == session.view.member), None)
    if member is None:
        imgui.separator_text("Layer")
        imgui.text_disabled("Pick a layer or an actor in Layers.")
    else:
        _member(session, member)
    if imgui.collapsing_header("Floaters", imgui.TreeNodeFlags_.default_open):
        floater_fields(session)


def _selection(session: Editor) -> None:
    scene = session.scene
    count, deleted = selected_count(scene), deleted_count(scene)
    imgui.separator_text(f"{count:,} selected" if count else "Nothing selected")
    wide = ImVec2((imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2, 0)
    imgui.begin_disabled(not count)
    if imgui.button("Delete", wide):
        session.edit("Delete the selection", delete_selected)
    imgui.set_item_tooltip("Delete what is selected (Delete); undo brings it back.")
    imgui.same_line()
    if imgui.button("Hide", wide):
        session.edit("Hide the selection", hide_selected)
    imgui.set_item_tooltip("Do not draw what is selected (H).")
    if imgui.button("Isolate", wide):
        session.edit("Isolate the selection", isolate_selected)
    imgui.set_item_tooltip("Hide everything else; locked layers stay as they are.")
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(not any(each.marks.hidden for each in scene.members))
    if imgui.button("Show all", wide):
        session.edit("Show all", show_all)
    imgui.set_item_tooltip("Draw everything again that was hidden (Shift+H).")
    imgui.end_disabled()
    if deleted:
        if imgui.button(f"Remove {deleted:,} deleted for good", ImVec2(-1, 0)):
            session.edit("Remove what is deleted", compact)
        imgui.set_item_tooltip(
            "Make new arrays without them, and smaller files. Frames hardly get faster: deleted ones are not drawn.\n"
            "Undo still has the old ones."
        )


def _member(session: Editor, member: Layer | Actor) -> None:
    imgui.separator_text(member.name)
    if member.locked:
        imgui.text_disabled("It is locked.")
    imgui.begin_disabled(member.locked)
    if imgui.collapsing_header("Place", imgui.TreeNodeFlags_.default_open):
        place_fields(session, member)
    if isinstance(member, Actor) and imgui.collapsing_header("Drive", imgui.TreeNodeFlags_.default_open):
        actor_fields(session, member)
    if imgui.collapsing_header("Colour", imgui.TreeNodeFlags_.default_open):
        grading_fields(session, member)
    imgui.end_disabled()


# Floater cleanup


@dataclass(slots=True)
class _FloaterChoice:
    """Current floater rules; they are not part of the document."""

    rules: FloaterRules


_chosen = _FloaterChoice(FloaterRules())
_RANGES = {"opacity_below": (1.0, "%.3g"), "size_above_m": (20.0, "%.3g"), "isolation_above": (50.0, "%.3g x median")}
"""Upper bound and number format of each slider."""


def floater_fields(session: Editor) -> None:
    for name, (high, written) in _RANGES.items():
        info, value = field_info(name, FloaterRules), getattr(_chosen.rules, name)
        plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
        flags = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic
        changed, value = imgui.slider_float(f"##{name}", value, 0.0, high, written if value else "off", flags)
        if changed:
            _chosen.rules = msgspec.structs.replace(_chosen.rules, **{name: value})
    newest, count = session.newest_job("floaters"), session.floater_count
    job = None if newest is None else newest[1]
    if job is not None and job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), job.progress.message)
        if imgui.button("Cancel##floaters", (-1, 0)):
            job.cancel()
        imgui.set_item_tooltip("Stop searching; the selection stays as it was.")
        return
    if imgui.button(FLOATERS_TITLE, (-1, 0)):
        session.find_floaters(_chosen.rules)
    imgui.set_item_tooltip(
        "Select what any one of the rules calls a floater, in background layers that are not locked."
    )
    is_latest = session.history.undo_label == FLOATERS_TITLE
    if job is not None and count is not None and (is_latest or not count):
        imgui.text_wrapped(job.progress.message + ".")
        if count:
            if imgui.button(f"Delete {count:,} floaters", (-1, 0)):
                session.edit("Delete floaters", delete_selected)
            imgui.set_item_tooltip("Delete what was found; undo brings it back.")


# Position, rotation and scale


def place_fields(session: Editor, member: Layer | Actor) -> None:
    time_s = session.clock.time_s
    pose = layer_pose(session.scene, member.key, time_s)
    if pose is None:
        imgui.text_disabled(f"It is not there at {time_s:.2f} s.")
        return
    where = "at this moment; the whole drive moves along" if isinstance(member, Actor) else "from where its file has it"
    plain_label("Position (m)", f"x, y, z in the world, {where}.")
    moved, position = imgui.drag_float3("##position", list(pose.position_m), 0.02, -1e6, 1e6, "%.2f")
    if moved:
        _place(session, member, Pose((position[0], position[1], position[2]), pose.turn_deg, pose.scale))
    end_gesture_when_released(session)
    plain_label("Turn (degrees)", f"About the world's x, then y, then z, {where}.")
    turned, turn = imgui.drag_float3("##turn", list(pose.turn_deg), 0.25, -360, 360, "%.1f")
    if turned:
        _place(session, member, Pose(pose.position_m, (turn[0], turn[1], turn[2]), pose.scale))
    end_gesture_when_released(session)
    plain_label("Scale", "Factor of size, alike along all axes.")
    scaled, scale = imgui.drag_float("##scale", pose.scale, 0.005, 0.001, 1000, "%.3f", _CLAMP)
    if scaled:
        _place(session, member, Pose(pose.position_m, pose.turn_deg, scale))
    end_gesture_when_released(session)


def _place(session: Editor, member: Layer | Actor, pose: Pose) -> None:
    label = f"Place {member.name}"
    session.edit(label, set_layer_pose, member.key, pose, session.clock.time_s, gesture=f"place {member.key}")


_CLAMP = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic

# Actor motion


def actor_fields(session: Editor, actor: Actor) -> None:
    key, start, duration = actor.key, start_of(actor), duration_of(actor)
    plain_label("Starts at (s)", "Second of the scene's clock at which its drive begins.")
    changed, typed = imgui.drag_float("##start", start, 0.02, -3600, 3600, "%.2f")
    if changed:
        session.edit(f"Re-time {actor.name}", retime_actor, key, typed, max(duration, 0.01), gesture=f"start {key}")
    end_gesture_when_released(session)
    plain_label("Lasts (s)", "Seconds from its first place to its last: less is faster.")
    imgui.begin_disabled(duration == 0)
    changed, typed = imgui.drag_float("##duration", duration, 0.02, 0.05, 3600, "%.2f", _ACTOR_CLAMP)
    if changed:
        session.edit(f"Re-time {actor.name}", retime_actor, key, start, typed, gesture=f"duration {key}")
    end_gesture_when_released(session)
    imgui.end_disabled()
    wide = ImVec2((imgui.get_content_region_avail().x - imgui.get_style().item_spacing.x) / 2, 0)
    for words, degrees in (("Turn left", 15.0), ("Turn right", -15.0)):
        if imgui.button(words, wide):
            session.edit(f"Turn {actor.name}", turn_actor, key, degrees)
        imgui.set_item_tooltip("By 15 degrees in place, at every moment; it drives where it drove.")
        if degrees > 0:
            imgui.same_line()
    if imgui.button("Copy##actor", wide):
        session.edit(f"Copy {actor.name}", duplicate, key)
    imgui.set_item_tooltip("A second one with an id of its own, on the same drive: move or re-time it next.")
    imgui.same_line()
    if imgui.button("Remove##actor", wide):
        session.edit(f"Remove {actor.name}", remove, key)
    imgui.set_item_tooltip("Take it out of the scene; undo brings it back.")
    following = session.following
    changed, follows = imgui.checkbox("Follow with the camera", following.key == key)
    imgui.set_item_tooltip("The camera keeps its place beside it and turns with it; you can still look around.")
    if changed:
        following.follow(key if follows else "")
        session.view.follow_path = False


_ACTOR_CLAMP = imgui.SliderFlags_.always_clamp

# History panel


class _ScrollState:
    """Step that the list was last scrolled to."""

    cursor = -1


def history_panel(session: Editor) -> None:
    history = session.history
    chosen = None
    for number, step in enumerate(history.labels):
        is_undone = number > history.cursor
        if is_undone:
            imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        if imgui.selectable(label(step, str(number)), number == history.cursor)[0]:
            chosen = number
        if is_undone:
            imgui.pop_style_color()
        imgui.set_item_tooltip("Go to this step." if number != history.cursor else "The document as it is now.")
        if number == history.cursor != _ScrollState.cursor:
            imgui.set_scroll_here_y(0.8)
    _ScrollState.cursor = history.cursor
    if chosen is not None:
        session.go_to_step(chosen)

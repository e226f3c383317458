"""How an actor drives: when, how fast, which way it faces; and the camera that goes with it."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.scene.members import Actor
from gsrain_engine.session.edits.actors import duration_of, retime_actor, start_of, turn_actor
from gsrain_engine.session.edits.layers import duplicate, remove
from gsrain_engine.session.session import Session

from ..widgets.fields import end_gesture_when_released, plain_label


def actor_fields(session: Session, actor: Actor) -> None:
    """Edit times and heading; copy, remove, follow."""
    key, start, duration = actor.key, start_of(actor), duration_of(actor)
    plain_label("Starts at (s)", "Second of the scene's clock at which its drive begins.")
    changed, typed = imgui.drag_float("##start", start, 0.02, -3600, 3600, "%.2f")
    if changed:
        session.edit(f"Re-time {actor.name}", retime_actor, key, typed, max(duration, 0.01), gesture=f"start {key}")
    end_gesture_when_released(session)
    plain_label("Lasts (s)", "Seconds from its first place to its last: less is faster.")
    imgui.begin_disabled(duration == 0)
    changed, typed = imgui.drag_float("##duration", duration, 0.02, 0.05, 3600, "%.2f", _CLAMP)
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


_CLAMP = imgui.SliderFlags_.always_clamp

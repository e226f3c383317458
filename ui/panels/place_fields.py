"""Where a layer or an actor lies, as numbers."""

from imgui_bundle import imgui

from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.session.edits.pose import Pose, layer_pose, set_layer_pose
from gsrain_engine.session.session import Session

from ..widgets.fields import end_gesture_when_released, plain_label


def place_fields(session: Session, member: Layer | Actor) -> None:
    """Edit position, turn and scale."""
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


def _place(session: Session, member: Layer | Actor, pose: Pose) -> None:
    label = f"Place {member.name}"
    session.edit(label, set_layer_pose, member.key, pose, session.clock.time_s, gesture=f"place {member.key}")


_CLAMP = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic

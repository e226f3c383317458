"""Opacity and colour grading of a layer or an actor."""

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.scene.grading import UNCHANGED, Grading
from gsrain_engine.scene.members import Actor, Layer
from gsrain_engine.session.session import Session

from ..widgets.fields import end_gesture_when_released, field_info, plain_label

_RESET = icons_fontawesome_6.ICON_FA_ROTATE_LEFT


def grading_fields(session: Session, member: Layer | Actor) -> None:
    """One slider a field, each with a button that takes it back."""
    plain_label("Opacity", f"Multiplies that of every Gaussian of {member.name}; 1 leaves it.")
    changed, value = _slider("opacity", member.opacity, 0.0, 1.0, 1.0)
    if changed:
        session.set_scene(
            f"Opacity of {member.name}",
            session.scene.with_member(member.key, opacity=value),
            gesture=f"opacity {member.key}",
        )
    end_gesture_when_released(session)
    for name in Grading.__struct_fields__:
        info = field_info(name, Grading)
        plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)
        changed, value = _slider(name, getattr(member.grading, name), info.low, info.high, getattr(UNCHANGED, name))
        if changed:
            _grade(session, member, info.title, msgspec.structs.replace(member.grading, **{name: value}))
        end_gesture_when_released(session)
    imgui.begin_disabled(member.grading == UNCHANGED)
    if imgui.button("Reset colours", (-1, 0)):
        _grade(session, member, "Reset colours", UNCHANGED)
        session.end_gesture()
    imgui.end_disabled()
    imgui.set_item_tooltip("Take the grading back; opacity stays.")


def _grade(session: Session, member: Layer | Actor, what: str, grading: Grading) -> None:
    scene = session.scene.with_member(member.key, grading=grading)
    session.set_scene(f"{what} of {member.name}", scene, gesture=f"{what} {member.key}")


def _slider(name: str, value: float, low: float, high: float, rest: float) -> tuple[bool, float]:
    """Return whether it was changed, by the slider or by its reset button, and to what."""
    side = imgui.get_frame_height()
    imgui.set_next_item_width(-side - imgui.get_style().item_inner_spacing.x)
    changed, slid = imgui.slider_float(f"##{name}", value, low, high, "%.2f", imgui.SliderFlags_.always_clamp)
    imgui.same_line(0, imgui.get_style().item_inner_spacing.x)
    imgui.begin_disabled(value == rest)
    is_reset = imgui.button(f"{_RESET}##reset {name}", (side, side))
    imgui.end_disabled()
    imgui.set_item_tooltip(f"Back to {rest:g}.")
    return (changed or is_reset), rest if is_reset else slid

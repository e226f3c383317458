"""The numbers beside the timeline: those of the chosen key, else those of the whole path."""

from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, imgui

from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.paths.curves import Interpolation
from gsrain_engine.scene.paths.easing import Easing
from gsrain_engine.scene.paths.look import LookAngles, focal_length_mm, fov_of_focal_length
from gsrain_engine.session.camera_path import edits
from gsrain_engine.session.session import Session
from gsrain_engine.session.timeline.rows import ego_speed_km_h
from gsrain_engine.session.timeline.timeline import speed_of

from ...widgets.fields import end_gesture_when_released, plain_label
from .widgets import typed_number

_TOO_FAST = (0.95, 0.45, 0.38, 1.0)
_LABEL_EM = 6.5


def numbers(session: Session) -> None:
    key, path = edits.chosen_key(session), session.scene.path
    if path is not None and key is not None:
        _key(session, path, key)
    else:
        _path(session, path)


def _key(session: Session, path: CameraPath, key: int) -> None:
    _label(f"Key {key + 1} of {len(path.times_s)}", "Moment of the key in seconds, on a frame of the film.")
    imgui.set_next_item_width(0.5 * imgui.get_content_region_avail().x - 3)
    typed = typed_number("##key time", float(path.times_s[key]), "%.2f s")
    if typed is not None:
        edits.retime_key(session, key, typed)
    imgui.same_line(spacing=6)
    if imgui.button("Whole path", ImVec2(-1, 0)):
        session.timeline.key = None
    imgui.set_item_tooltip("Show speed, easing and the other numbers of the path as a whole.")
    words = "Place of the key in the world: x, y, z in metres, z is up. Ctrl+click types a number."
    _label("Place", words)
    place = session.path.positions[key]
    changed, moved = imgui.drag_float3("##key place", place.tolist(), 0.02, 0, 0, "%.2f")
    imgui.set_item_tooltip(words)
    if changed:
        edits.place_key(session, key, "Move camera key", position_m=np.array(moved, np.float64), gesture="key place")
    end_gesture_when_released(session)
    _look(session, key)
    _lens(session, path, key)


def _look(session: Session, key: int) -> None:
    words = "Heading from +x to +y, pitch upwards, and roll to the right; degrees."
    _label("Angles", words)
    changed, angles = imgui.drag_float3("##key look", list(edits.key_look(session, key)), 0.1, 0, 0, "%.1f\u00b0")
    imgui.set_item_tooltip(words)
    if changed:
        edits.place_key(session, key, "Turn camera key", look=LookAngles(*angles), gesture="key look")
    end_gesture_when_released(session)


def _lens(session: Session, path: CameraPath, key: int) -> None:
    fov = float(path.vertical_fov_deg[key])
    _label("Field of view", "Vertical, in degrees; and the focal length that sees as much on 35 mm film.")
    half = 0.5 * imgui.get_content_region_avail().x - 3
    imgui.set_next_item_width(half)
    flags = imgui.SliderFlags_.always_clamp
    changed, angle = imgui.drag_float("##key fov", fov, 0.1, 2, 150, "%.1f\u00b0", flags)
    imgui.set_item_tooltip("Vertical field of view in degrees.")
    if changed:
        edits.place_key(session, key, "Field of view of a key", vertical_fov_deg=angle, gesture="key fov")
    end_gesture_when_released(session)
    imgui.same_line(spacing=6)
    imgui.set_next_item_width(half)
    changed, focal = imgui.drag_float("##key focal", focal_length_mm(fov), 0.1, 4, 600, "%.1f mm", flags)
    imgui.set_item_tooltip("Focal length in mm of the lens that sees as much from top to bottom on 35 mm film.")
    if changed:
        angle = fov_of_focal_length(focal)
        edits.place_key(session, key, "Field of view of a key", vertical_fov_deg=angle, gesture="key focal")
    end_gesture_when_released(session)


def _path(session: Session, path: CameraPath | None) -> None:
    imgui.begin_disabled(path is None)
    shown = path or session.path
    _label("Way, easing", "What lies between the keys.")
    half = 0.5 * imgui.get_content_region_avail().x - 3
    imgui.set_next_item_width(half)
    _choice(session, "Way between keys", "interpolation", get_args(Interpolation), shown,
            "spline: smooth through all keys. linear: straight, at constant speed from key to key.")  # fmt: skip
    imgui.same_line(spacing=6)
    imgui.set_next_item_width(half)
    _choice(session, "Easing", "easing", get_args(Easing), shown,
            "none: even. in and out: sets off and arrives gently. at each key: rests at every key.")  # fmt: skip
    _label("Loop, takes", "Fly from the last key on to the first; and how many seconds the flight takes.")
    changed, loop = imgui.checkbox("##loop", shown.loop)
    imgui.set_item_tooltip("Fly from the last key on to the first, in as long as the other intervals take on average.")
    if changed:
        edits.change_path(session, "Loop on" if loop else "Loop off", loop=loop)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    typed = typed_number("##duration", shown.duration_s, "%.2f s")
    imgui.set_item_tooltip("Seconds that the flight takes: all keys move apart or together.")
    if typed is not None:
        edits.stretch_path(session, typed)
    imgui.end_disabled()
    _read_out(session)


def _choice(session: Session, title: str, field: str, choices: tuple[str, ...], path: CameraPath, words: str) -> None:
    changed, picked = imgui.combo(f"##{field}", choices.index(getattr(path, field)), list(choices))
    imgui.set_item_tooltip(words)
    if changed:
        edits.change_path(session, f"{title}: {choices[picked]}", **{field: choices[picked]})


def _read_out(session: Session) -> None:
    speed, t = speed_of(session.path), session.clock.time_s
    ego = ego_speed_km_h(session.shown_scene, t)
    now = 3.6 * float(np.linalg.norm(session.path.velocity(t)))
    imgui.text(f"{speed.length_m:.1f} m, {speed.mean_km_h:.0f} km/h, at most {speed.fastest_km_h:.0f} km/h")
    imgui.set_item_tooltip("Length of the flight, its mean and its highest speed.")
    imgui.text(f"now {now:.1f} km/h" + (f"   ego vehicle {ego:.1f} km/h" if ego is not None else ""))
    imgui.set_item_tooltip("Speed of the flying camera, and of the recording vehicle, at the present time.")
    if speed.warning is not None:
        imgui.push_style_color(imgui.Col_.text, _TOO_FAST)
        imgui.text_wrapped(speed.warning)
        imgui.pop_style_color()


def _label(text: str, help_text: str) -> None:
    plain_label(text, help_text)
    imgui.same_line(_LABEL_EM * imgui.get_font_size())

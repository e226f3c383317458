"""What a person does to the camera path: each is one step of undo. Keys are given by their numbers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.paths.camera_path import CameraPath, circle_path
from gsrain_engine.scene.paths.edits import (
    Keyed,
    copied_key,
    key_at,
    moved_key,
    placed_key,
    reversed_path,
    stretched,
    with_key,
    without_key,
)
from gsrain_engine.scene.paths.look import LookAngles, look_angles, look_rotation
from gsrain_engine.scene.rotations import matrices_from_quaternions, quaternions_from_matrices

from ..document.viewed_document import ViewedDocument
from ..timeline.timeline import KeyDrag
from .moments import on_frame

_VIEW_SIZE = (960, 640)
_USUAL_GAP_S = 2.0
"""From the last key to an appended one, where no other gap tells what is usual."""


def chosen_key(session: ViewedDocument) -> int | None:
    """Number of the chosen key of the person's path; None where none is."""
    path, key = session.scene.path, session.timeline.key
    return key if path is not None and key is not None and key < len(path.times_s) else None


def chosen_time(session: ViewedDocument) -> float:
    """Moment of the chosen key in seconds; the clock's where none is chosen."""
    path, key = session.scene.path, chosen_key(session)
    return session.clock.time_s if path is None or key is None else float(path.times_s[key])


def set_path(session: ViewedDocument, label: str, path: CameraPath | None, gesture: str | None = None) -> None:
    """Go to another path, in scene units and axes; changes of one gesture make one step."""
    session.set_scene(label, replace(session.scene, path=path), gesture)


def add_key(session: ViewedDocument, time_s: float | None = None) -> None:
    """Keep what the view shows as a key at the clock's moment, or another; a key that is there gives way."""
    time_s = on_frame(session, session.clock.time_s if time_s is None else time_s)
    path = session.scene.path
    is_new = path is None or key_at(path, time_s) is None
    keyed = with_key(path, time_s, _seen(session))
    set_path(session, "Add camera key" if is_new else "Update camera key", keyed.path)
    session.timeline.key = keyed.key


def append_key(session: ViewedDocument) -> None:
    """Keep what the view shows as a key after the last one, as far from it as keys are on average, and go there."""
    path = session.scene.path
    if path is None:
        add_key(session)
        return
    count = len(path.times_s)
    gap = (path.times_s[-1] - path.times_s[0]) / (count - 1) if count > 1 else _USUAL_GAP_S
    add_key(session, float(path.times_s[-1] + gap))
    session.clock.seek(chosen_time(session))


def update_key(session: ViewedDocument, key: int) -> None:
    path = session.scene.path
    if path is not None:
        set_path(session, "Update camera key", with_key(path, float(path.times_s[key]), _seen(session)).path)
        session.timeline.key = key


def delete_key(session: ViewedDocument, key: int) -> None:
    path = session.scene.path
    if path is not None:
        set_path(session, "Delete camera key", without_key(path, key))
        session.timeline.key = None


def delete_path(session: ViewedDocument) -> None:
    """Take all keys away: riding along takes the scene's own way again."""
    if session.scene.path is not None:
        set_path(session, "Delete camera path", None)
        session.timeline.key = None


def retime_key(session: ViewedDocument, key: int, time_s: float) -> None:
    """Move a key to another moment."""
    path = session.scene.path
    if path is not None:
        _take(session, "Move camera key", moved_key(path, key, on_frame(session, time_s)))


def copy_key(session: ViewedDocument, key: int, time_s: float) -> None:
    """Put a copy of a key at a moment."""
    path = session.scene.path
    if path is not None:
        _take(session, "Copy camera key", copied_key(path, key, on_frame(session, time_s)))


def place_key(
    session: ViewedDocument,
    key: int,
    label: str,
    *,
    position_m: Float64[np.ndarray, "3"] | None = None,
    look: LookAngles | None = None,
    vertical_fov_deg: float | None = None,
    gesture: str | None = None,
) -> None:
    """Give a key another place (world, metres), look or field of view; what is None stays."""
    path = session.scene.path
    if path is None:
        return
    to_scene = np.linalg.inv(session.scene.scene_to_world)
    position = None if position_m is None else to_scene[:3, :3] @ position_m + to_scene[:3, 3]
    quaternion = None
    if look is not None:
        turn = to_scene[:3, :3] / np.cbrt(np.linalg.det(to_scene[:3, :3]))
        quaternion = quaternions_from_matrices(turn @ look_rotation(look))
    set_path(session, label, placed_key(path, key, position, quaternion, vertical_fov_deg), gesture)


def key_look(session: ViewedDocument, key: int) -> LookAngles:
    """Heading, pitch and roll of a key in the world."""
    return look_angles(matrices_from_quaternions(session.path.quaternions_wxyz[key]))


# Dragging


def begin_drag(session: ViewedDocument, key: int, *, copies: bool = False, in_view: bool = False) -> None:
    """Take hold of a key, or of a copy of it."""
    if session.scene.path is not None:
        session.end_gesture()
        session.timeline.drag = KeyDrag(session.scene.path, key, copies, in_view)
        session.timeline.key = key


def drag_in_time(session: ViewedDocument, seconds: float) -> None:
    """Move the key in the hand so much later than it was when it was taken."""
    drag = session.timeline.drag
    if drag is None:
        return
    time_s = max(0.0, on_frame(session, float(drag.path.times_s[drag.key]) + seconds))
    if drag.copies:
        _take(session, "Copy camera key", copied_key(drag.path, drag.key, time_s), "drag a key")
    else:
        _take(session, "Move camera key", moved_key(drag.path, drag.key, time_s), "drag a key")


def end_drag(session: ViewedDocument) -> None:
    """Let go of the key."""
    session.timeline.drag = None
    session.end_gesture()


# The whole path


def change_path(session: ViewedDocument, label: str, **fields: object) -> None:
    """Set interpolation, easing or loop."""
    path = session.scene.path
    if path is not None:
        set_path(session, label, replace(path, **fields))


def circle_target(session: ViewedDocument, duration_s: float = 12.0) -> None:
    """Make the path a full circle, from the view on, around the point that the left button orbits."""
    session.stop_riding()
    circle = circle_path(session.navigation.target, session.shot(*_VIEW_SIZE).camera, duration_s)
    set_path(session, "Circle around the target", circle.moved(np.linalg.inv(session.scene.scene_to_world)))
    session.timeline.key = None


def reverse_path(session: ViewedDocument) -> None:
    """Fly the same way backwards."""
    path = session.scene.path
    if path is not None:
        set_path(session, "Reverse camera path", reversed_path(path))
        session.timeline.key = None


def stretch_path(session: ViewedDocument, duration_s: float) -> None:
    """Fly the same way in another time; what is wrong with it is kept in `problem`."""
    path = session.scene.path
    if path is None or path.duration_s <= 0:
        return
    try:
        set_path(session, "Stretch camera path", stretched(path, duration_s / path.duration_s))
    except ValueError as error:
        session.problem = str(error)


def _seen(session: ViewedDocument) -> Camera:
    camera = session.shot(*_VIEW_SIZE).camera
    return camera.moved(np.linalg.inv(session.scene.scene_to_world))


def _take(session: ViewedDocument, label: str, keyed: Keyed, gesture: str | None = None) -> None:
    set_path(session, label, keyed.path, gesture)
    session.timeline.key = keyed.key

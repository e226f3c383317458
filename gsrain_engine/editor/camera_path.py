"""Edits of the camera path, each one undo step; import, export, and timeline positions.

Keyframes are given by index.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..scene.camera import Camera
from ..scene.camera_path import CameraPath, circle_path
from ..scene.camera_path_edit import (
    WALKING_M_S,
    EditedKeyframe,
    ViewAngles,
    copy_keyframe_to,
    keyframe_at,
    move_keyframe,
    place_keyframe_at,
    resample,
    reverse_path_time,
    shift_path_time,
    simplify,
    snap_key_to,
    stretch_path_time,
    view_angles,
    view_rotation,
    with_constant_speed,
    with_keyframe,
    without_keyframe,
)
from ..scene.camera_path_io import read_camera_path, write_camera_path, write_nerfstudio_path, write_training_cameras
from ..scene.files import SceneFormatError
from ..scene.geometry import matrices_from_quaternions, quaternions_from_matrices
from ..scene.rig import rig_camera_path
from ..scene.scene import RigCamera
from .timeline import KeyframeDrag
from .viewport.camera import front_camera
from .viewport_state import ViewportState

_VIEW_SIZE = (960, 640)
_DEFAULT_GAP_S = 2.0  # gap between the last keyframe and an appended one, if the path has no gap to derive it from


def active_keyframe(session: ViewportState) -> int | None:
    """Index of the selected keyframe of the user's path, or None."""
    path, key = session.scene.path, session.timeline.key
    return key if path is not None and key is not None and key < len(path.times_s) else None


def active_keyframe_time(session: ViewportState) -> float:
    """Time of the selected keyframe in seconds; the clock's time if none is selected."""
    path, key = session.scene.path, active_keyframe(session)
    return session.clock.time_s if path is None or key is None else float(path.times_s[key])


def set_path(session: ViewportState, label: str, path: CameraPath | None, gesture: str | None = None) -> None:
    """Set the path, in scene units and axes; changes of one gesture make one undo step."""
    session.set_scene(label, replace(session.scene, path=path), gesture)


def add_keyframe(session: ViewportState, time_s: float | None = None) -> None:
    """Add the current view as a keyframe at a time (default: the clock's), replacing a keyframe at the same time."""
    time_s = nearest_frame_time(session, session.clock.time_s if time_s is None else time_s)
    path = session.scene.path
    is_new = path is None or keyframe_at(path, time_s) is None
    keyed = with_keyframe(path, time_s, _viewport_camera(session))
    set_path(session, "Insert keyframe" if is_new else "Update keyframe", keyed.path)
    session.timeline.key = keyed.key


def append_keyframe(session: ViewportState) -> None:
    """Add the current view as a keyframe after the last one, at the average keyframe distance, and seek there."""
    path = session.scene.path
    if path is None:
        add_keyframe(session)
        return
    count = len(path.times_s)
    gap = (path.times_s[-1] - path.times_s[0]) / (count - 1) if count > 1 else _DEFAULT_GAP_S
    add_keyframe(session, float(path.times_s[-1] + gap))
    session.clock.seek(active_keyframe_time(session))


def update_keyframe(session: ViewportState, key: int) -> None:
    path = session.scene.path
    if path is not None:
        set_path(
            session, "Update keyframe", with_keyframe(path, float(path.times_s[key]), _viewport_camera(session)).path
        )
        session.timeline.key = key


def delete_keyframe(session: ViewportState, key: int) -> None:
    path = session.scene.path
    if path is not None:
        set_path(session, "Delete keyframe", without_keyframe(path, key))
        session.timeline.key = None


def delete_path(session: ViewportState) -> None:
    """Delete all keyframes; following the path then uses the scene's own path again."""
    if session.scene.path is not None:
        set_path(session, "Delete camera path", None)
        session.timeline.key = None


def retime_keyframe(session: ViewportState, key: int, time_s: float) -> None:
    path = session.scene.path
    if path is not None:
        _take(session, "Move keyframe", move_keyframe(path, key, nearest_frame_time(session, time_s)))


def copy_keyframe(session: ViewportState, key: int, time_s: float) -> None:
    path = session.scene.path
    if path is not None:
        _take(session, "Copy keyframe", copy_keyframe_to(path, key, nearest_frame_time(session, time_s)))


def place_keyframe(
    session: ViewportState,
    key: int,
    label: str,
    *,
    position_m: Float64[np.ndarray, "3"] | None = None,
    look: ViewAngles | None = None,
    vertical_fov_deg: float | None = None,
    gesture: str | None = None,
) -> None:
    """Change a keyframe's position (world, meters), orientation or field of view; None leaves a value unchanged."""
    path = session.scene.path
    if path is None:
        return
    to_scene = np.linalg.inv(session.scene.scene_to_world)
    position = None if position_m is None else to_scene[:3, :3] @ position_m + to_scene[:3, 3]
    quaternion = None
    if look is not None:
        turn = to_scene[:3, :3] / np.cbrt(np.linalg.det(to_scene[:3, :3]))
        quaternion = quaternions_from_matrices(turn @ view_rotation(look))
    set_path(session, label, place_keyframe_at(path, key, position, quaternion, vertical_fov_deg), gesture)


def key_angles(session: ViewportState, key: int) -> ViewAngles:
    """Heading, pitch and roll of a keyframe in the world."""
    return view_angles(matrices_from_quaternions(session.path.quaternions_wxyz[key]))


# Dragging


def begin_drag(session: ViewportState, key: int, *, copies: bool = False, in_view: bool = False) -> None:
    """Start to drag a keyframe, or a copy of it."""
    if session.scene.path is not None:
        session.end_gesture()
        session.timeline.drag = KeyframeDrag(session.scene.path, key, copies, in_view)
        session.timeline.key = key


def drag_in_time(session: ViewportState, seconds: float) -> None:
    """Move the dragged keyframe by an offset in seconds from its time at the start of the drag."""
    drag = session.timeline.drag
    if drag is None:
        return
    time_s = max(0.0, nearest_frame_time(session, float(drag.path.times_s[drag.key]) + seconds))
    if drag.copies:
        _take(session, "Copy keyframe", copy_keyframe_to(drag.path, drag.key, time_s), "drag a key")
    else:
        _take(session, "Move keyframe", move_keyframe(drag.path, drag.key, time_s), "drag a key")


def end_drag(session: ViewportState) -> None:
    session.timeline.drag = None
    session.end_gesture()


# The whole path


def change_path(session: ViewportState, label: str, **fields: object) -> None:
    """Set interpolation, easing or loop."""
    path = session.scene.path
    if path is not None:
        set_path(session, label, replace(path, **fields))


def circle_target(session: ViewportState, duration_s: float = 12.0) -> None:
    """Replace the path by a full circle around the orbit target that starts at the current view."""
    session.stop_riding()
    circle = circle_path(session.navigation.target, session.shot(*_VIEW_SIZE).camera, duration_s)
    set_path(session, "Circle around the target", circle.moved(np.linalg.inv(session.scene.scene_to_world)))
    session.timeline.key = None


def reverse_path(session: ViewportState) -> None:
    path = session.scene.path
    if path is not None:
        set_path(session, "Reverse camera path", reverse_path_time(path))
        session.timeline.key = None


def stretch_path(session: ViewportState, duration_s: float) -> None:
    """Stretch the path to another duration; an error is set as `problem`."""
    path = session.scene.path
    if path is None or path.duration_s <= 0:
        return
    try:
        set_path(session, "Stretch camera path", stretch_path_time(path, duration_s / path.duration_s))
    except ValueError as error:
        session.problem = str(error)


def _viewport_camera(session: ViewportState) -> Camera:
    camera = session.shot(*_VIEW_SIZE).camera
    return camera.moved(np.linalg.inv(session.scene.scene_to_world))


def _take(session: ViewportState, label: str, keyed: EditedKeyframe, gesture: str | None = None) -> None:
    set_path(session, label, keyed.path, gesture)
    session.timeline.key = keyed.key


# Import, export, and paths from recorded drives

logger = logging.getLogger("gsrain")
_TOLERANCE_M = 0.05  # maximum deviation of a simplified path from its drive: less than the width of a lens


def import_path(session: ViewportState, file: Path) -> None:
    """Import a camera path; an error is set as `problem`, and the present path stays."""
    try:
        path = read_camera_path(file)
    except SceneFormatError as error:
        session.problem = str(error)
        logger.error("%s", error)
    else:
        path = path if path.start_s >= 0 else shift_path_time(path, -path.start_s)  # scene time starts at 0
        if not path.is_timed:
            path = with_constant_speed(path, WALKING_M_S / session.scene.metres_per_unit)
            logger.info("%s has no times: it is flown at walking pace, %g m/s", file.name, WALKING_M_S)
        set_path(session, f"Import {file.name}", path)
        session.timeline.key = None
        logger.info("Imported %s: %d keyframes, %.1f s", file.name, len(path.times_s), path.duration_s)


def export_path(session: ViewportState, file: Path) -> None:
    """Write the current path as GSRAIN JSON: keyframes and interpolation."""
    _export(session, file, write_camera_path)


def export_nerfstudio(session: ViewportState, file: Path) -> None:
    """Write every frame of the path as nerfstudio's camera_path.json."""
    _export(session, file, lambda target, path: write_nerfstudio_path(target, path, session.timeline.fps))


def export_training_cameras(session: ViewportState, file: Path) -> None:
    """Write every frame of the path as 3DGS training cameras."""
    _export(session, file, lambda target, path: write_training_cameras(target, path, session.timeline.fps))


def rig_cameras(session: ViewportState) -> list[RigCamera]:
    """Cameras of all rigs if the scene has an ego track, else none."""
    scene = session.scene
    if scene.ego is None or not len(scene.ego.times):
        return []
    return [camera for rig in scene.rigs.values() for camera in rig]


def path_from_drive(session: ViewportState, camera: RigCamera | None = None, every_s: float = 0.0) -> None:
    """Set the path of a rig camera during the drive as the user's path, with a keyframe every `every_s` seconds.

    The default is the front camera. With 0 s, uses the fewest keyframes that stay within 5 cm and half a degree.
    """
    drive = _drive(session, camera)
    if drive is None:
        session.problem = "This scene has no ego vehicle with a camera, so there is no drive to take a path from."
        return
    few = simplify(drive, _TOLERANCE_M) if every_s <= 0 else resample(drive, every_s)
    set_path(session, "Camera path from the drive", few.moved(np.linalg.inv(session.scene.scene_to_world)))
    session.timeline.key = None
    logger.info("Path from the drive: %d keyframes of %d samples", len(few.times_s), len(drive.times_s))


def snap_keyframe(session: ViewportState, key: int) -> None:
    """Move a keyframe to the nearest pose of the drive's front camera."""
    path, drive = session.scene.path, _drive(session, None)
    if drive is None:
        session.problem = "This scene has no ego vehicle with a camera, so there is no drive to snap to."
    elif path is not None:
        to_scene = np.linalg.inv(session.scene.scene_to_world)
        set_path(session, "Snap keyframe to the drive", snap_key_to(path, key, drive.moved(to_scene)))


def _drive(session: ViewportState, camera: RigCamera | None) -> CameraPath | None:
    camera = camera or front_camera(session.scene)
    return None if camera is None else rig_camera_path(session.scene, camera, *_VIEW_SIZE)


def _export(session: ViewportState, file: Path, write: Callable[[Path, CameraPath], None]) -> None:
    """Write the path in scene units and axes; an error is set as `problem`."""
    file = file if file.suffix else file.with_suffix(".json")
    path = session.scene.path or session.path.moved(np.linalg.inv(session.scene.scene_to_world))
    try:
        write(file, path)
    except OSError as error:
        session.problem = f"{file}: the camera path can't be written: {error.strerror or error}"
        logger.error("%s", session.problem)
    else:
        logger.info("Exported %s", file)


# Timeline positions


def set_span(session: ViewportState, is_start: bool, time_s: float) -> None:
    """Set the start or end of playback; they stay at least a frame apart."""
    start, end = session.span_s
    moment, frame = max(0.0, nearest_frame_time(session, time_s)), 1 / session.timeline.fps
    session.clock.span_s = (min(moment, end - frame), end) if is_start else (start, max(moment, start + frame))


def nearest_frame_time(session: ViewportState, time_s: float) -> float:
    return round(time_s * session.timeline.fps) / session.timeline.fps


def go_to_keyframe(session: ViewportState, key: int) -> None:
    """Select a keyframe and look through it: pause at its time and follow the path."""
    path = session.scene.path
    if path is not None:
        session.timeline.key = key
        session.clock.playing = False
        session.clock.seek(float(path.times_s[key]))
        session.view.follow_path = True


def go_to_next_keyframe(session: ViewportState, steps: int) -> None:
    """Go to the keyframe before (-1) or after (1) the clock's time; do nothing at the ends."""
    path, now = session.scene.path, session.clock.time_s
    if path is None:
        return
    beyond = path.times_s > now + 1e-6 if steps > 0 else path.times_s < now - 1e-6
    keys = np.flatnonzero(beyond)
    if len(keys):
        go_to_keyframe(session, int(keys[0] if steps > 0 else keys[-1]))

"""Edits of the camera path, each one undo step; import, export, and timeline positions.

Keyframes are given by index.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from ..render.view import RenderView
from ..safe_io.errors import SceneFormatError
from ..scene import camera_path_edit as edits
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath, circle_path
from ..scene.camera_path_io import read_camera_path, write_camera_path, write_nerfstudio_path, write_training_cameras
from ..scene.easing import KeyEasing
from ..scene.geometry import matrices_from_quaternions, quaternions_from_matrices
from ..scene.rig import rig_camera_path
from ..scene.scene import RigCamera
from .document import Document
from .edits.members import change_path, set_path, with_path
from .status import StatusBus
from .timeline import KeyframeDrag, Playback
from .viewport.camera import front_camera
from .viewport.picking import NEAR_M
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")
PathFormat = Literal["keyframes", "nerfstudio", "training cameras"]
_VIEW_SIZE = (960, 640)
_DRAG = "drag a key"  # gesture
_TOLERANCE_M = 0.05  # maximum deviation of a simplified path from its drive: less than the width of a lens
_DEFAULT_GAP_S = 2.0  # gap between the last keyframe and an appended one, if the path has no gap to derive it from


class CameraPathEditor:
    """The user's camera path: its edits, the selected keyframe, and drags of keyframes."""

    def __init__(self, document: Document, viewport: ViewportState, playback: Playback, status: StatusBus) -> None:
        self._document, self._viewport, self._playback, self._status = document, viewport, playback, status
        self.copied: Camera | None = None
        """Camera to paste as a keyframe, in scene units and axes."""

    @property
    def active_key(self) -> int | None:
        """Index of the selected keyframe of the user's path, or None."""
        path, key = self._document.scene.path, self._playback.timeline.key
        return key if path is not None and key is not None and key < len(path.times_s) else None

    @property
    def active_time_s(self) -> float:
        """Time of the selected keyframe in seconds; the clock's time if none is selected."""
        path, key = self._document.scene.path, self.active_key
        return self._playback.clock.time_s if path is None or key is None else float(path.times_s[key])

    # Keyframes

    def add_keyframe(self, time_s: float | None = None) -> None:
        """Add the current view as a keyframe at a time (default: the clock's), replacing one at the same time."""
        time_s = self._playback.nearest_frame_time(self._playback.clock.time_s if time_s is None else time_s)
        path = self._document.scene.path
        is_new = path is None or edits.keyframe_at(path, time_s) is None
        label = "Insert camera keyframe" if is_new else "Update camera keyframe"
        self._edit_keyframe(label, edits.with_keyframe, time_s, self._camera_in_scene)

    def append_keyframe(self) -> None:
        """Add the current view as a keyframe after the last one, at the average keyframe distance, and seek there."""
        path = self._document.scene.path
        if path is None:
            self.add_keyframe()
            return
        count = len(path.times_s)
        gap = (path.times_s[-1] - path.times_s[0]) / (count - 1) if count > 1 else _DEFAULT_GAP_S
        self.add_keyframe(float(path.times_s[-1] + gap))
        self._playback.clock.seek(self.active_time_s)

    def update_keyframe(self, key: int) -> None:
        """Set a keyframe to the current view."""
        if (path := self._document.scene.path) is not None:
            time_s, camera = float(path.times_s[key]), self._camera_in_scene
            self._edit_keyframe("Update camera keyframe", edits.with_keyframe, time_s, camera)

    def delete_keyframe(self, key: int) -> None:
        self._edit_path("Delete camera keyframe", edits.without_keyframe, key)

    def retime_keyframe(self, key: int, time_s: float) -> None:
        time_s = self._playback.nearest_frame_time(time_s)
        self._edit_keyframe("Move keyframe", edits.move_keyframe, key, time_s)

    def copy_keyframe(self, key: int, time_s: float) -> None:
        time_s = self._playback.nearest_frame_time(time_s)
        self._edit_keyframe("Copy keyframe", edits.copy_keyframe_to, key, time_s)

    def place_keyframe(
        self,
        key: int,
        label: str,
        *,
        position_m: Float64[np.ndarray, "3"] | None = None,
        look: edits.ViewAngles | None = None,
        vertical_fov_deg: float | None = None,
        gesture: str | None = None,
    ) -> None:
        """Change a keyframe's position (world, meters), orientation or field of view; None leaves a value unchanged."""
        to_scene = self._world_to_scene
        position = None if position_m is None else to_scene[:3, :3] @ position_m + to_scene[:3, 3]
        quaternion = None
        if look is not None:
            turn = to_scene[:3, :3] / np.cbrt(np.linalg.det(to_scene[:3, :3]))
            quaternion = quaternions_from_matrices(turn @ edits.view_rotation(look))
        values = (key, position, quaternion, vertical_fov_deg)
        self._document.edit(label, with_path, edits.place_keyframe_at, *values, gesture=gesture)

    def key_angles(self, key: int) -> edits.ViewAngles:
        """Heading, pitch and roll of a keyframe in the world."""
        return edits.view_angles(matrices_from_quaternions(self._viewport.path.quaternions_wxyz[key]))

    def snap_keyframe(self, key: int) -> None:
        """Move a keyframe to the nearest pose of the drive's front camera."""
        drive = self._drive(None)
        if drive is None:
            self._status.report("This scene has no ego vehicle with a camera, so there is no drive to snap to.")
        else:
            drive = drive.moved(self._world_to_scene)
            self._document.edit("Snap keyframe to recorded drive", with_path, edits.snap_key_to, key, drive)

    def easing_of(self, key: int) -> KeyEasing | None:
        """Easing after a keyframe of the user's path; None follows the path's."""
        path = self._document.scene.path
        return path.key_easings[key] if path is not None and path.key_easings else None

    def ease(self, key: int, easing: KeyEasing | None) -> None:
        """Set the easing from a keyframe to the next one."""
        if self._document.scene.path is not None:
            label = f"Ease keyframe: {easing or 'as the path'}"
            self._document.edit(label, with_path, edits.set_key_easing, key, easing)

    def copy(self, key: int) -> None:
        """Copy the camera of a keyframe, in scene units and axes."""
        if (path := self._document.scene.path) is not None:
            self.copied = edits.keyframe_camera(path, key, *_VIEW_SIZE)

    def paste(self) -> None:
        """Insert the copied camera as a keyframe at the playhead, and select it."""
        if self.copied is not None:
            time_s = self._playback.nearest_frame_time(self._playback.clock.time_s)
            self._edit_keyframe("Paste keyframe", edits.with_keyframe, time_s, self.copied)

    # Dragging

    def begin_drag(self, key: int, *, copies: bool = False, in_view: bool = False) -> None:
        """Start to drag a keyframe, or a copy of it."""
        if (path := self._document.scene.path) is not None:
            self._document.end_gesture()
            self._playback.timeline.drag = KeyframeDrag(path, key, copies, in_view)
            self._playback.timeline.key = key

    def drag_in_time(self, seconds: float) -> None:
        """Move the dragged keyframe by an offset in seconds from its time at the start of the drag."""
        if (drag := self._playback.timeline.drag) is not None:
            time_s = max(0.0, self._playback.nearest_frame_time(float(drag.path.times_s[drag.key]) + seconds))
            label, change = ("Copy", edits.copy_keyframe_to) if drag.copies else ("Move", edits.move_keyframe)
            self._document.edit(f"{label} keyframe", with_path, change, drag.key, time_s, gesture=_DRAG)
            self._playback.timeline.key = change(drag.path, drag.key, time_s).key

    def drag_in_view(self, shot: RenderView, moved_px: tuple[float, float], *, upright: bool) -> None:
        """Move the dragged keyframe in the plane that faces the view, or if `upright` only vertically."""
        drag = self._playback.timeline.drag
        if drag is None:
            return
        camera, to_world = shot.camera, self._document.scene.scene_to_world
        start = to_world[:3, :3] @ drag.path.positions[drag.key] + to_world[:3, 3]
        depth = float(camera.world_to_camera[2, :3] @ start + camera.world_to_camera[2, 3])
        metres_a_pixel = max(depth, NEAR_M) / camera.fy
        right, down = camera.world_to_camera[0, :3], camera.world_to_camera[1, :3]
        if upright:
            steepness = max(-float(down[2]), 0.2)  # from straight above, the height has no length in the image
            change = np.array([0.0, 0.0, -moved_px[1] * metres_a_pixel / steepness])
        else:
            change = metres_a_pixel * (moved_px[0] * right + moved_px[1] * down)
        self.place_keyframe(drag.key, "Move keyframe", position_m=start + change, gesture=_DRAG)

    def end_drag(self) -> None:
        self._playback.timeline.drag = None
        self._document.end_gesture()

    # The whole path

    def change_path(self, label: str, **fields: Any) -> None:
        """Set interpolation, easing or loop."""
        if self._document.scene.path is not None:
            self._document.edit(label, with_path, change_path, **fields)

    def circle_target(self, duration_s: float = 12.0) -> None:
        """Replace the path by a full circle around the orbit target that starts at the current view."""
        self._viewport.stop_riding()
        circle = circle_path(self._viewport.navigation.target, self._viewport.shot(*_VIEW_SIZE).camera, duration_s)
        self._set_path("Circle around target", circle.moved(self._world_to_scene))

    def reverse_path(self) -> None:
        self._edit_path("Reverse camera path", edits.reverse_path_time)

    def stretch_path(self, duration_s: float) -> None:
        """Stretch the path to another duration."""
        path = self._document.scene.path
        if path is not None and path.duration_s > 0:
            factor = duration_s / path.duration_s
            self._document.edit("Stretch camera path", with_path, edits.stretch_path_time, factor)

    def delete_path(self) -> None:
        """Delete all keyframes; following the path then uses the scene's own path again."""
        if self._document.scene.path is not None:
            self._set_path("Delete camera path", None)

    # Import, export, and paths from recorded drives

    def import_path(self, file: Path) -> None:
        """Import a camera path; an error is reported, and the present path stays."""
        try:
            path = read_camera_path(file, self._document.scene)
        except SceneFormatError as error:
            self._status.report(error)
            return
        path = path if path.start_s >= 0 else edits.shift_path_time(path, -path.start_s)  # scene time starts at 0
        if not path.is_timed:
            path = edits.with_constant_speed(path, edits.WALKING_M_S / self._document.scene.metres_per_unit)
            logger.info("%s has no times: it is flown at walking pace, %g m/s", file.name, edits.WALKING_M_S)
        self._set_path(f"Import {file.name}", path)
        logger.info("Imported %s: %d keyframes, %.1f s", file.name, len(path.times_s), path.duration_s)

    def export_path(self, file: Path, form: PathFormat = "keyframes") -> None:
        """Write the current path, in scene units and axes; an error is reported.

        `keyframes` is GSRAIN's JSON, with the interpolation; the other formats have every frame: nerfstudio's
        camera_path.json, and 3DGS training cameras.
        """
        file = file if file.suffix else file.with_suffix(".json")
        path = self._document.scene.path or self._viewport.path.moved(self._world_to_scene)
        try:
            if form == "keyframes":
                write_camera_path(file, path)
            else:
                write = write_nerfstudio_path if form == "nerfstudio" else write_training_cameras
                origin = np.array(self._document.scene.origin)  # other programs know the coordinates of the file
                write(file, replace(path, positions=path.positions + origin), self._playback.timeline.fps)
        except OSError as error:
            self._status.report(f"{file}: the camera path can't be written: {error.strerror or error}")
        else:
            logger.info("Exported %s", file)

    @property
    def rig_cameras(self) -> list[RigCamera]:
        """Cameras of all rigs if the scene has an ego track, else none."""
        scene = self._document.scene
        return [] if front_camera(scene) is None else [each for rig in scene.rigs.values() for each in rig]

    def path_from_drive(self, camera: RigCamera | None = None, every_s: float = 0.0) -> None:
        """Set the path of a rig camera during the drive as the user's path, with a keyframe every `every_s` seconds.

        The default is the front camera. With 0 s, uses the fewest keyframes that stay within 5 cm and half a degree.
        """
        drive = self._drive(camera)
        if drive is None:
            self._status.report(
                "This scene has no ego vehicle with a camera, so there is no drive to take a path from."
            )
            return
        few = edits.simplify(drive, _TOLERANCE_M) if every_s <= 0 else edits.resample(drive, every_s)
        self._set_path("Camera path from recorded drive", few.moved(self._world_to_scene))
        logger.info("Path from the drive: %d keyframes of %d samples", len(few.times_s), len(drive.times_s))

    # Timeline positions

    def go_to_keyframe(self, key: int) -> None:
        """Select a keyframe and look through it: pause at its time and follow the path."""
        if (path := self._document.scene.path) is not None:
            self._playback.timeline.key, self._playback.clock.playing = key, False
            self._playback.clock.seek(float(path.times_s[key]))
            self._viewport.options.follow_path = True

    def go_to_next_keyframe(self, steps: int) -> None:
        """Go to the keyframe before (-1) or after (1) the clock's time; do nothing at the ends."""
        path, now = self._document.scene.path, self._playback.clock.time_s
        if path is None:
            return
        beyond = path.times_s > now + 1e-6 if steps > 0 else path.times_s < now - 1e-6
        keys = np.flatnonzero(beyond)
        if len(keys):
            self.go_to_keyframe(int(keys[0] if steps > 0 else keys[-1]))

    # Shared by the above

    @property
    def _camera_in_scene(self) -> Camera:
        """Camera of the viewport, in scene units and axes."""
        return self._viewport.shot(*_VIEW_SIZE).camera.moved(self._world_to_scene)

    @property
    def _world_to_scene(self) -> Float64[np.ndarray, "4 4"]:
        return np.linalg.inv(self._document.scene.scene_to_world)

    def _drive(self, camera: RigCamera | None) -> CameraPath | None:
        scene = self._document.scene
        camera = camera or front_camera(scene)
        return None if camera is None else rig_camera_path(scene, camera, *_VIEW_SIZE)

    def _edit_keyframe(self, label: str, change: Callable[..., edits.EditedKeyframe], *arguments: Any) -> None:
        """Edit a keyframe of the path, and select it."""
        key = change(self._document.scene.path, *arguments).key
        self._document.edit(label, with_path, change, *arguments)
        self._playback.timeline.key = key

    def _edit_path(self, label: str, change: Callable[..., CameraPath | None], *arguments: Any) -> None:
        """Edit the path if there is one, and select no keyframe."""
        if self._document.scene.path is not None:
            self._document.edit(label, with_path, change, *arguments)
            self._playback.timeline.key = None

    def _set_path(self, label: str, path: CameraPath | None) -> None:
        """Set another path, in scene units and axes, and select no keyframe."""
        self._document.edit(label, set_path, path)
        self._playback.timeline.key = None

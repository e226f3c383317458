"""Commands of the view, the timeline, captures and drives."""

from collections.abc import Callable
from typing import get_args

from imgui_bundle import imgui

from gsrain_engine.editor import camera_path
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import drive_along_own_path
from gsrain_engine.editor.viewport.camera_follow import ChaseMode
from gsrain_engine.editor.viewport.options import Split
from gsrain_engine.render.renderer import RenderMode

from ..panels.capture import ask_for_capture_file, ask_for_capture_folder
from ..panels.drive import (
    VIDEO_HELP,
    ask_for_rollout,
    ask_for_scenario,
    ask_where_to_save_rollout,
    ask_where_to_save_scenario,
    ask_where_to_video,
)
from ..panels.timeline import ask_for_export, ask_for_import
from .base import Command, chord

_KEY = imgui.Key


def _set(field: str, value: object) -> Callable[[Editor], None]:
    return lambda session: setattr(session.view, field, value)


def _is(field: str, value: object) -> Callable[[Editor], bool]:
    return lambda session: getattr(session.view, field) == value


def _toggle(field: str) -> Callable[[Editor], None]:
    return lambda session: setattr(session.view, field, not getattr(session.view, field))


VIEW_ACTIONS = (
    Command(
        "Frame the scene",
        lambda session: session.frame_scene(),
        "View",
        chord(_KEY.f),
        "Back off until what is chosen under Layers, or else the whole scene, can be seen.",
    ),
    Command(
        "Go home",
        lambda session: session.go_home(),
        "View",
        (chord(_KEY.r), chord(_KEY.home)),
        "Back to where the scene was first looked at from.",
    ),
    Command(
        "Show the selection",
        _toggle("show_selection"),
        "View",
        chord(_KEY.mod_shift, _KEY.s),
        "Tint what is selected.",
        is_on=_is("show_selection", True),
    ),
    Command(
        "Take a screenshot",
        lambda session: session.take_screenshot(),
        "View",
        chord(_KEY.f12),
        "Save the picture as PNG in the pictures folder; the log says where.",
    ),
    *(
        Command(
            f"Look: {look}",
            _set("look", look),
            help="Show the picture, or what it is made of.",
            is_on=_is("look", look),
        )
        for look in get_args(RenderMode)
    ),
    *(
        Command(
            f"Compare: {split}",
            _set("split", split),
            help="Two pictures side by side; drag the line between them.",
            is_on=_is("split", split),
        )
        for split in get_args(Split)
    ),
    Command(
        "Play or pause", lambda session: session.clock.toggle(), "View", chord(_KEY.space), "Let time go on or stop it."
    ),
    Command("Navigate", _set("tool", ""), "", chord(_KEY.escape), "Put the tool away: the left button orbits again."),
)

# Time and the camera path


def _has_path(session: Editor) -> bool:
    return session.scene.path is not None


def _has_chosen_key(session: Editor) -> bool:
    return camera_path.active_keyframe(session) is not None


def _with_chosen(change: Callable[[Editor, int], None]) -> Callable[[Editor], None]:
    def run(session: Editor) -> None:
        key = camera_path.active_keyframe(session)
        if key is not None:
            change(session, key)

    return run


def _step(frames: int) -> Callable[[Editor], None]:
    return lambda session: session.clock.step(frames, session.timeline.fps)


def _ask_for_time(session: Editor) -> None:
    session.timeline.asks_for_time = True


def _repeat(session: Editor) -> None:
    session.clock.loop = not session.clock.loop


def _loop(session: Editor) -> None:
    path = session.scene.path
    if path is not None:
        camera_path.change_path(session, "Loop off" if path.loop else "Loop on", loop=not path.loop)


def _show_path(session: Editor) -> None:
    session.timeline.show_path = not session.timeline.show_path


TIME_ACTIONS = (
    Command("Go to the start of time", lambda session: session.clock.seek(session.span_s[0]), "Timeline",
           chord(_KEY.mod_ctrl, _KEY.left_arrow), "To where playing starts."),
    Command("Go to the end of time", lambda session: session.clock.seek(session.span_s[1]), "Timeline",
           chord(_KEY.mod_ctrl, _KEY.right_arrow), "To where playing ends."),
    Command("Go to time...", _ask_for_time, "Timeline", chord(_KEY.mod_ctrl, _KEY.g),
           "Type a moment in seconds."),
    Command("Step one frame back", _step(-1), "Timeline", chord(_KEY.left_arrow),
           "Stop, and go one frame of the film back."),
    Command("Step one frame on", _step(1), "Timeline", chord(_KEY.right_arrow),
           "Stop, and go one frame of the film on."),
    Command("Repeat", _repeat, "Timeline", (), "Begin again at the end of time; else stop there.",
           is_on=lambda session: session.clock.loop),
)  # fmt: skip

CAMERA_KEY_ACTIONS = (
    Command("Add camera key", camera_path.add_keyframe, "Timeline", chord(_KEY.k),
           "Keep what the view shows as a camera key at the present time."),
    Command("Append camera key", camera_path.append_keyframe, "Timeline", chord(_KEY.mod_shift, _KEY.k),
           "Keep what the view shows as a key after the last one, and go to its time."),
    Command("Update camera key", _with_chosen(camera_path.update_keyframe), "Timeline", (),
           "Give the chosen key what the view shows.", _has_chosen_key),
    Command("Delete camera key", _with_chosen(camera_path.delete_keyframe), "Timeline",
            chord(_KEY.mod_shift, _KEY.delete),
           "Take the chosen key away; Delete does so while the timeline has the focus.", _has_chosen_key),
    Command("Snap camera key to the drive", _with_chosen(camera_path.snap_keyframe), "Timeline", (),
           "Lay the chosen key onto the nearest place of the recorded drive.", _has_chosen_key),
    Command("Go to the previous camera key", lambda session: camera_path.go_to_next_keyframe(session, -1), "Timeline",
           (chord(_KEY.comma), chord(_KEY.mod_alt, _KEY.left_arrow)), "And look through it.", _has_path),
    Command("Go to the next camera key", lambda session: camera_path.go_to_next_keyframe(session, 1), "Timeline",
           (chord(_KEY.period), chord(_KEY.mod_alt, _KEY.right_arrow)), "And look through it.", _has_path),
)  # fmt: skip

PATH_ACTIONS = (
    Command("Ride along", lambda session: session.ride(not session.view.follow_path), "Timeline", chord(_KEY.v),
           "Look through the camera that flies along the path.", is_on=lambda session: session.view.follow_path),
    Command("Show the camera path", _show_path, "Timeline", (), "Draw its way and its keys into the picture.",
           is_on=lambda session: session.timeline.show_path),
    Command("Loop the camera path", _loop, "Timeline", (), "Fly from the last key on to the first.", _has_path,
           lambda session: session.scene.path is not None and session.scene.path.loop),
    Command("Camera path from the drive", camera_path.path_from_drive, "Timeline", (),
           "Fly as the recording vehicle drove, with as few keys as stay within 5 cm.",
           lambda session: bool(camera_path.rig_cameras(session))),
    Command("Circle around the target", camera_path.circle_target, "Timeline", (),
           "A loop of 12 s from this view on, around the point that a left drag orbits."),
    Command("Reverse the camera path", camera_path.reverse_path, "Timeline", (),
           "Fly the same way backwards.", _has_path),
    Command("Import camera path...", ask_for_import, "Timeline", (),
           "Ours, nerfstudio's camera_path.json or 3DGS's cameras.json."),
    Command("Export camera path...", ask_for_export, "Timeline", (),
           "Keys and what lies between them; for other programs see Path in the Timeline panel."),
    Command("Delete camera path", camera_path.delete_path, "Timeline", (),
           "Take all keys away: riding along takes the scene's own way again.", _has_path),
)  # fmt: skip

# Captures


def _has_capture(session: Editor) -> bool:
    return session.captures.capture is not None


def _toggle_capture(field: str) -> Callable[[Editor], None]:
    return lambda session: setattr(session.captures, field, not getattr(session.captures, field))


def _capture_is(field: str) -> Callable[[Editor], bool]:
    return lambda session: getattr(session.captures, field)


CAPTURE_FILE_ACTIONS = (
    Command(
        "Open a capture...",
        ask_for_capture_folder,
        "File",
        help="Show recorded pictures, cameras and points beside the scene: a folder of COLMAP, nerfstudio, nuScenes, "
        "DGP, KITTI, Waymo, RainSense, the street, or of pictures alone.",
    ),
    Command(
        "Open a capture file...",
        ask_for_capture_file,
        "File",
        help="The same for a capture that is one file: transforms.json, a .tfrecord of Waymo, a .pkl of MMDetection3D.",
    ),
    Command(
        "Close the capture",
        lambda session: session.captures.close_capture(),
        "File",
        help="Show the scene alone.",
        is_possible=_has_capture,
    ),
)

CAPTURE_ACTIONS = (
    Command(
        "Look from the chosen view",
        lambda session: session.captures.look_from(session, session.captures.chosen),
        "View",
        chord(_KEY.mod_shift, _KEY.v),
        "Go to where a picture of the capture was taken, with its field of view, and lay it over the render.",
        _has_capture,
    ),
    Command(
        "Look from the next view",
        lambda session: session.captures.step(session, 1),
        "View",
        chord(_KEY.page_down),
        "Go on to the next picture of the capture, of the chosen camera.",
        _has_capture,
    ),
    Command(
        "Look from the previous view",
        lambda session: session.captures.step(session, -1),
        "View",
        chord(_KEY.page_up),
        "Go back to the picture of the capture before.",
        _has_capture,
    ),
    Command(
        "Show the recorded picture",
        _toggle_capture("show_picture"),
        "View",
        chord(_KEY.mod_shift, _KEY.p),
        "Lay the recorded picture over the render while the eye is where it was taken.",
        _has_capture,
        _capture_is("show_picture"),
    ),
    Command(
        "Show recorded cameras",
        _toggle_capture("show_frustums"),
        help="Show where the pictures of the capture were taken.",
        is_possible=_has_capture,
        is_on=_capture_is("show_frustums"),
    ),
    Command(
        "Show measured points",
        _toggle_capture("show_points"),
        help="Show the capture's points (COLMAP, lidar) over the picture.",
        is_possible=_has_capture,
        is_on=_capture_is("show_points"),
    ),
    Command(
        "Show matches with another view",
        lambda session: setattr(session.matching, "is_on", not session.matching.is_on),
        "View",
        chord(_KEY.mod_shift, _KEY.m),
        "Find each pixel of what is looked at in another view of the capture, by its depth.",
        _has_capture,
        lambda session: session.matching.is_on,
    ),
)

# Drives and roll-outs


def _plays(session: Editor) -> bool:
    return session.drives.playing is not None


def _jump_to_collision(session: Editor) -> None:
    playing = session.drives.playing
    if playing is not None and playing.collision_s is not None:
        session.drives.jump(session, playing.collision_s)


def _jump_to_smallest_ttc(session: Editor) -> None:
    playing = session.drives.playing
    if playing is not None:
        session.drives.jump(session, playing.curves.min_ttc_time_s)


def _hits(session: Editor) -> bool:
    return session.drives.playing is not None and session.drives.playing.collision_s is not None


def _follow(mode: ChaseMode) -> Callable[[Editor], None]:
    return lambda session: session.drives.follow(session, mode)


def _follows(mode: ChaseMode) -> Callable[[Editor], bool]:
    return lambda session: session.drives.playing is not None and session.drives.chase.mode == mode


DRIVE_ACTIONS = (
    Command("Drive", lambda session: session.drives.start(session), "Drive", (),
           "Drive the scenario of the Drive panel through this scene, in the background.",
           lambda session: session.drives.why_not(session) is None),
    Command("Ego drives along the path", lambda session: session.edit("Ego drive", drive_along_own_path), "Drive", (),
           "For scenes without a recorded drive: the ego vehicle goes where the camera path goes, with a front camera.",
           lambda session: session.scene.path is not None),
    Command("Open a scenario...", ask_for_scenario, "Drive", (), "Our YAML, HUGSIM's YAML, or OpenSCENARIO."),
    Command("Save the scenario...", lambda session: ask_where_to_save_scenario(session.drives.settings), "Drive", (),
           "As YAML, with the changes of the Drive panel."),
)  # fmt: skip

ROLLOUT_ACTIONS = (
    Command("Open a roll-out...", ask_for_rollout, "Drive", (), "A finished drive (JSON lines); it plays in the view."),
    Command("Save the roll-out...", ask_where_to_save_rollout, "Drive", (), "Write the one that plays as JSON lines.",
           _plays),
    Command("Film the drive...", ask_where_to_video, "Drive", (), VIDEO_HELP,
           lambda session: session.drives.why_no_video(session) is None),
    Command("Jump to the collision", _jump_to_collision, "Drive", (), "Stop at the moment in which something is hit.",
           _hits),
    Command("Jump to the smallest TTC", _jump_to_smallest_ttc, "Drive", (),
           "Stop at the moment of the smallest time to collision.", _plays),
    Command("Follow the ego vehicle", _follow("behind"), "Drive", (), "From 8 m behind and 3 m up.", _plays,
           _follows("behind")),
    Command("Look through the front camera", _follow("front camera"), "Drive", (), "Of the ego vehicle's rig.", _plays,
           _follows("front camera")),
    Command("Leave the ego vehicle", _follow("free"), "Drive", (), "The camera stays where it is.", _plays,
           _follows("free")),
    Command("Close the roll-outs", lambda session: session.drives.close_all(session), "Drive", (),
           "The scene with its own traffic comes back.", _plays),
)  # fmt: skip

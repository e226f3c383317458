"""Time and the camera path."""

from collections.abc import Callable

from imgui_bundle import imgui

from gsrain_engine.session.camera_path import edits, files, moments
from gsrain_engine.session.session import Session

from ..panels.timeline.path_menu import ask_for_export, ask_for_import
from ..shortcuts import chord
from .action import Action

_KEY = imgui.Key


def _has_path(session: Session) -> bool:
    return session.scene.path is not None


def _has_chosen_key(session: Session) -> bool:
    return edits.chosen_key(session) is not None


def _with_chosen(change: Callable[[Session, int], None]) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        key = edits.chosen_key(session)
        if key is not None:
            change(session, key)

    return run


def _step(frames: int) -> Callable[[Session], None]:
    return lambda session: session.clock.step(frames, session.timeline.fps)


def _ask_for_time(session: Session) -> None:
    session.timeline.asks_for_time = True


def _repeat(session: Session) -> None:
    session.clock.loop = not session.clock.loop


def _loop(session: Session) -> None:
    path = session.scene.path
    if path is not None:
        edits.change_path(session, "Loop off" if path.loop else "Loop on", loop=not path.loop)


def _show_path(session: Session) -> None:
    session.timeline.show_path = not session.timeline.show_path


TIME_ACTIONS = (
    Action("Go to the start of time", lambda session: session.clock.seek(session.span_s[0]), "Timeline",
           chord(_KEY.mod_ctrl, _KEY.left_arrow), "To where playing starts."),
    Action("Go to the end of time", lambda session: session.clock.seek(session.span_s[1]), "Timeline",
           chord(_KEY.mod_ctrl, _KEY.right_arrow), "To where playing ends."),
    Action("Go to time...", _ask_for_time, "Timeline", chord(_KEY.mod_ctrl, _KEY.g),
           "Type a moment in seconds."),
    Action("Step one frame back", _step(-1), "Timeline", chord(_KEY.left_arrow),
           "Stop, and go one frame of the film back."),
    Action("Step one frame on", _step(1), "Timeline", chord(_KEY.right_arrow),
           "Stop, and go one frame of the film on."),
    Action("Repeat", _repeat, "Timeline", (), "Begin again at the end of time; else stop there.",
           is_on=lambda session: session.clock.loop),
)  # fmt: skip
CAMERA_KEY_ACTIONS = (
    Action("Add camera key", edits.add_key, "Timeline", chord(_KEY.k),
           "Keep what the view shows as a camera key at the present time."),
    Action("Append camera key", edits.append_key, "Timeline", chord(_KEY.mod_shift, _KEY.k),
           "Keep what the view shows as a key after the last one, and go to its time."),
    Action("Update camera key", _with_chosen(edits.update_key), "Timeline", (),
           "Give the chosen key what the view shows.", _has_chosen_key),
    Action("Delete camera key", _with_chosen(edits.delete_key), "Timeline", chord(_KEY.mod_shift, _KEY.delete),
           "Take the chosen key away; Delete does so while the timeline has the focus.", _has_chosen_key),
    Action("Snap camera key to the drive", _with_chosen(files.snap_key), "Timeline", (),
           "Lay the chosen key onto the nearest place of the recorded drive.", _has_chosen_key),
    Action("Go to the previous camera key", lambda session: moments.go_to_next_key(session, -1), "Timeline",
           (chord(_KEY.comma), chord(_KEY.mod_alt, _KEY.left_arrow)), "And look through it.", _has_path),
    Action("Go to the next camera key", lambda session: moments.go_to_next_key(session, 1), "Timeline",
           (chord(_KEY.period), chord(_KEY.mod_alt, _KEY.right_arrow)), "And look through it.", _has_path),
)  # fmt: skip
PATH_ACTIONS = (
    Action("Ride along", lambda session: session.ride(not session.view.follow_path), "Timeline", chord(_KEY.v),
           "Look through the camera that flies along the path.", is_on=lambda session: session.view.follow_path),
    Action("Show the camera path", _show_path, "Timeline", (), "Draw its way and its keys into the picture.",
           is_on=lambda session: session.timeline.show_path),
    Action("Loop the camera path", _loop, "Timeline", (), "Fly from the last key on to the first.", _has_path,
           lambda session: session.scene.path is not None and session.scene.path.loop),
    Action("Camera path from the drive", files.path_from_drive, "Timeline", (),
           "Fly as the recording vehicle drove, with as few keys as stay within 5 cm.",
           lambda session: bool(files.rig_cameras(session))),
    Action("Circle around the target", edits.circle_target, "Timeline", (),
           "A loop of 12 s from this view on, around the point that a left drag orbits."),
    Action("Reverse the camera path", edits.reverse_path, "Timeline", (), "Fly the same way backwards.", _has_path),
    Action("Import camera path...", ask_for_import, "Timeline", (),
           "Ours, nerfstudio's camera_path.json or 3DGS's cameras.json."),
    Action("Export camera path...", ask_for_export, "Timeline", (),
           "Keys and what lies between them; for other programs see Path in the Timeline panel."),
    Action("Delete camera path", edits.delete_path, "Timeline", (),
           "Take all keys away: riding along takes the scene's own way again.", _has_path),
)  # fmt: skip

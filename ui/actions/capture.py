"""Recorded drives beside the scene: opening one, and looking from its cameras."""

from collections.abc import Callable

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..panels.capture_dialogs import ask_for_capture_file, ask_for_capture_folder
from ..shortcuts import chord
from .action import Action

_KEY = imgui.Key


def _has_capture(session: Session) -> bool:
    return session.captures.capture is not None


def _toggle(field: str) -> Callable[[Session], None]:
    return lambda session: setattr(session.captures, field, not getattr(session.captures, field))


def _is(field: str) -> Callable[[Session], bool]:
    return lambda session: getattr(session.captures, field)


CAPTURE_FILE_ACTIONS = (
    Action(
        "Open a capture...",
        ask_for_capture_folder,
        "File",
        help="Show recorded pictures, cameras and points beside the scene: a folder of COLMAP, nerfstudio, nuScenes, "
        "DGP, KITTI, Waymo, RainSense, the street, or of pictures alone.",
    ),
    Action(
        "Open a capture file...",
        ask_for_capture_file,
        "File",
        help="The same for a capture that is one file: transforms.json, a .tfrecord of Waymo, a .pkl of MMDetection3D.",
    ),
    Action(
        "Close the capture",
        lambda session: session.captures.close_capture(),
        "File",
        help="Show the scene alone.",
        is_possible=_has_capture,
    ),
)
CAPTURE_ACTIONS = (
    Action(
        "Look from the chosen view",
        lambda session: session.captures.look_from(session, session.captures.chosen),
        "View",
        chord(_KEY.mod_shift, _KEY.v),
        "Go to where a picture of the capture was taken, with its field of view, and lay it over the render.",
        _has_capture,
    ),
    Action(
        "Look from the next view",
        lambda session: session.captures.step(session, 1),
        "View",
        chord(_KEY.page_down),
        "Go on to the next picture of the capture, of the chosen camera.",
        _has_capture,
    ),
    Action(
        "Look from the previous view",
        lambda session: session.captures.step(session, -1),
        "View",
        chord(_KEY.page_up),
        "Go back to the picture of the capture before.",
        _has_capture,
    ),
    Action(
        "Show the recorded picture",
        _toggle("show_picture"),
        "View",
        chord(_KEY.mod_shift, _KEY.p),
        "Lay the recorded picture over the render while the eye is where it was taken.",
        _has_capture,
        _is("show_picture"),
    ),
    Action(
        "Show recorded cameras",
        _toggle("show_frustums"),
        help="Show where the pictures of the capture were taken.",
        is_possible=_has_capture,
        is_on=_is("show_frustums"),
    ),
    Action(
        "Show measured points",
        _toggle("show_points"),
        help="Show the capture's points (COLMAP, lidar) over the picture.",
        is_possible=_has_capture,
        is_on=_is("show_points"),
    ),
    Action(
        "Show matches with another view",
        lambda session: setattr(session.matching, "is_on", not session.matching.is_on),
        "View",
        chord(_KEY.mod_shift, _KEY.m),
        "Find each pixel of what is looked at in another view of the capture, by its depth.",
        _has_capture,
        lambda session: session.matching.is_on,
    ),
)

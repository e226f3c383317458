"""Recording clips and stills."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..panels.record_panel import ask_where_to_record, ask_where_to_record_still
from ..shortcuts import chord
from .action import Action

_KEY = imgui.Key


def _can_record(session: Session) -> bool:
    return bool(session.scene.members) and not session.recorder.is_recording


RECORD_ACTIONS = (
    Action(
        "Record the timeline...",
        ask_where_to_record,
        "File",
        chord(_KEY.mod_ctrl, _KEY.r),
        "Record the camera path, or rig cameras, as the Record panel says: a video or frames, in the background.",
        is_possible=_can_record,
    ),
    Action(
        "Record a still...",
        ask_where_to_record_still,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.r),
        "Record the moment and the place that the view shows, in the size and with the samples of the Record panel.",
        is_possible=_can_record,
    ),
)

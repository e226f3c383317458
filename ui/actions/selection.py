"""Selecting: all, none, the rest, more and less."""

from imgui_bundle import imgui

from gsrain_engine.session.selection import steps
from gsrain_engine.session.session import Session

from ..shortcuts import chord
from .action import Action

_CTRL, _SHIFT, _KEY = imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key


def _save_set(session: Session) -> None:
    steps.save_set(session)


SELECTION_ACTIONS = (
    Action(
        "Select all",
        steps.select_all,
        "Select",
        chord(_CTRL, _KEY.a),
        "Select every Gaussian that is shown, of layers and actors that are not locked.",
    ),
    Action(
        "Select none",
        steps.select_none,
        "Select",
        chord(_CTRL, _SHIFT, _KEY.a),
        "Let go of everything.",
        is_possible=steps.has_selection,
    ),
    Action(
        "Invert the selection",
        steps.invert,
        "Select",
        chord(_CTRL, _KEY.i),
        "Select what is shown and was not selected.",
    ),
    Action(
        "Grow the selection",
        lambda session: steps.grow(session, session.selecting.distance_m),
        "Select",
        chord(_CTRL, _KEY.right_bracket),
        "Take in what is near the selection, as many metres as the Select panel says.",
        is_possible=steps.has_selection,
    ),
    Action(
        "Shrink the selection",
        lambda session: steps.shrink(session, session.selecting.distance_m),
        "Select",
        chord(_CTRL, _KEY.left_bracket),
        "Let go of what is near something that is not selected, as many metres as the Select panel says.",
        is_possible=steps.has_selection,
    ),
    Action(
        "Save the selection as a set",
        _save_set,
        "Select",
        help="Keep what is selected under a name; the Select panel lists the sets.",
        is_possible=steps.has_selection,
    ),
)

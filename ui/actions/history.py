"""Undo and redo."""

from imgui_bundle import imgui

from ..shortcuts import chord
from .action import Action

_CTRL, _SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift

HISTORY_ACTIONS = (
    Action(
        "Undo",
        lambda session: session.undo(),
        "Edit",
        chord(_CTRL, imgui.Key.z),
        "Take the last step back.",
        is_possible=lambda session: session.history.undo_label is not None,
        more=lambda session: session.history.undo_label or "",
    ),
    Action(
        "Redo",
        lambda session: session.redo(),
        "Edit",
        (chord(_CTRL, _SHIFT, imgui.Key.z), chord(_CTRL, imgui.Key.y)),
        "Bring the step back that was undone.",
        is_possible=lambda session: session.history.redo_label is not None,
        more=lambda session: session.history.redo_label or "",
    ),
)

"""Commands that edit the selection and the active layer or actor, and selection commands."""

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits import layers
from gsrain_engine.editor.edits.gaussians import (
    compact,
    delete_selected,
    deleted_count,
    hide_selected,
    isolate_selected,
    selected_count,
    show_all,
)
from gsrain_engine.editor.edits.level import level_from_ground
from gsrain_engine.editor.selection import commands

from .base import Command, chord

_KEY = imgui.Key


def _has_selection(session: Editor) -> bool:
    return bool(selected_count(session.scene))


def _has_member(session: Editor) -> bool:
    return any(each.key == session.view.member for each in session.scene.members)


def _delete(session: Editor) -> None:
    if not session.timeline.takes_keys or session.timeline.key is None:  # else Delete is for the active camera keyframe
        session.edit("Delete the selection", delete_selected)


def _duplicate(session: Editor) -> None:
    before = {each.key for each in session.scene.members}
    name = session.scene.member(session.view.member).name
    session.edit(f"Duplicate {name}", layers.duplicate, session.view.member)
    session.view.member = next(
        (each.key for each in session.scene.members if each.key not in before), session.view.member
    )


def _follow(session: Editor) -> None:
    member, following = session.view.member, session.following
    following.follow("" if following.key == member else member)
    session.view.follow_path = False


EDIT_ACTIONS = (
    Command(
        "Delete the selection",
        _delete,
        "Edit",
        chord(_KEY.delete),
        "Delete the selected Gaussians; undo brings them back.",
        is_possible=_has_selection,
    ),
    Command(
        "Hide the selection",
        lambda session: session.edit("Hide the selection", hide_selected),
        "Edit",
        chord(_KEY.h),
        "Do not draw the selected Gaussians.",
        is_possible=_has_selection,
    ),
    Command(
        "Isolate the selection",
        lambda session: session.edit("Isolate the selection", isolate_selected),
        "Edit",
        chord(_KEY.mod_shift, _KEY.i),
        "Hide everything but the selected Gaussians; locked layers stay as they are.",
        is_possible=_has_selection,
    ),
    Command(
        "Show all",
        lambda session: session.edit("Show all", show_all),
        "Edit",
        chord(_KEY.mod_shift, _KEY.h),
        "Draw everything again that was hidden.",
        is_possible=lambda session: any(each.marks.hidden for each in session.scene.members),
    ),
    Command(
        "Duplicate",
        _duplicate,
        "Edit",
        chord(_KEY.mod_ctrl, _KEY.d),
        "Copy the layer or actor that is picked.",
        is_possible=_has_member,
        more=lambda session: session.view.member.partition("/")[2],
    ),
    Command(
        "Separate the selection",
        lambda session: session.edit("Separate the selection", layers.separate),
        "Edit",
        chord(_KEY.mod_ctrl, _KEY.j),
        "Make the selected Gaussians a layer of their own.",
        is_possible=_has_selection,
    ),
    Command(
        "Remove deleted Gaussians for good",
        lambda session: session.edit("Remove what is deleted", compact),
        "Edit",
        (),
        "Make new arrays without them; undo still has the old ones.",
        is_possible=lambda session: deleted_count(session.scene) > 0,
    ),
    Command(
        "Level by the ground",
        lambda session: session.edit("Level by the ground", level_from_ground),
        "Edit",
        (),
        "Find the largest low plane of the scene and make it level.",
        is_possible=lambda session: bool(session.scene.layers),
    ),
    Command(
        "Follow the actor with the camera",
        _follow,
        "Edit",
        (),
        "The camera keeps its place beside the picked actor and turns with it.",
        is_possible=lambda session: _has_member(session) and session.view.member.startswith("actors/"),
        is_on=lambda session: bool(session.following.key),
    ),
)

# Selection

_CTRL, _SHIFT, _SELECTION_KEY = imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key


def _save_set(session: Editor) -> None:
    commands.save_set(session)


SELECTION_ACTIONS = (
    Command(
        "Select all",
        commands.select_all,
        "Select",
        chord(_CTRL, _SELECTION_KEY.a),
        "Select every Gaussian that is shown, of layers and actors that are not locked.",
    ),
    Command(
        "Select none",
        commands.select_none,
        "Select",
        chord(_CTRL, _SHIFT, _SELECTION_KEY.a),
        "Let go of everything.",
        is_possible=commands.has_selection,
    ),
    Command(
        "Invert the selection",
        commands.invert,
        "Select",
        chord(_CTRL, _SELECTION_KEY.i),
        "Select what is shown and was not selected.",
    ),
    Command(
        "Grow the selection",
        lambda session: commands.grow(session, session.selecting.distance_m),
        "Select",
        chord(_CTRL, _SELECTION_KEY.right_bracket),
        "Take in what is near the selection, as many metres as the Select panel says.",
        is_possible=commands.has_selection,
    ),
    Command(
        "Shrink the selection",
        lambda session: commands.shrink(session, session.selecting.distance_m),
        "Select",
        chord(_CTRL, _SELECTION_KEY.left_bracket),
        "Let go of what is near something that is not selected, as many metres as the Select panel says.",
        is_possible=commands.has_selection,
    ),
    Command(
        "Save the selection as a set",
        _save_set,
        "Select",
        help="Keep what is selected under a name; the Select panel lists the sets.",
        is_possible=commands.has_selection,
    ),
)

"""Commands of files, undo, help, jobs and recording."""

from pathlib import Path

from imgui_bundle import imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.make_rainy import MAKE_RAINY_TITLE
from gsrain_engine.scene.formats.registry import scene_suffixes

from ..panels.record import ask_where_to_record, ask_where_to_record_still
from ..widgets.fields import SCENE_FOLDERS, ask_what_to_open, ask_where_to_save, exported_kinds
from .base import Command, chord

_KEY = imgui.Key


def _scenes() -> str:
    """Return the file types of a dialog: extensions of all scene files, including those of installed packages."""
    ends = dict.fromkeys(Path(f"scene{suffix}").suffix for suffix in scene_suffixes())
    return f"Scenes{{{','.join(ends)}}},All files{{.*}}"


def _chosen(path: Path) -> str:
    return str(path.parent if path.name == "scene.json" else path)


def _ask_what_to_open(session: Editor) -> None:
    ask_what_to_open("Open a scene", _scenes(), lambda chosen: session.open(_chosen(chosen[0])))


def _ask_what_to_import(session: Editor) -> None:
    def take(chosen: list[Path]) -> None:
        for path in chosen:
            session.files.import_from(_chosen(path))

    ask_what_to_open("Import into this scene", _scenes(), take, several=True)


def _ask_where_to_save(session: Editor) -> None:
    ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: session.files.save_as(chosen[0]))


def _ask_where_to_export(session: Editor) -> None:
    ask_where_to_save("Export a file", exported_kinds(), lambda chosen: session.files.export_to(chosen[0]))


def _has_scene(session: Editor) -> bool:
    return bool(session.scene.members)


OPEN_ACTIONS = (
    Command(
        "Open...",
        _ask_what_to_open,
        "File",
        chord(_KEY.mod_ctrl, _KEY.o),
        "Open a scene file, or a scene folder by its scene.json.",
    ),
    Command(
        "Open the built-in street",
        lambda session: session.open("street"),
        "File",
        help="A street with cars and trees that needs no download.",
    ),
)

IMPORT_ACTIONS = (
    Command(
        "Import into this scene...",
        _ask_what_to_import,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.o),
        "Add the layers and actors of other scenes, where they lie in the world (metres).",
    ),
    Command(
        "Import the built-in street",
        lambda session: session.files.import_from("street"),
        "File",
        help="Add the street's layers and its car to this scene.",
        is_possible=_has_scene,
    ),
)

SAVING_ACTIONS = (
    Command(
        "Save",
        lambda session: session.files.save(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.s),
        "Save to the scene folder that this was opened from or saved to; where there is none, ask for a place.",
        _has_scene,
    ),
    Command(
        "Save as...",
        _ask_where_to_save,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.s),
        "Save to another scene folder, which keeps everything.",
        _has_scene,
    ),
    Command(
        "Export...",
        _ask_where_to_export,
        "File",
        chord(_KEY.mod_ctrl, _KEY.e),
        "Write one file of what can be seen (.ply, .splat, .spz), for other programs; the document stays unsaved.",
        _has_scene,
    ),
    Command(
        "Revert",
        lambda session: session.files.revert(),
        "File",
        help="Read the scene from the disk again; all changes since it was saved are lost.",
        is_possible=lambda session: session.files.source is not None,
    ),
    Command(
        "Close the scene",
        lambda session: session.files.close_scene(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.w),
        "Go to an empty window.",
        _has_scene,
    ),
)

LEAVING_ACTIONS = (
    Command(
        "Quit",
        lambda session: session.request_quit(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.q),
        "End the program; unsaved changes are asked about.",
    ),
)

# Undo and redo

_CTRL, _SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift

HISTORY_ACTIONS = (
    Command(
        "Undo",
        lambda session: session.undo(),
        "Edit",
        chord(_CTRL, imgui.Key.z),
        "Take the last step back.",
        is_possible=lambda session: session.history.undo_label is not None,
        more=lambda session: session.history.undo_label or "",
    ),
    Command(
        "Redo",
        lambda session: session.redo(),
        "Edit",
        (chord(_CTRL, _SHIFT, imgui.Key.z), chord(_CTRL, imgui.Key.y)),
        "Bring the step back that was undone.",
        is_possible=lambda session: session.history.redo_label is not None,
        more=lambda session: session.history.redo_label or "",
    ),
)

# Help

HELP_ACTIONS = (
    Command(
        "Find a command...",
        lambda session: setattr(session.view, "dialog", "commands"),
        "Help",
        (chord(imgui.Key.mod_ctrl, imgui.Key.p), chord(imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key.p)),
        "Type part of a name; Enter does it.",
    ),
    Command(
        "Keyboard and mouse",
        lambda session: setattr(session.view, "dialog", "keys"),
        "Help",
        chord(imgui.Key.f1),
        "Everything with its key, on one page.",
    ),
    Command(
        "About GSRAIN",
        lambda session: setattr(session.view, "dialog", "about"),
        "Help",
        help="Version, what draws, and where the method comes from.",
    ),
)

# Background jobs

JOB_ACTIONS = (
    Command(
        MAKE_RAINY_TITLE,
        lambda session: session.rainy.make(session),
        "Scene",
        help="Transfer views and solve for wet colours, in the background, as the panel of this name says.",
        is_possible=lambda session: session.rainy.why_not(session) is None,
    ),
    Command(
        "Preview this view in rain",
        lambda session: session.rainy.preview(session),
        "Scene",
        help="Transfer what the view shows, and lay it beside the live picture.",
        is_possible=lambda session: session.rainy.why_no_preview(session) is None,
    ),
    Command(
        "Compare clear and rainy",
        lambda session: session.rainy.compare(session),
        "View",
        help="Lay the clear scene beside the rainy one, with a line between them that can be dragged.",
        is_possible=lambda session: session.scene.has_wet_colors,
    ),
)

# Recording


def _can_record(session: Editor) -> bool:
    return bool(session.scene.members) and not session.recorder.is_recording


RECORD_ACTIONS = (
    Command(
        "Record the timeline...",
        ask_where_to_record,
        "File",
        chord(_KEY.mod_ctrl, _KEY.r),
        "Record the camera path, or rig cameras, as the Record panel says: a video or frames, in the background.",
        is_possible=_can_record,
    ),
    Command(
        "Record a still...",
        ask_where_to_record_still,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.r),
        "Record the moment and the place that the view shows, in the size and with the samples of the Record panel.",
        is_possible=_can_record,
    ),
)

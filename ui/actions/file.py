"""Opening and saving, and leaving."""

from pathlib import Path

from imgui_bundle import imgui

from gsrain_engine.scene.formats.gaussian_files import scene_suffixes
from gsrain_engine.session.session import Session

from ..shortcuts import chord
from ..widgets.file_dialogs import SCENE_FOLDERS, ask_what_to_open, ask_where_to_save, exported_kinds
from .action import Action

_KEY = imgui.Key


def _scenes() -> str:
    """Kinds of files that a dialog offers: the ends of all scene files, those of installed packages too."""
    ends = dict.fromkeys(Path(f"scene{suffix}").suffix for suffix in scene_suffixes())
    return f"Scenes{{{','.join(ends)}}},All files{{.*}}"


def _chosen(path: Path) -> str:
    return str(path.parent if path.name == "scene.json" else path)


def _ask_what_to_open(session: Session) -> None:
    ask_what_to_open("Open a scene", _scenes(), lambda chosen: session.open(_chosen(chosen[0])))


def _ask_what_to_import(session: Session) -> None:
    def take(chosen: list[Path]) -> None:
        for path in chosen:
            session.files.import_from(_chosen(path))

    ask_what_to_open("Import into this scene", _scenes(), take, several=True)


def _ask_where_to_save(session: Session) -> None:
    ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: session.files.save_as(chosen[0]))


def _ask_where_to_export(session: Session) -> None:
    ask_where_to_save("Export a file", exported_kinds(), lambda chosen: session.files.export_to(chosen[0]))


def _has_scene(session: Session) -> bool:
    return bool(session.scene.members)


OPEN_ACTIONS = (
    Action(
        "Open...",
        _ask_what_to_open,
        "File",
        chord(_KEY.mod_ctrl, _KEY.o),
        "Open a scene file, or a scene folder by its scene.json.",
    ),
    Action(
        "Open the built-in street",
        lambda session: session.open("street"),
        "File",
        help="A street with cars and trees that needs no download.",
    ),
)
IMPORT_ACTIONS = (
    Action(
        "Import into this scene...",
        _ask_what_to_import,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.o),
        "Add the layers and actors of other scenes, where they lie in the world (metres).",
    ),
    Action(
        "Import the built-in street",
        lambda session: session.files.import_from("street"),
        "File",
        help="Add the street's layers and its car to this scene.",
        is_possible=_has_scene,
    ),
)
SAVING_ACTIONS = (
    Action(
        "Save",
        lambda session: session.files.save(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.s),
        "Save to the scene folder that this was opened from or saved to; where there is none, ask for a place.",
        _has_scene,
    ),
    Action(
        "Save as...",
        _ask_where_to_save,
        "File",
        chord(_KEY.mod_ctrl, _KEY.mod_shift, _KEY.s),
        "Save to another scene folder, which keeps everything.",
        _has_scene,
    ),
    Action(
        "Export...",
        _ask_where_to_export,
        "File",
        chord(_KEY.mod_ctrl, _KEY.e),
        "Write one file of what can be seen (.ply, .splat, .spz), for other programs; the document stays unsaved.",
        _has_scene,
    ),
    Action(
        "Revert",
        lambda session: session.files.revert(),
        "File",
        help="Read the scene from the disk again; all changes since it was saved are lost.",
        is_possible=lambda session: session.files.source is not None,
    ),
    Action(
        "Close the scene",
        lambda session: session.files.close_scene(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.w),
        "Go to an empty window.",
        _has_scene,
    ),
)
LEAVING_ACTIONS = (
    Action(
        "Quit",
        lambda session: session.leave(),
        "File",
        chord(_KEY.mod_ctrl, _KEY.q),
        "End the program; unsaved changes are asked about.",
    ),
)

"""Functions of commands that need more than a part's method: questions for files, and edits of what is active."""

from pathlib import Path

from gsrain_engine.editor.camera_path import CameraPathEditor
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits import gaussians, layers
from gsrain_engine.editor.edits.members import keys_of, members_title
from gsrain_engine.editor.files import Files
from gsrain_engine.editor.rain_tracks import RainTracks
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.editor.views import NamedViews
from gsrain_engine.scene.formats.registry import scene_suffixes, writable_suffixes

from ..folding import show_panel
from ..widgets.file_dialogs import SCENE_FOLDERS, ask_what_to_open, ask_where_to_save, exported_kinds

# Preconditions


def has_selection(document: Document) -> bool:
    return bool(gaussians.selected_count(document.scene))


def has_deleted(document: Document) -> bool:
    return gaussians.deleted_count(document.scene) > 0


# Files


def ask_what_to_open_scene(files: Files) -> None:
    ask_what_to_open("Open a scene", _scene_kinds(), lambda chosen: files.open(_opened(chosen[0])), takes_scenes=True)


def ask_what_to_import(files: Files) -> None:
    def take(chosen: list[Path]) -> None:
        for path in chosen:
            files.import_from(_opened(path))

    ask_what_to_open("Import into this scene", _scene_kinds(), take, several=True, takes_scenes=True)


def ask_where_to_save_scene(files: Files) -> None:
    save, name = files.save_as, files.proposed_name()
    ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: save(chosen[0]), proposed=name, confirms=False)


def ask_where_to_export(files: Files) -> None:
    export, name = files.export_to, files.proposed_name(writable_suffixes()[0])
    ask_where_to_save(
        "Export a file", exported_kinds(), lambda chosen: export(chosen[0]), proposed=name, confirms=False
    )


def _opened(path: Path) -> str:
    return str(path.parent if path.name == "scene.json" else path)


def _scene_kinds() -> str:
    """Return the file types of a dialog: extensions of all scene files, including those of installed packages."""
    ends = dict.fromkeys(Path(f"scene{suffix}").suffix for suffix in scene_suffixes())
    return f"Scenes{{{','.join(ends)}}},All files{{.*}}"


# Edits of what is active


def delete_selection(document: Document, playback: Playback, rain_tracks: RainTracks) -> None:
    is_of_key = playback.timeline.key is not None or rain_tracks.active is not None
    if not playback.timeline.takes_keys or not is_of_key:  # else Delete is for the active keyframe
        count = gaussians.selected_count(document.scene)
        document.edit(f"Delete {count:,} selected", gaussians.delete_selected)


def duplicate_members(document: Document, viewport: ViewportState) -> None:
    """Copy the chosen layers and actors; the copies are chosen then."""
    before, chosen = {each.key for each in document.scene.members}, viewport.chosen_members
    document.edit(f"Duplicate {members_title(chosen)}", layers.duplicate, keys_of(chosen))
    if copies := [each.key for each in document.scene.members if each.key not in before]:
        viewport.choose(*copies)


def loop_path(document: Document, camera_path: CameraPathEditor) -> None:
    if (path := document.scene.path) is not None:
        camera_path.change_path("Closed path off" if path.loop else "Closed path on", loop=not path.loop)


def rename_view(views: NamedViews) -> None:
    """Bring the views to the front, with the keyboard in the name of the chosen one."""
    show_panel("Views")
    views.begin_renaming(views.chosen)


def copy_keyframe(camera_path: CameraPathEditor, rain_tracks: RainTracks) -> None:
    """Copy the active keyframe of the camera path, or else of a track of the rain."""
    if (key := camera_path.active_key) is not None:
        camera_path.copy(key)
        rain_tracks.copied = None
    else:
        rain_tracks.copy()
        camera_path.copied = None


def paste_keyframe(camera_path: CameraPathEditor, rain_tracks: RainTracks) -> None:
    """Insert the copied keyframe at the playhead."""
    if camera_path.copied is not None:
        camera_path.paste()
    else:
        rain_tracks.paste()

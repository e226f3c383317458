"""What can be done with the whole camera path: from and to files, from the drive, backwards, away."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.camera_path import edits, files
from gsrain_engine.session.session import Session

from ...widgets.file_dialogs import ask_what_to_open, ask_where_to_save
from ...widgets.names import label
from .widgets import icon_button

_FRAME_RATES = (10.0, 24.0, 25.0, 30.0, 50.0, 60.0)
_JSON = "Camera paths{.json},All files{.*}"


def path_menu(session: Session) -> None:
    """Draw the button, and its menu while it is open."""
    if icon_button(
        f"Path {icons_fontawesome_6.ICON_FA_CARET_DOWN}", "path", "Files, the drive, and the path as a whole."
    ):
        imgui.open_popup("path menu")
    if imgui.begin_popup("path menu"):
        _files(session)
        imgui.separator()
        _drives(session)
        if _item(
            "Circle around the target", "A loop of 12 s from this view on, around the point that a left drag orbits."
        ):
            edits.circle_target(session)
        imgui.separator()
        _whole(session)
        imgui.end_popup()


def ask_for_import(session: Session) -> None:
    """Show the dialog for a path to read."""
    ask_what_to_open("Import a camera path", _JSON, lambda chosen: files.import_path(session, chosen[0]))


def ask_for_export(session: Session) -> None:
    """Show the dialog for a path to write."""
    ask_where_to_save("Export the camera path", _JSON, lambda chosen: files.export_path(session, chosen[0]))


def _files(session: Session) -> None:
    if _item("Import...", "Read a camera path: ours, nerfstudio's camera_path.json, or 3DGS's cameras.json."):
        ask_for_import(session)
    if not imgui.begin_menu("Export"):
        return
    if _item("Keys (GSRAIN)...", "Keys and what lies between them: reads back as it is."):
        ask_for_export(session)
    if _item("Every frame (nerfstudio)...", "A camera_path.json as ns-render reads it, at the film's frame rate."):
        title = "Export for nerfstudio"
        ask_where_to_save(title, _JSON, lambda chosen: files.export_nerfstudio(session, chosen[0]))
    if _item("Every frame (3DGS cameras.json)...", "A list of cameras at the film's frame rate; it knows no times."):
        title = "Export as 3DGS cameras"
        ask_where_to_save(title, _JSON, lambda chosen: files.export_training_cameras(session, chosen[0]))
    imgui.end_menu()


def _drives(session: Session) -> None:
    cameras = files.rig_cameras(session)
    if not imgui.begin_menu("From the drive", bool(cameras)):
        imgui.set_item_tooltip("Fly as a camera of the recording vehicle did. This scene has no such vehicle.")
        return
    for number, camera in enumerate(cameras):
        if imgui.begin_menu(label(camera.name, str(number))):
            if _item("Few keys", "As few keys as stay within 5 cm and half a degree of the drive."):
                files.path_from_drive(session, camera)
            for seconds in (0.5, 1.0, 2.0):
                if _item(f"A key every {seconds:g} s", "Keys at even distances in time."):
                    files.path_from_drive(session, camera, seconds)
            imgui.end_menu()
    imgui.end_menu()


def _whole(session: Session) -> None:
    if imgui.begin_menu("Frames a second"):
        for fps in _FRAME_RATES:
            if imgui.menu_item(f"{fps:g}", "", session.timeline.fps == fps)[0]:
                session.timeline.fps = fps
        imgui.end_menu()
    imgui.set_item_tooltip("Of the film: keys and steps keep to its frames; exports write each of them.")
    has_path = session.scene.path is not None
    if _item("Reverse", "Fly the same way backwards.", possible=has_path):
        edits.reverse_path(session)
    if _item("Delete all keys", "Ride along takes the scene's own way again.", possible=has_path):
        edits.delete_path(session)


def _item(name: str, help_text: str, *, possible: bool = True) -> bool:
    clicked, _ = imgui.menu_item(name, "", False, possible)
    imgui.set_item_tooltip(help_text)
    return clicked

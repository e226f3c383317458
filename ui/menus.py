"""The menu bar."""

from pathlib import Path

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .file_dialogs import ask_what_to_open, ask_where_to_save

_SCENES = "Scenes{.ply,.splat,.spz,.ksplat,.sog,.json},All files{.*}"
_SAVED = "Scene files{.ply,.splat,.spz},Scene folders{.*}"


class Menus:
    """Menus of one window; keeps what is being typed."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._path = ""

    def draw(self) -> None:
        """Draw the menus into the menu bar."""
        session = self._session
        if imgui.begin_menu("File"):
            if imgui.menu_item("Open...", "Ctrl+O", False)[0]:
                self.ask_what_to_open()
            if imgui.menu_item("Open the built-in street", "", False)[0]:
                session.open("street")
            if imgui.menu_item("Save as...", "Ctrl+S", False)[0]:
                self.ask_where_to_save()
            imgui.separator()
            imgui.text("Path of a scene file or folder")
            imgui.set_next_item_width(28 * imgui.get_font_size())
            entered, self._path = imgui.input_text("##path", self._path, imgui.InputTextFlags_.enter_returns_true)
            imgui.same_line()
            if (imgui.button("Open") or entered) and self._path.strip():
                session.open(str(Path(self._path.strip()).expanduser()))
                imgui.close_current_popup()
            imgui.end_menu()
        if imgui.begin_menu("Edit"):
            undo, redo = session.history.undo_label, session.history.redo_label
            if imgui.menu_item(f"Undo {undo or ''}".strip(), "Ctrl+Z", False, undo is not None)[0]:
                session.undo()
            if imgui.menu_item(f"Redo {redo or ''}".strip(), "Ctrl+Shift+Z", False, redo is not None)[0]:
                session.redo()
            imgui.end_menu()

    def ask_what_to_open(self) -> None:
        """Show the open dialog."""
        ask_what_to_open("Open a scene", _SCENES, lambda chosen: self._open(chosen[0]))

    def ask_where_to_save(self) -> None:
        """Show the save dialog."""
        ask_where_to_save("Save the scene", _SAVED, lambda chosen: self._session.save(chosen[0]))

    def _open(self, chosen: Path) -> None:
        self._session.open(str(chosen.parent if chosen.name == "scene.json" else chosen))

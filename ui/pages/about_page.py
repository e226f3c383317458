"""What this program is."""

from importlib.metadata import version

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

TITLE = "About GSRAIN"


def about_page(session: Session) -> None:
    if session.view.dialog == "about" and not imgui.is_popup_open(TITLE):
        imgui.open_popup(TITLE)
    imgui.set_next_window_size(ImVec2(30 * imgui.get_font_size(), 0))
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, ImVec2(0.5, 0.5))
    is_open, _ = imgui.begin_popup_modal(TITLE, True)
    if not is_open:
        if session.view.dialog == "about":
            session.view.dialog = ""
        return
    imgui.text(f"GSRAIN {version('gsrain')}, Apache-2.0")
    imgui.text_wrapped("Calibrated rain in captured 3D Gaussian Splatting scenes: a viewer, an editor, a test bench.")
    imgui.text(f"Drawn by: {session.backend or 'nothing yet'}")
    imgui.text_wrapped("docs/physics.md gives each equation with its source.")
    if imgui.is_key_pressed(imgui.Key.escape):
        session.view.dialog = ""
        imgui.close_current_popup()
    imgui.end_popup()

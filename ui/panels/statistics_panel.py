"""The Statistics panel: frames a second, milliseconds a stage, what was drawn."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .rain_panel import WARNING


def statistics_panel(session: Session) -> None:
    imgui.text_wrapped(f"{imgui.get_io().framerate:.1f} frames a second, back end: {session.backend}")
    if not session.detail.is_exact:
        imgui.text_colored(WARNING, f"while the camera moves: {session.detail}")
    else:
        imgui.text_disabled("exact picture")
    if imgui.begin_table("statistics", 2, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop):
        for name, value in session.statistics.items():
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text(name.replace(" ms", " (ms)"))
            imgui.table_next_column()
            imgui.text(f"{value:,.0f}" if float(value).is_integer() else f"{value:,.2f}")
        imgui.end_table()

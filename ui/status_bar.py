"""The line at the bottom: scene, rain, what is being done."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .rain_panel import WARNING


def status_bar(session: Session) -> None:
    """Draw the bar's content."""
    state = session.rainfall.state
    rate = imgui.get_io().framerate
    imgui.text(
        f"{session.scene.name}   {session.clock.time_s:.1f} s   {state.intensity_mm_h:.1f} mm/h   "
        f"{rate:.0f} frames/s ({session.backend})"
    )
    if state.beyond_calibration:
        imgui.same_line()
        imgui.text_colored(WARNING, "beyond calibration")
    if session.rain.exaggeration:
        imgui.same_line()
        imgui.text_colored(WARNING, session.rain.exaggeration)
    for job in session.running_jobs:
        imgui.same_line()
        imgui.text(f"  {job.title}: {100 * job.progress.fraction:.0f} %")
    if session.busy is not None:
        imgui.same_line()
        imgui.text(f"  {session.busy}")

"""The line at the bottom: scene, selection, rain, what is being done or was just done, and help on the tool in use."""

import logging
from datetime import datetime, timedelta

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from .panels.rain_panel import WARNING
from .tools import TOOLS

_NEW = timedelta(seconds=8)


def status_bar(session: Session) -> None:
    """Draw the bar's content."""
    state = session.shown_rainfall.state_at(session.clock.time_s)
    selected = sum(each.marks.selected.size for each in session.scene.members if each.marks.selected is not None)
    words = [session.scene.name, f"{session.clock.time_s:.1f} s", f"{state.intensity_mm_h:.1f} mm/h"]
    if selected:
        words.append(f"{selected:,} selected")
    imgui.text("   ".join(words))
    for warning in filter(None, ["beyond calibration" if state.beyond_calibration else "", session.rain.exaggeration]):
        imgui.same_line()
        imgui.text_colored(WARNING, warning)
    for job in session.running_jobs:
        imgui.same_line()
        imgui.text(f"  {job.title}: {100 * job.progress.fraction:.0f} %")
    if session.busy is not None:
        imgui.same_line()
        imgui.text(f"  {session.busy}")
    tool = next((each for each in TOOLS if each.name == session.view.tool), None)
    right = f"{imgui.get_io().framerate:.0f} frames/s ({session.backend})"
    room = imgui.get_window_width() - imgui.calc_text_size(right).x - 2 * imgui.get_font_size()
    hint = _newest_record(session) or (f"{tool.name}: {tool.help}" if tool is not None else "")
    if hint:
        imgui.same_line()
        corner, height = imgui.get_window_pos(), imgui.get_window_height()
        low, high = imgui.get_cursor_screen_pos(), (corner.x + room, corner.y + height)
        imgui.push_clip_rect(low, high, True)
        imgui.text_disabled(f"   {hint}")
        imgui.pop_clip_rect()
    imgui.same_line(room)
    imgui.text_disabled(right)


def _newest_record(session: Session) -> str:
    """Return what has just gone well, as "Exported out.ply"; what went wrong stays over the picture."""
    newest = session.log.lines[-1] if session.log.lines else None
    is_new = newest is not None and newest.level == logging.INFO and datetime.now() - newest.at < _NEW
    return newest.text if newest is not None and is_new else ""

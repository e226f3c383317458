"""Jobs, Log and Statistics panels."""

import logging
import webbrowser
from typing import Any

from imgui_bundle import ImVec2, ImVec4, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.editor.notifications import LogLine

from .rain import WARNING


def jobs_panel(session: Editor) -> None:
    if not session.jobs:
        imgui.text_wrapped("Nothing goes on in the background. Make it rainy, Capture, Drive and Record start jobs.")
    for number, job in reversed(list(enumerate(session.jobs))):
        imgui.separator_text(job.title)
        job_fields(session, job, number)
    if len(session.jobs) > len(session.running_jobs) and imgui.button("Clear", (-1, 0)):
        session.jobs = session.running_jobs


# One job: progress, preview, cancel button and result

_HIGHEST_PREVIEW_EM = 9.0


def job_fields(session: Editor, job: Job[Any], number: int) -> None:
    """Draw a job; `number` distinguishes it from others in the panel."""
    if job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), f"{100 * job.progress.fraction:.0f} %")
        imgui.text_wrapped(job.progress.message)
        _preview(session, job)
        if imgui.button(f"Cancel##{number}", (-1, 0)):
            job.cancel()
        imgui.set_item_tooltip("Stop the job; the scene stays as it is, and what was recorded so far can be played.")
    elif job.state == "failed":
        imgui.text_colored(WARNING, "Failed")
        imgui.text_wrapped(job.error or "")
        if job.details and imgui.tree_node(f"Traceback##{number}"):
            imgui.text_unformatted(job.details)
            imgui.tree_pop()
    else:
        imgui.text_wrapped(job.progress.message if job.state == "finished" else "Cancelled")
        if job.state == "finished" and job.report is not None:
            if imgui.button(f"Report##{number}", (-1, 0)):
                webbrowser.open(job.report.as_uri())
            imgui.set_item_tooltip(f"Show figures, views and timings in a browser: {job.report}")


def _preview(session: Editor, job: Job[Any]) -> None:
    """Draw the latest preview, fitted to the panel's width and limited in height."""
    if (preview := session.previews.get(job)) is None:
        return
    width = min(
        imgui.get_content_region_avail().x, _HIGHEST_PREVIEW_EM * imgui.get_font_size() * preview.width / preview.height
    )
    imgui.image(imgui.ImTextureRef(preview.name), ImVec2(width, width * preview.height / preview.width))
    imgui.set_item_tooltip("What the job has just made.")


# Log panel

_COLORS = {logging.ERROR: ImVec4(0.95, 0.45, 0.38, 1.0), logging.WARNING: ImVec4(0.9, 0.62, 0.2, 1.0)}
_LEVELS = {"all": logging.INFO, "warnings": logging.WARNING, "errors": logging.ERROR}


class _LogFilter:
    level = "all"
    words = ""


def log_panel(session: Editor) -> None:
    imgui.set_next_item_width(7 * imgui.get_font_size())
    names = list(_LEVELS)
    changed, picked = imgui.combo("##level", names.index(_LogFilter.level), names)
    if changed:
        _LogFilter.level = names[picked]
    imgui.set_item_tooltip("Show everything, or only what may be wrong.")
    imgui.same_line()
    copy_width = imgui.calc_text_size("Copy").x + 4 * imgui.get_style().frame_padding.x
    imgui.set_next_item_width(-copy_width)
    _, _LogFilter.words = imgui.input_text_with_hint("##words", "words", _LogFilter.words)
    imgui.set_item_tooltip("Show only lines with these words.")
    shown = [line for line in session.log.lines if _passes_filter(line)]
    imgui.same_line()
    if imgui.button("Copy"):
        imgui.set_clipboard_text("\n".join(f"{line.at:%H:%M:%S} {line.text}\n{line.details}".strip() for line in shown))
    imgui.set_item_tooltip("Put these lines on the clipboard, with their details.")
    if imgui.begin_child("lines", ImVec2(0, 0)):
        for number, line in enumerate(shown):
            _line(line, number)
        if not shown:
            imgui.text_disabled("Nothing was said so." if session.log.lines else "Nothing has been said yet.")
        if imgui.get_scroll_y() >= imgui.get_scroll_max_y():
            imgui.set_scroll_here_y(1.0)
    imgui.end_child()


def _passes_filter(line: LogLine) -> bool:
    text = f"{line.text} {line.details}".lower()
    return line.level >= _LEVELS[_LogFilter.level] and all(word in text for word in _LogFilter.words.lower().split())


def _line(line: LogLine, number: int) -> None:
    imgui.text_disabled(f"{line.at:%H:%M:%S}")
    imgui.same_line()
    color = next((color for level, color in _COLORS.items() if line.level >= level), None)
    imgui.push_text_wrap_pos(0.0)
    if color is not None:
        imgui.text_colored(color, line.text)
    else:
        imgui.text_unformatted(line.text)
    imgui.pop_text_wrap_pos()
    if line.details and imgui.tree_node(f"Details##{number}"):
        imgui.text_unformatted(line.details)
        imgui.tree_pop()


# Statistics panel


def statistics_panel(session: Editor) -> None:
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

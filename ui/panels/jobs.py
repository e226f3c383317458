"""Jobs panel and Log panel."""

import logging
import webbrowser
from typing import Any

from imgui_bundle import ImVec2, imgui

from gsrain_engine.editor.jobs.job import Job, JobRunner
from gsrain_engine.editor.status import LogLine, StatusBus
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.scene.progress import duration_text, figure_text

from ..widgets.desktop import open_in_desktop
from ..widgets.draw import line, plot
from ..widgets.fields import button, combo, error_color, faint, same_line_if_fits, warn, warning_color
from ..widgets.text import shortened, visible_name


def jobs_panel(viewport: ViewportState, jobs: JobRunner) -> None:
    """Draw all jobs, the newest first, so that what a running one reports moves no button of those that wait."""
    if not jobs.all:
        imgui.text_wrapped("No background jobs. The panels Wet look, Capture, Drive and Record start jobs.")
    ended = [each for each in reversed(jobs.all) if not each.is_pending]
    for job in [*reversed(jobs.waiting), *reversed(jobs.running), *ended]:
        imgui.separator_text(job.title)
        job_fields(viewport, jobs, job)
    if ended and button("Clear", "Take the jobs that have ended off the list; their results stay."):
        jobs.clear()


# One job: progress, preview, cancel button and result

_MAX_PREVIEW_EM = 9.0


def job_fields(viewport: ViewportState, jobs: JobRunner, job: Job[Any]) -> None:
    """Draw a job: progress, metrics and warning, the cancel button, or its result."""
    number = jobs.all.index(job)
    if job.state == "queued":
        place = jobs.waiting.index(job) + 1
        imgui.text_wrapped("Waits; it is the next." if place == 1 else f"Waits; it is number {place}.")
        if place > 1:
            if button(f"Run next##{number}", "Run it before the others that wait."):
                job.run_next()
            imgui.same_line()
        if button(f"Run now##{number}", "Begin it at once, next to the job that runs; both take longer meanwhile."):
            job.run_now()
        same_line_if_fits("Cancel")
        if button(f"Cancel##{number}", "Take it out of the queue.", width=-1):
            job.cancel()
    elif job.state == "running":
        imgui.progress_bar(job.progress.fraction, (-1, 0), f"{100 * job.progress.fraction:.0f} %")
        help_text = "Stop the job; the scene does not change, and a video recorded so far can be played."
        if button(f"Cancel##{number}", help_text, width=-1):
            job.cancel()
        imgui.text_wrapped(job.progress.message)
        faint(job.progress.note)
        if viewport.playback.clock.playing and not job.in_thread:
            faint("It shares the processor with the view; pause that (Space), and it is faster.")
        _metrics(job)
        warn(job.progress.warning)
        if (preview := viewport.job_previews.get(job)) is not None:
            aspect = preview.width / preview.height
            width = min(imgui.get_content_region_avail().x, _MAX_PREVIEW_EM * imgui.get_font_size() * aspect)
            imgui.image(imgui.ImTextureRef(preview.name), ImVec2(width, width / aspect))
            imgui.set_item_tooltip("Latest result of the job.")
    elif job.state == "failed":
        imgui.text_colored(warning_color(), "Failed")
        imgui.text_wrapped(job.error or "")
        if job.details and imgui.tree_node(f"Traceback##{number}"):
            imgui.text_unformatted(job.details)
            imgui.tree_pop()
    else:
        imgui.text_wrapped(job.progress.message if job.state == "finished" else "Canceled")
        faint(job.progress.note)
        _metrics(job)
        warn(job.progress.warning)
        if job.has_output:
            imgui.push_id(number)
            output_buttons(job)
            imgui.pop_id()
        if job.state == "finished" and job.report is not None:
            help_text = f"Show metrics, views and timings in a browser: {job.report}"
            if button(f"Report##{number}", help_text, width=-1):
                webbrowser.open(job.report.as_uri())


def output_buttons(job: Job[Any]) -> None:
    """Draw the buttons that lead to the file or folder that a job has written."""
    assert job.output is not None
    if button("Open file###open output", str(job.output)):
        open_in_desktop(job.output)
    same_line_if_fits("Show in folder")
    if button("Show in folder###show output", str(job.output.parent)):
        open_in_desktop(job.output.parent)


def _metrics(job: Job[Any]) -> None:
    """Draw the job's plots, and the other metrics of its latest step as numbers."""
    plotted = {name for names in job.plots.values() for name in names}
    figures = job.progress.metrics.items()
    numbers = [figure_text(name, value) for name, value in figures if name not in plotted | {"step"}]
    if numbers:
        imgui.text_wrapped(", ".join(numbers))
    series = {name: number for number, name in enumerate(name for names in job.plots.values() for name in names)}
    for title, names in job.plots.items():
        curves = {name: job.curves.curve(name) for name in names}
        if all(curve.shape[1] < 2 for curve in curves.values()):
            continue
        with plot(title, "step", "", legend=len(curves) > 1) as is_visible:
            for name, (steps, values) in curves.items() if is_visible else ():
                line(name.replace("_", ", "), steps, values, series[name])


# Tray in the status bar

_TRAY_EM, _BAR_EM = 27.0, 12.0


def tray_width(jobs: JobRunner) -> float:
    """Width of the tray in pixels; 0 without jobs. It is constant while one runs, so that Cancel does not move."""
    return _TRAY_EM * imgui.get_font_size() if jobs.pending else 0.0


def job_tray(viewport: ViewportState, jobs: JobRunner) -> None:
    """Draw progress, time left and Cancel of the running job; a click on its bar lists all jobs."""
    em = imgui.get_font_size()
    start = imgui.get_cursor_pos_x()
    if jobs.pending:
        job = jobs.running[-1] if jobs.running else jobs.pending[0]
        others = len(jobs.running) - 1, len(jobs.waiting)
        opens = imgui.invisible_button("###list jobs", ImVec2(_BAR_EM * em, imgui.get_text_line_height()))
        imgui.set_item_tooltip(f"{job.title}: {job.progress.message}\nClick: all jobs.")
        words = f"{100 * job.progress.fraction:.0f} %  {job.title}"
        counts = [f"{count} {state}" for count, state in zip(others, ("more", "waiting"), strict=True) if count > 0]
        _fill_bar(job.progress.fraction, ", ".join([*counts, words]))
        imgui.same_line()
        left_s = job.remaining_s
        imgui.text_disabled("" if left_s is None else f"{duration_text(left_s)} left")
        imgui.same_line(start + (_BAR_EM + 8.0) * em)
        imgui.push_id(jobs.all.index(job))  # a press on Cancel does not cancel the job that follows before its release
        if imgui.small_button("Cancel###cancel job"):
            job.cancel()
        imgui.set_item_tooltip(f"Stop {job.title}; the scene does not change.")
        imgui.pop_id()
        if opens:
            imgui.open_popup("jobs")
    if imgui.begin_popup("jobs"):
        if imgui.begin_child("all jobs", ImVec2(24 * em, 20 * em)):
            jobs_panel(viewport, jobs)
        imgui.end_child()
        imgui.end_popup()


def _fill_bar(fraction: float, words: str) -> None:
    """Paint the last item as a progress bar; a widget of that kind would move the rest of the line down."""
    low, high, draw = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_window_draw_list()
    background, bar, text = map(imgui.get_color_u32, (imgui.Col_.frame_bg, imgui.Col_.plot_histogram, imgui.Col_.text))
    draw.add_rect_filled(low, high, background)
    draw.add_rect_filled(low, ImVec2(low.x + fraction * (high.x - low.x), high.y), bar)
    margin = 0.4 * imgui.get_font_size()
    draw.add_text(ImVec2(low.x + margin, low.y), text, shortened(visible_name(words), high.x - low.x - 2 * margin))


# Log panel

_COLORS = {logging.ERROR: error_color, logging.WARNING: warning_color}
_LEVELS = {logging.INFO: "all", logging.WARNING: "warnings", logging.ERROR: "errors"}


class _LogFilter:
    level = logging.INFO
    words = ""


def log_panel(status: StatusBus) -> None:
    imgui.set_next_item_width(7 * imgui.get_font_size())
    _LogFilter.level = combo("##level", _LogFilter.level, _LEVELS, "Show all lines, or only warnings and errors.")
    imgui.same_line()
    imgui.set_next_item_width(-imgui.calc_text_size("Copy").x - 4 * imgui.get_style().frame_padding.x)
    _, _LogFilter.words = imgui.input_text_with_hint("##words", "words", _LogFilter.words)
    imgui.set_item_tooltip("Show only lines with these words.")
    lines = [line for line in status.log.lines if _passes_filter(line)]
    imgui.same_line()
    if button("Copy", "Copy these lines to the clipboard, with their details."):
        imgui.set_clipboard_text("\n".join(f"{line.at:%H:%M:%S} {line.text}\n{line.details}".strip() for line in lines))
    if imgui.begin_child("lines", ImVec2(0, 0)):
        for number, line in enumerate(lines):
            _line(line, number)
        if not lines:
            imgui.text_disabled("No line matches." if status.log.lines else "No messages yet.")
        if imgui.get_scroll_y() >= imgui.get_scroll_max_y():
            imgui.set_scroll_here_y(1.0)
    imgui.end_child()


def _passes_filter(line: LogLine) -> bool:
    text = f"{line.text} {line.details}".lower()
    return line.level >= _LogFilter.level and all(word in text for word in _LogFilter.words.lower().split())


def _line(line: LogLine, number: int) -> None:
    imgui.text_disabled(f"{line.at:%H:%M:%S}")
    imgui.same_line()
    color = next((color for level, color in _COLORS.items() if line.level >= level), None)
    imgui.push_text_wrap_pos(0.0)
    if color is not None:
        imgui.text_colored(color(), line.text)
    else:
        imgui.text_unformatted(line.text)
    imgui.pop_text_wrap_pos()
    if line.details and imgui.tree_node(f"Details##{number}"):
        imgui.text_unformatted(line.details)
        imgui.tree_pop()

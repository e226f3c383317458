"""Notices over the viewport: work that it waits for, the last error, and jobs that have ended."""

import webbrowser
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gsrain_engine.compile_cache import kernel_names
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import Job, JobRunner
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.scene.progress import duration_text

from ..folding import show_panel
from ..panels.jobs import output_buttons
from ..widgets.fields import button
from ..widgets.text import visible_name

_WIDTH_EM, _MIN_WIDTH_EM = 34.0, 22.0
_MARGIN = 10.0
_MAX_ENDED = 3
_PREPARING = "Until then it does not rain. It takes a minute or two on an idle computer, and longer on a busy one."


def draw_notices(editor: Editor, corner: ImVec2, tools: float, taken: ImVec2, width: int, height: int) -> None:
    """Draw all notices: an animated bar in the middle; in the lower right corner the preparation, error, ended jobs.

    The tools, whose right edge is `tools`, and a card in the lower left corner, whose right edge and height are
    `taken`, stay free.
    """
    em = imgui.get_font_size()
    if editor.busy is not None:
        wide = min(_WIDTH_EM * em, width - 2 * _MARGIN)
        imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.4 * height))
        _draw_busy("busy", editor.busy, wide, editor.viewport.kernels if editor.busy == editor.preparing else None)
    is_narrow = width - taken.x - 2 * _MARGIN < _MIN_WIDTH_EM * em  # no room next to the card
    wide = min(_WIDTH_EM * em, width - 2 * _MARGIN - max(tools, 0.0 if is_narrow else taken.x))
    left = corner.x + width - wide - _MARGIN
    bottom = corner.y + height - _MARGIN - (taken.y if is_narrow else 0.0)
    if editor.viewport.is_preparing and editor.busy != editor.preparing:
        words = f"{editor.preparing}. {_PREPARING}"
        bottom -= _height(words, wide)
        imgui.set_cursor_screen_pos(ImVec2(left, bottom))
        _draw_busy("preparing", words, wide, editor.viewport.kernels)
        bottom -= _MARGIN
    if editor.status.problem is not None:
        bottom -= _height(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}  {editor.status.problem}", wide)
        imgui.set_cursor_screen_pos(ImVec2(left, bottom))
        _draw_problem(editor.status, editor.status.problem, wide)
        bottom -= _MARGIN
    for job in editor.jobs.notices[:_MAX_ENDED]:
        bottom -= _height(_result(job), wide)
        imgui.set_cursor_screen_pos(ImVec2(left, bottom))
        _draw_ended(editor.jobs, job, wide)
        bottom -= _MARGIN


def _height(words: str, wide: float) -> float:
    """Height of a notice of a text and a row of buttons."""
    padding = imgui.get_style().window_padding
    text_height = imgui.calc_text_size(words, False, wide - 2 * padding.x).y
    return text_height + 2 * padding.y + imgui.get_frame_height_with_spacing()


def _draw_busy(name: str, words: str, wide: float, kernels: int | None) -> None:
    """Draw a text over a bar: of the kernels that are compiled, or one that moves."""
    with card(name, wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders):
        imgui.text_wrapped(words)
        imgui.progress_bar(-imgui.get_time() if kernels is None else kernels / len(kernel_names()), ImVec2(-1, 0), "")


def _draw_problem(status: StatusBus, problem: str, wide: float) -> None:
    with card("problem", wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders):
        imgui.push_style_color(imgui.Col_.text, (0.95, 0.45, 0.38, 1.0))
        imgui.text_wrapped(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}  {problem}")
        imgui.pop_style_color()
        if imgui.button("Close"):
            status.dismiss()
        imgui.same_line()
        if button("Details", "Show the log, which has the rest."):
            show_panel("Log")
        imgui.same_line()
        if button("Copy", "Put the sentence on the clipboard."):
            imgui.set_clipboard_text(problem)


def _result(job: Job[Any]) -> str:
    if job.state == "cancelled":
        return f"{icons.ICON_FA_STOP}  {visible_name(f'{job.title}: canceled; what was written until then is there')}"
    return f"{icons.ICON_FA_CHECK}  {visible_name(f'{job.title}: {job.progress.message}')}"


def _draw_ended(jobs: JobRunner, job: Job[Any], wide: float) -> None:
    """Draw the result of a job, and what can be done with it."""
    with card(f"ended {jobs.all.index(job)}", wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders):
        imgui.text_wrapped(_result(job))
        imgui.set_item_tooltip(f"After {duration_text(job.seconds)}.")
        if imgui.button("Close###dismiss"):
            job.is_noticed = True
        if job.has_output:
            imgui.same_line()
            output_buttons(job)
        if job.report is not None:
            imgui.same_line()
            if button("Report###show report", f"Show metrics, views and timings in a browser: {job.report}"):
                webbrowser.open(job.report.as_uri())


@contextmanager
def card(
    name: str, width: float, background: imgui.Col_, opacity: float, flags: imgui.ChildFlags_ | int = 0
) -> Generator[None]:
    """Begin a card over the viewport that is as tall as its content."""
    color = imgui.get_style_color_vec4(background)
    imgui.push_style_color(imgui.Col_.child_bg, (color.x, color.y, color.z, opacity))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags |= imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    imgui.begin_child(name, ImVec2(width, 0), flags)
    yield
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()

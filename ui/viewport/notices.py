"""Notices over the viewport, in one corner: the last error, work that it waits for, and jobs that have ended."""

import math
import webbrowser
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gsrain_engine.compile_cache import kernel_names
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.scene.progress import duration_text

from ..folding import show_panel
from ..panels.jobs import output_buttons
from ..widgets.draw import EDGE_MARGIN, Canvas
from ..widgets.fields import button, error_color, same_line_if_fits
from ..widgets.text import visible_name

_WIDTH_EM = 34.0
_MIN_WIDTH_EM = 22.0
_PREPARING = "Until then it does not rain. It takes a minute or two on an idle computer, and longer on a busy one."


class _Notice(NamedTuple):
    """A card of a text, and a row of buttons or a bar below it."""

    name: str
    words: str
    draw: Callable[[], None]


def notice_room(editor: Editor) -> tuple[float, float]:
    """Return the width and height in pixels that notices need next to other cards and lines; 0 if there are none."""
    if not _queue(editor):
        return 0.0, 0.0
    return _MIN_WIDTH_EM * imgui.get_font_size(), 2 * imgui.get_frame_height() + EDGE_MARGIN


def _queue(editor: Editor) -> list[_Notice]:
    """Return what there is to tell, the most urgent first: an error, work that the view waits for, ended jobs."""
    viewport, status, queue = editor.viewport, editor.status, list[_Notice]()
    if status.problem is not None:
        words = f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}  {status.problem}"
        queue.append(_Notice("problem", words, partial(_draw_problem, status, status.problem, words)))
    kernels = viewport.kernels if editor.busy == editor.preparing else None
    if editor.busy is not None and not editor.awaits_first_picture:
        queue.append(_Notice("busy", editor.busy, partial(_draw_busy, editor.busy, kernels)))
    if viewport.is_preparing and editor.busy != editor.preparing:
        words = f"{editor.preparing}. {_PREPARING}"
        queue.append(_Notice("preparing", words, partial(_draw_busy, words, viewport.kernels)))
    for job in editor.jobs.notices:
        name = f"ended {editor.jobs.all.index(job)}"
        queue.append(_Notice(name, _result(job), partial(_draw_ended, job)))
    return queue


def draw_notices(editor: Editor, canvas: Canvas) -> None:
    """Draw the queue of notices in the lower right corner: those that have room, of which the first one may scroll.

    Where they reach into the left half of the view, the first stays in the lower half, the others in the lower third.
    While there is no picture, the work that it waits for is in the middle.
    """
    edges, em = canvas.edges, imgui.get_font_size()
    if editor.busy is not None and editor.awaits_first_picture:
        wide = min(_WIDTH_EM * em, canvas.width - 2 * EDGE_MARGIN)
        tall = _height(editor.busy, wide)
        imgui.set_cursor_screen_pos(canvas.on_screen((canvas.width - wide) / 2, canvas.height / 2 - tall))
        with card("busy", wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders):
            _draw_busy(editor.busy, editor.viewport.kernels if editor.busy == editor.preparing else None)
    wide = min(_WIDTH_EM * em, canvas.width - 2 * EDGE_MARGIN - edges.left)
    left, bottom = canvas.width - wide - EDGE_MARGIN, canvas.height - edges.bottom - EDGE_MARGIN
    height = 0.0 if left > canvas.width / 2 + EDGE_MARGIN else canvas.height
    top = EDGE_MARGIN + max(edges.top, height / 2)
    for number, each in enumerate(_queue(editor)):
        tall = _height(each.words, wide)
        if number > 0 and tall > bottom - max(top, height * 2 / 3):
            break
        tall = min(tall, max(bottom - top, 1.0))
        imgui.set_cursor_screen_pos(canvas.on_screen(left, bottom - tall))
        with card(each.name, wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders, max_height=tall):
            each.draw()
        bottom -= tall + EDGE_MARGIN


def _height(words: str, wide: float) -> float:
    """Height of a notice of a text and a row of buttons."""
    padding = imgui.get_style().window_padding
    text_height = imgui.calc_text_size(words, False, wide - 2 * padding.x).y
    return text_height + 2 * padding.y + imgui.get_frame_height_with_spacing()


def _draw_busy(words: str, kernels: int | None) -> None:
    """Draw a text over a bar: of the kernels that are compiled, or one that moves."""
    imgui.text_wrapped(words)
    imgui.progress_bar(-imgui.get_time() if kernels is None else kernels / len(kernel_names()), ImVec2(-1, 0), "")


def _draw_problem(status: StatusBus, problem: str, words: str) -> None:
    imgui.push_style_color(imgui.Col_.text, error_color())
    imgui.text_wrapped(words)
    imgui.pop_style_color()
    if imgui.button("Close"):
        status.dismiss()
    same_line_if_fits("Details")
    if button("Details", "Show the log, which has the rest."):
        show_panel("Log")
    same_line_if_fits("Copy")
    if button("Copy", "Put the sentence on the clipboard."):
        imgui.set_clipboard_text(problem)


def _result(job: Job[Any]) -> str:
    if job.state == "cancelled":
        return f"{icons.ICON_FA_STOP}  {visible_name(f'{job.title}: canceled; what was written until then is there')}"
    return f"{icons.ICON_FA_CHECK}  {visible_name(f'{job.title}: {job.progress.message}')}"


def _draw_ended(job: Job[Any]) -> None:
    """Draw the result of a job, and what can be done with it."""
    imgui.text_wrapped(_result(job))
    imgui.set_item_tooltip(f"After {duration_text(job.seconds)}.")
    if imgui.button("Close###dismiss"):
        job.is_noticed = True
    if job.has_output:
        same_line_if_fits("Open file")
        output_buttons(job)
    if job.report is not None:
        same_line_if_fits("Report")
        if button("Report###show report", f"Show metrics, views and timings in a browser: {job.report}"):
            webbrowser.open(job.report.as_uri())


_UNLIMITED = 1e6


@contextmanager
def card(
    name: str,
    width: float,
    background: imgui.Col_,
    opacity: float,
    flags: imgui.ChildFlags_ | int = 0,
    *,
    window_flags: int = 0,
    max_height: float = math.inf,
) -> Generator[None]:
    """Begin a card over the viewport that is as tall as its content; it scrolls if that is more than `max_height`."""
    color = imgui.get_style_color_vec4(background)
    imgui.push_style_color(imgui.Col_.child_bg, (color.x, color.y, color.z, opacity))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags |= imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if max_height < math.inf:
        imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(_UNLIMITED, max_height))
    imgui.begin_child(name, ImVec2(width, 0), flags, window_flags)
    yield
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()

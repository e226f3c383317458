"""Nothing in the window lies on anything else: notices, cards, dialogs and tooltips, in windows of any size."""

import pytest
from msgspec.structs import replace

from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.editor.status import Answer, Question
from gsrain_engine.scene.progress import Progress
from gsrain_engine.simulation.rollout_io import write_rollout
from small_rollout import ego, rollout, step
from ui.tools import TOOLS
from ui.widgets.file_dialogs import ask_what_to_open
from window_driver import imgui
from window_walk import Rect, meetings, resize, screen, windows

SIZES = {
    1.0: (((420, 300), 1.0), ((420, 300), 1.5), ((1366, 768), 1.5), ((1366, 768), 0.8), ((1600, 1000), 1.0),
          ((1920, 1080), 1.5)),
    2.0: (((420, 300), 0.8), ((1366, 768), 1.0), ((1600, 1000), 1.5), ((1920, 1080), 0.8)),
}  # fmt: skip
"""By the scale of the screen: sizes of the window in points, and of its text. All pairs of two of them are there."""
PROBLEM = "own.ply: property opacity is missing, which each Gaussian needs: the file was not opened"
AT_POINTS = {"ego"}
"""Words at points of the scene, over which a card may lie."""


@pytest.fixture(params=SIZES)
def driver(unopened, request):
    unopened.dpi_scale = request.param
    return unopened


@pytest.fixture
def sizes(driver):
    """Give the window its sizes, one after another; the name of each."""

    def change():
        for size_px, font_scale in SIZES[driver.dpi_scale]:
            resize(driver, size_px, font_scale)
            yield f"{size_px}, text {font_scale:.0%}"

    return change


def work(*_):
    yield Progress(1.0, "12.4 mm/h, 1,200 frames")


def crowd(driver, folder):
    """Let the view show all that it can show at once."""
    editor = driver.editor
    editor.preferences.value = replace(editor.preferences.value, hint=True)
    write_rollout(folder / "alone.jsonl", rollout([step(each, ego(2.0 * each)) for each in range(5)]))
    editor.rollouts.open(folder / "alone.jsonl")
    driver.until(lambda: editor.rollouts.playing is not None and not editor.rollouts.is_working)
    editor.playback.clock.playing = False
    editor.scene_setup.is_open = editor.viewport.options.orthographic = True  # with its scale bar
    editor.status.report(PROBLEM)
    for title in ("Calibrate by spectra of an own disdrometer", "Measure rain"):
        editor.jobs.start(Job("calibration", title, work, in_thread=True), lambda *_: None)
    driver.until(lambda: not editor.jobs.pending)


def test_nothing_over_the_view_lies_on_anything_else_or_on_its_middle(driver, sizes, cut, lines, tmp_path):
    crowd(driver, tmp_path)
    found, options, most = {}, driver.editor.viewport.options, set()
    for number, size in enumerate(sizes()):
        tools = TOOLS if number == 0 else TOOLS[number :: len(SIZES[1.0])]
        for tool in ("", *(each.name for each in tools)):
            options.tool = tool
            driver.frames(2)
            cut.clear()
            driver.frames(1)
            rects = windows("View") | {words: rect for words, rect in lines.items() if words not in AT_POINTS}
            most |= set(rects)
            corner, extent = driver.area()
            view, (x, y) = Rect(*corner, *(corner + extent)), corner + extent / 2
            middle = Rect(x - 5, y - 5, x + 5, y + 5)
            strip = rects.pop("folded panels", Rect(view.right, view.top, view.right, view.bottom))
            wrong = meetings(rects), {each for each in cut if each[0] != "StatusBar"}  # which has a tooltip
            wrong += ({name for name, rect in rects.items() if rect.meets(middle)},)
            wrong += ({name for name, rect in rects.items() if not view.holds(rect) or rect.meets(strip)},)
            wrong += (unreachable("View"),)
            found |= {(size, tool): wrong} if any(wrong) else {}
    assert found == {}
    assert {"hint", "problem", "ended 1", "set-up", "tool options", "tools"} <= most
    assert any(words.startswith("0.00 s") for words in most) and any(words.endswith(" m") for words in most)


def ask(driver):
    answers = [Answer(f"{each} and end what is running") for each in ("Save", "Discard")]
    progress = Progress(0.4, "Reconstructing")
    question = Question("Quit?", "There are unsaved changes. " * 4, (*answers, Answer("Cancel")), lambda: progress)
    driver.editor.status.ask(question)


def page(name):
    return lambda driver: setattr(driver.editor.viewport.options, "dialog", name)


DIALOGS = {
    "About GSRAIN": page("about"), "What's new": page("news"), "Keyboard and mouse": page("keys"),
    "Save view": page("save view"), "Find a command": page("commands"), "Quit?": ask,
    "Guide": lambda driver: setattr(driver.editor.viewport.options, "guide", "rain.md"),
    "Open a scene": lambda _: ask_what_to_open("Open a scene", "Scenes{.ply,.spz,.sog},All files{.*}", print),
}  # fmt: skip


def unreachable(title):
    """Windows of a dialog or panel with content that is neither visible nor to be scrolled to."""
    found = set()
    for each in imgui.get_current_context().windows:
        if each.active and not each.hidden and each.name.partition("/")[0] in (title, f"##Popup_{title}"):
            is_wide = each.scroll_max.x > 1 and not each.scrollbar_x
            if is_wide or (each.scroll_max.y > 1 and not each.scrollbar_y):
                found.add(each.name)
    return found


def test_dialogs_fit_into_the_window_or_scroll(driver, sizes, cut, tmp_path):
    lately = [tmp_path / f"recordings_of_the_evening_drive_through_the_old_town_{number}" for number in range(6)]
    for folder in lately:
        folder.mkdir()
    driver.editor.files.recent = [folder / "scene.ply" for folder in lately]
    found, options = {}, driver.editor.viewport.options
    for size in sizes():
        for title, show in DIALOGS.items():
            show(driver)
            driver.ctx.yield_(4)
            cut.clear()
            driver.ctx.yield_()
            rect = next((each for name, each in windows().items() if name == title), None) or popup()
            there = {each for each in cut if each[0].partition("/")[0] not in ("StatusBar", "View")}
            wrong = not screen().holds(rect), unreachable(title), there
            found |= {(size, title): (rect, *wrong)} if any(wrong) else {}
            driver.ctx.key_press(imgui.Key.escape)
            options.guide = options.dialog = ""
            driver.ctx.yield_(3)
            assert driver.editor.status.question is None and not driver.is_open(title)
    assert found == {}


def popup():
    """Rectangle of the popup that is open."""
    return next(rect for name, rect in windows().items() if name.startswith("##Popup_"))


def tooltip():
    """Rectangle of the tooltip, None while there is none."""
    return next((rect for name, rect in windows().items() if name.startswith("##Tooltip_")), None)


def test_tooltips_lie_in_the_window_and_leave_their_item_and_the_next_row_free(driver, sizes):
    imgui.get_style().hover_stationary_delay = imgui.get_style().hover_delay_short = 0.0
    found = {}
    for size in sizes():
        for item in ("//View/###Play", "//View/###Screenshot", "//Rain/Shelter under roofs", "palette"):
            if item.startswith("//Rain"):
                item = f"{driver.panel('Rain')}Shelter under roofs"
            elif item == "palette":
                driver.editor.viewport.options.dialog = "commands"
                driver.ctx.yield_(4)
                driver.ctx.key_chars("tool: transform")
                driver.ctx.yield_(3)
                item = "//**/Tool: Transform##0"
            driver.ctx.mouse_move(item)
            driver.until(lambda: tooltip() is not None)
            driver.ctx.yield_(2)
            low, extent = driver.area(item)
            below = extent[1] + imgui.get_style().item_spacing.y
            rows = Rect(*low, low[0] + extent[0], low[1] + extent[1] + below)
            if rows.meets(tooltip()) or not screen().holds(tooltip()):
                found[size, item] = rows, tooltip()
        driver.ctx.key_press(imgui.Key.escape)
        driver.window.workspace.folded.open = ""
    assert found == {}

"""Journeys through the window, each in the number of actions that it states, on small and large screens of two scales.

An action is a click, a double click, a drag, a key with those held meanwhile, or a typed value with Enter. By default
all are played on the smallest screen, and those that depend on sizes and places on the one with the most pixels; all on
all four with GSRAIN_JOURNEYS=all.
"""

import functools
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.editor.selection.candidates import selected_count
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from measured_rain import measured_rain
from small_scene import small_scene
from ui.commands.keys import chord
from window_driver import Driver, imgui

KEY = imgui.Key
CTRL = KEY.mod_ctrl
SCREENS = {
    "800x560": ((800, 560), 1.0), "800x560 at DPI 2": ((800, 560), 2.0),
    "2560x1440": ((2560, 1440), 1.0), "2560x1440 at DPI 2": ((1280, 720), 2.0),
}  # fmt: skip
"""Size of the window in units of the interface, and pixels per unit."""

SMALLEST, LARGEST = "800x560", "2560x1440 at DPI 2"


@dataclass(frozen=True)
class Journey:
    """Actions that reach a goal."""

    name: str
    play: Callable[[Driver], None]
    actions: int
    folded_actions: int
    """With the panels folded to a strip, as in a small window."""
    depends_on_size: bool
    """True if it drags over the picture, or needs room for a dialog or a list."""


JOURNEYS: list[Journey] = []


def journey(actions: int, *, folded: int | None = None, depends_on_size: bool = False):
    """Add a journey with the number of its actions."""

    def add(play: Callable[[Driver], None]) -> Callable[[Driver], None]:
        name = play.__name__.replace("_", " ")
        JOURNEYS.append(Journey(name, play, actions, actions if folded is None else folded, depends_on_size))
        return play

    return add


def key(driver, *keys):
    """Press keys over the picture."""
    driver.point_at(driver.at(0.6, 0.6))
    driver.press(chord(*keys))


def rain_mm_h(driver):
    return driver.editor.document.rain.intensity_mm_h


# Open, save, leave


@journey(6, folded=7)
def quit_with_changes_cancelled(driver):
    editor = driver.editor
    driver.tap(f"{driver.panel('Rain')}8.5")
    key(driver, CTRL, KEY.q)
    driver.frames(3)
    driver.tap("//Unsaved changes/Cancel")
    driver.press(chord(CTRL, KEY.q))
    driver.frames(3)
    driver.tap("//Unsaved changes/Save")  # the scene has no place yet
    driver.press(KEY.escape)  # the dialog that asks for one
    driver.frames(3)
    assert not driver.is_open("Save the scene") and editor.status.question is None
    assert rain_mm_h(driver) == 8.5 and editor.files.has_changes and not editor.should_quit


@journey(2, depends_on_size=True)
def open_a_scene(driver):
    editor = driver.editor
    editor.files.close_scene()
    driver.until(lambda: not editor.document.scene.members and editor.busy is None)
    driver.frames(3)
    driver.tap("//**/###Open...")  # of the start card
    driver.choose_file("Open a scene", driver.folder / "crossing")
    driver.until(lambda: editor.document.scene.name == "crossing" and editor.busy is None)


@journey(4, folded=5)
def rain_saved_and_changed_and_saved(driver):
    editor, home = driver.editor, driver.folder / "rainy"
    driver.tap(f"{driver.panel('Rain')}8.5")
    assert driver.window.workspace.title.endswith(" *")
    key(driver, CTRL, KEY.mod_shift, KEY.s)
    driver.choose_file("Save the scene", home)
    driver.until(lambda: not editor.files.has_changes and editor.busy is None)
    assert read_scene(home).rain["intensity_mm_h"] == 8.5 and not driver.window.workspace.title.endswith("*")
    editor.document.change_rain("Intensity", intensity_mm_h=12.0)
    key(driver, CTRL, KEY.s)
    driver.until(lambda: not editor.files.has_changes)
    assert read_scene(home).rain["intensity_mm_h"] == 12.0


@journey(5)
def an_export_over_a_file_cancelled(driver):
    file = driver.folder / "flat.ply"
    before = file.read_bytes()
    key(driver, CTRL, KEY.e)
    driver.press(KEY.escape)  # the dialog
    driver.frames(3)
    assert not driver.is_open("Export a file")
    driver.press(chord(CTRL, KEY.e))
    driver.choose_file("Export a file", file)
    driver.frames(3)
    driver.tap("//Export flat.ply/Cancel")
    assert driver.editor.status.question is None and file.read_bytes() == before


# Rain


@journey(1, folded=2)
def five_mm_h_by_the_panel(driver):
    driver.tap(f"{driver.panel('Rain')}5")
    assert rain_mm_h(driver) == 5


@journey(2)
def five_mm_h_by_the_menu(driver):
    driver.menu("Rain/Moderate 5 mm\\/h")
    assert rain_mm_h(driver) == 5


@journey(2)
def five_mm_h_by_the_palette(driver):
    key(driver, CTRL, KEY.p)
    driver.enter("moderate")
    assert rain_mm_h(driver) == 5


@journey(2, folded=3)
def forty_mm_h_typed(driver):
    field = f"{driver.panel('Rain')}##intensity_mm_h"
    driver.double_click(field)
    driver.enter("40")
    assert rain_mm_h(driver) == 40


@journey(2)
def a_shower_added(driver):
    driver.menu("Rain/Add passing shower")
    assert driver.editor.document.keyframes.is_keyed("intensity_mm_h")


@journey(3, folded=3)
def a_calibration_fitted(driver):
    lab = driver.editor.calibration
    driver.tap(f"{driver.panel('Calibration')}Fit to measurements...")
    driver.choose_file("Disdrometer files of one instrument", driver.folder / "rain.nc")
    driver.until(lambda: lab.fitted is not None)
    assert lab.error is None and lab.fitted.records_used > 10


@journey(2)
def rain_measured_by_a_disdrometer(driver):
    lab = driver.editor.calibration
    driver.editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    driver.tap(f"{driver.panel('Disdrometer')}Measure")
    driver.until(lambda: lab.counted is not None and lab.busy is None)
    assert abs(lab.counted.rate_mm_h - 8.5) < 4 * lab.counted.standard_error_mm_h


# Select, change, undo


@journey(4, depends_on_size=True)
def a_brushed_part_deleted_and_undone(driver):
    document = driver.editor.document
    before = document.scene.gaussian_count
    key(driver, KEY.n)
    driver.stroke(*(driver.at(x, 0.45) for x in (0.4, 0.5, 0.6)))
    chosen = selected_count(document.scene)
    driver.press(KEY.delete)
    assert before - document.scene.gaussian_count == chosen > 3
    driver.press(chord(CTRL, KEY.z))
    assert document.scene.gaussian_count == before


@journey(3)
def a_part_moved_to_a_layer_of_its_own(driver):
    scene = driver.editor.document.scene
    key(driver, KEY.b)
    driver.stroke(driver.at(0.3, 0.6), driver.at(0.7, 0.9))
    driver.press(chord(CTRL, KEY.j))
    now = driver.editor.document.scene
    assert len(now.layers) == len(scene.layers) + 1 and now.gaussian_count == scene.gaussian_count


@journey(3, folded=5, depends_on_size=True)
def a_layer_moved(driver):
    document, folded = driver.editor.document, driver.window.workspace.folded
    driver.tap(f"{driver.panel('Layers')}members/###layers wall")
    if folded.open:  # over the picture
        driver.tap("//**/###fold Layers")
    key(driver, KEY.t)
    start = driver.on_screen(np.array([40, 0, 4.5]))
    up = driver.on_screen(np.array([40, 0, 7.5])) - start
    place = start + 28 * driver.dpi_scale * up / np.linalg.norm(up)
    driver.stroke(place, *(place - [0, step] for step in (10, 20, 40)))
    assert document.history.undo_label == "Move wall" and document.scene.member("layers/wall").to_scene[2, 3] > 1


@journey(1, folded=2)
def a_layer_hidden(driver):
    driver.tap(f"{driver.panel('Layers')}members/###show layers wall")
    assert not driver.editor.document.scene.member("layers/wall").visible


@journey(5)
def a_known_length_sets_the_scale(driver):
    editor, here = driver.editor, driver.editor.viewport.navigation.position.copy()
    key(driver, KEY.m)
    for y in (-1.0, 1.0):
        driver.click_at(driver.on_screen([12.0, y, 0.0]))
    first, second = driver.tool("Measure").points_m
    driver.type_in("//View/**/##true length", 8.0)
    driver.tap("//View/**/Set scale")
    scale = editor.document.scene.metres_per_unit
    assert scale == pytest.approx(8 / np.linalg.norm(second - first))
    assert editor.viewport.navigation.position == pytest.approx(scale * here)  # the view stays


@journey(2)
def an_earlier_step_gone_to(driver):
    for rate in (1.2, 8.5, 12.0):
        driver.editor.document.change_rain(f"Preset {rate}", intensity_mm_h=rate)
    driver.tap(f"{driver.panel('History')}Preset 1.2##1")
    assert rain_mm_h(driver) == 1.2 and driver.editor.document.history.redo_label == "Preset 8.5"


# Look


@journey(3, depends_on_size=True)
def clear_and_rainy_compared(driver):
    options = driver.editor.viewport.options
    driver.editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    driver.choose("//View/##split", "clear | rainy")
    driver.drag("//View/divider", (-60, 0))
    assert options.split == "clear | rainy" and options.divider < 0.49


@journey(1)
def the_scene_from_above(driver):
    key(driver, KEY._7)
    assert driver.editor.viewport.shot(96, 64).camera.is_orthographic


@journey(4, folded=5, depends_on_size=True)
def a_flight_of_ten_seconds(driver):
    editor = driver.editor
    key(driver, KEY.k)
    driver.type_in(f"{driver.panel('Timeline')}**/##time", 10.0)
    driver.stroke(driver.at(0.5, 0.35), driver.at(0.6, 0.35), driver.at(0.65, 0.3))
    driver.press(KEY.k)
    assert editor.document.scene.path.times_s.tolist() == [0, 10]
    assert editor.render_queue.extent().length_s == pytest.approx(10, abs=0.05)


@journey(3, folded=3, depends_on_size=True)
def the_light_theme(driver):
    driver.choose(f"{driver.panel('Display')}##theme", "light")
    assert driver.editor.preferences.value.theme == "light"


@journey(2)
def a_time_gone_to(driver):
    key(driver, CTRL, KEY.g)
    driver.enter("2.5")
    assert driver.editor.playback.clock.time_s == 2.5


@journey(2)
def a_panel_found_by_the_palette(driver):
    key(driver, CTRL, KEY.p)
    driver.enter("panel: jobs")
    folded = driver.window.workspace.folded
    assert folded.open == "Jobs" or not driver.ctx.window_info("//Jobs").window.hidden


# Playing them


def begin(driver):
    """Put the window into its first state."""
    editor, options = driver.editor, driver.editor.viewport.options
    editor.document.go_to_step(0)
    editor.status.dismiss()
    editor.playback.clock.seek(0.0)
    options.tool, options.split, options.divider, options.member = "", "off", 0.5, ""
    options.follow_path = False
    editor.viewport.go_home()
    editor.preferences.value = replace(editor.preferences.value, theme="dark")
    driver.window.workspace.folded.open = ""
    if not driver.window.workspace.folded.hidden:
        for name in ("Layers", "Edit", "Rain", "Rain properties", "Timeline"):
            driver.ctx.window_focus(f"//{name}")
    driver.ctx.window_focus("//View")
    driver.frames(3)


def journeys_on(screen):
    """Journeys that are played on a screen."""
    if screen == SMALLEST or os.environ.get("GSRAIN_JOURNEYS") == "all":
        return JOURNEYS
    return [each for each in JOURNEYS if each.depends_on_size and screen == LARGEST]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Folder with a scene folder, a file of Gaussians and a disdrometer file."""
    folder = tmp_path_factory.mktemp("journeys")
    write_scene(small_scene("crossing"), folder / "crossing")
    write_scene(small_scene(), folder / "flat.ply")
    light = measured_rain(271.0, 9.705, 0.074, minutes=6, seed=1, area_m2=0.02)
    heavy = measured_rain(1190.0, 7.132, 0.114, minutes=6, seed=2, area_m2=0.02, start="2024-05-01T12:00")
    per_record = ("times", "seconds", "counts", "reported_mm_h")
    both = {name: np.concatenate([getattr(each, name) for each in (light, heavy)]) for name in per_record}
    write_spectra(folder / "rain.nc", with_fields(light, **both))
    return folder


@pytest.fixture(scope="module")
def play(files, tmp_path_factory):
    """Function that returns the errors of a screen's journeys by name; all are played at its first call."""
    return functools.cache(lambda screen: errors_on(screen, files, tmp_path_factory.mktemp("screen")))


def errors_on(screen, files, folder):
    """Play all journeys of a screen one after the other in one window; return their errors by name."""
    shutil.copytree(files, folder, dirs_exist_ok=True)
    driver, errors = Driver(folder), dict[str, Exception]()
    driver.size_px, driver.dpi_scale = SCREENS[screen]

    def script():
        is_folded = bool(driver.window.workspace.folded.hidden)
        journeys = journeys_on(screen)
        for number, each in enumerate(journeys):
            try:
                begin(driver)
                with driver.journey(each.folded_actions if is_folded else each.actions):
                    each.play(driver)
            except Exception as error:  # each is raised in the test of its journey
                errors[each.name] = error
            if driver.ctx.is_error():  # an item was not there: see the engine's log, which plays no more
                for after in journeys[number:]:
                    errors.setdefault(after.name, AssertionError(f"the test engine gave up in {each.name!r}"))
                return

    try:
        driver.run(script)
    except (AssertionError, RuntimeError) as log:  # of the engine, which names no journey
        if not errors:
            return dict.fromkeys((each.name for each in journeys_on(screen)), log)
        for error in errors.values():
            error.add_note(str(log)[-2000:])
    return errors


SCREENS_AND_NAMES = [(screen, each.name) for screen in SCREENS for each in journeys_on(screen)]


@pytest.mark.parametrize(("screen", "name"), SCREENS_AND_NAMES)
def test_journey(play, screen, name):
    if (error := play(screen).get(name)) is not None:
        raise error

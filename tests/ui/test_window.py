"""The real window under Xvfb: rain, time, navigation, files, two pictures, palette, layers and panels."""

import numpy as np
import pytest
from imgui_bundle import implot
from PIL import Image

from gsrain_engine.editor.viewport.options import BACKDROP_LEVELS
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene
from ui.commands.keys import chord, chord_name, chords_of
from ui.commands.table import COMMANDS, all_commands
from ui.panels.registry import BUILT_IN_PANELS
from ui.shell import MENUS
from ui.tools import TOOLS
from window_driver import imgui


def test_dragging_the_intensity_is_one_step_and_time_plays(driver):
    clear = driver.picture()
    driver.drag("//Rain/##intensity_mm_h", (60, 0))
    assert driver.editor.document.rain.intensity_mm_h > 1
    assert driver.editor.viewport.statistics["drops drawn"] > 0
    assert np.abs(driver.picture() - clear).max() > 4
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.z))
    assert driver.editor.document.rain.intensity_mm_h == 0
    assert np.array_equal(driver.picture(), clear)
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.y))
    history = driver.editor.document.history
    assert driver.editor.document.rain.intensity_mm_h > 1, (history.labels, history.cursor)
    still = driver.picture()
    assert np.array_equal(driver.picture(), still)
    driver.click("//View/###Play")
    driver.until(lambda: driver.editor.playback.clock.time_s > 0.05)
    driver.click("//View/###Play")
    assert not driver.editor.playback.clock.playing
    assert not np.array_equal(driver.picture(), still)


def test_navigation_by_mouse_and_keys(driver):
    viewport = driver.editor.viewport

    start = viewport.navigation.position.copy()
    driver.drag("//View/view", (80, 0))
    assert np.linalg.norm(viewport.navigation.position - start) > 0.5
    driver.click("//View/###Home")
    assert viewport.navigation.position == pytest.approx(start)
    driver.ctx.mouse_move("//View/view")
    driver.ctx.key_down(imgui.Key.w)
    driver.until(lambda: viewport.navigation.position[0] > start[0] + 0.1)
    assert viewport.navigation.velocity_m_s[0] > 1
    driver.ctx.key_up(imgui.Key.w)
    driver.frames()
    assert np.all(viewport.navigation.velocity_m_s == 0)
    driver.press(imgui.Key.f)
    assert viewport.navigation.distance_m > 20
    driver.press(imgui.Key.r)
    assert viewport.navigation.position == pytest.approx(start)
    driver.ctx.mouse_wheel_y(2)
    driver.frames()
    assert viewport.navigation.distance_m < 20
    before = viewport.navigation.position.copy()
    driver.ctx.mouse_wheel_x(2)  # what is looked at goes to the right, along -y
    driver.frames()
    assert viewport.navigation.position[1] > before[1] and viewport.navigation.position[0] == before[0]
    driver.click("//View/Follow path")
    assert viewport.options.follow_path


def test_a_key_shows_the_scene_from_above_to_scale_and_home_leads_back(driver):
    viewport = driver.editor.viewport
    driver.ctx.mouse_move("//View/view")
    driver.press(imgui.Key._7)
    assert viewport.picture_view.camera.is_orthographic and viewport.marks == ("scale",)
    scale = viewport.navigation.distance_m
    driver.ctx.mouse_wheel_y(2)
    driver.frames()
    assert viewport.navigation.distance_m < scale
    driver.panel("Display")
    driver.click("//Display/Grid")
    assert viewport.marks == ("grid", "scale")
    driver.ctx.mouse_move("//View/view")
    driver.press(imgui.Key.r)
    assert not viewport.options.orthographic


def test_files_open_by_drop_and_bad_ones_are_reported(driver, tmp_path):
    good, bad = tmp_path / "wall.ply", tmp_path / "bad.ply"
    write_scene(small_scene(), good)
    bad.write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    photograph = tmp_path / "photographs" / "a.png"
    photograph.parent.mkdir()
    for name in ("a.png", "b.png"):
        Image.new("RGB", (32, 24), "gray").save(photograph.with_name(name))

    first = driver.editor.document.scene
    driver.window.drop([str(bad)])
    driver.until(lambda: driver.editor.busy is None)
    assert driver.editor.document.scene is first
    assert any("bad.ply" in line.text for line in driver.editor.status.log.lines)
    driver.window.drop([str(good)])
    driver.until(lambda: driver.editor.busy is None)
    assert driver.editor.document.scene.name == "wall"
    driver.ctx.window_focus("//Log")
    driver.frames(3)
    driver.window.drop([str(photograph)])
    driver.until(lambda: driver.editor.status.question is not None)
    assert driver.editor.status.question.title == "Open capture"
    driver.press(imgui.Key.escape)
    assert driver.editor.viewport.backend in ("opengl-tiles", "opengl-quads", "cpu")


def test_two_pictures_beside_each_other_and_a_divider_between(driver):
    options = driver.editor.viewport.options
    driver.click("//Rain/8.5")
    driver.editor.document.change_rain("Much", streak_gain=50.0)
    driver.frames()
    rainy = driver.picture()
    options.split = "clear | rainy"
    driver.frames()
    both = driver.picture()
    middle = both.shape[1] // 2
    assert np.array_equal(both[:, middle + 1 :], rainy[:, middle + 1 :])
    assert np.abs(both[:, :middle] - rainy[:, :middle]).max() > 4
    driver.drag("//View/divider", (-120, 0))
    assert options.divider < 0.4
    moved = driver.picture()
    at = round(options.divider * moved.shape[1])
    assert np.array_equal(moved[:, at + 1 :], rainy[:, at + 1 :])
    assert np.array_equal(moved[:, : at - 1], both[:, : at - 1])
    driver.ctx.item_double_click("//View/divider")
    driver.frames()
    assert options.divider == 0.5
    options.split = "before | after"
    driver.frames()
    compared = driver.picture()
    assert np.abs(compared[:, :middle] - rainy[:, :middle]).max() > 4  # before: without the gain


def test_while_the_camera_moves_less_is_drawn_and_all_of_it_at_rest(driver):
    editor = driver.editor
    editor.viewport.budget.target_ms = 0.01  # no machine holds it
    driver.click("//View/###Home")
    driver.until(lambda: editor.viewport.detail.is_exact)
    exact = driver.picture()
    driver.ctx.mouse_move("//View/view")
    driver.ctx.key_down(imgui.Key.w)
    driver.until(lambda: str(editor.viewport.detail) == "1/8 of the Gaussians, 33% resolution")
    driver.ctx.key_up(imgui.Key.w)
    driver.until(lambda: editor.viewport.detail.is_exact)
    driver.click("//View/###Home")
    driver.until(lambda: editor.viewport.detail.is_exact)
    assert np.array_equal(driver.picture(), exact)


def test_the_display_panel_offers_no_frame_time_that_the_machine_cannot_keep(driver):
    budget = driver.editor.viewport.budget
    field = f"{driver.panel('Display')}##target_ms"
    driver.type_in(field, 20.0)
    assert budget.target_ms == 20.0
    for _ in range(5):
        budget.measured(BACKDROP_LEVELS[-1], 1.5 * 91.0)  # such pictures may take half as long again
    driver.frames()
    assert budget.target_ms == 20.0  # still asked for: another scene may keep it
    driver.type_in(field, 150.0)
    assert budget.target_ms == 150.0
    driver.type_in(field, 30.0)
    assert budget.target_ms == 95.0


def test_calibration_and_disdrometer_panels_measure_the_rain(driver):
    lab = driver.editor.calibration
    driver.editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    driver.ctx.window_focus("//Disdrometer")
    driver.ctx.set_ref("//Disdrometer")
    driver.ctx.item_input_value("##seconds", 20.0)
    driver.ctx.item_click("Measure")
    driver.until(lambda: lab.counted is not None, 100_000)
    assert abs(lab.counted.rate_mm_h - 8.5) < 3 * lab.counted.standard_error_mm_h
    assert lab.counted.seconds.sum() == 20
    driver.ctx.window_focus("//Calibration")
    driver.ctx.set_ref("//Calibration")
    driver.ctx.combo_click("##compared/marshall_palmer")
    driver.frames()
    assert lab.pass_file.name == "marshall_palmer"
    driver.ctx.combo_click("##calibration/marshall_palmer")
    driver.frames()
    assert driver.editor.live_rain.simulation.calibration.name == "marshall_palmer"
    assert driver.editor.document.history.undo_label == "Calibration"


def test_a_calibration_has_one_color_in_all_plots_and_each_plot_of_two_has_a_legend(driver, monkeypatch):
    hues, legends, begin = {}, [], implot.begin_plot

    def noting(draw):
        def noted(label, *arguments, **options):
            draw(label, *arguments, **options)
            hues.setdefault(label, []).append(tuple(implot.get_last_item_color()))

        return noted

    def begin_plot(title, size, flags):
        legends.append(not flags & implot.Flags_.no_legend)
        return begin(title, size, flags)

    driver.panel("Calibration")
    driver.editor.calibration.compare("marshall_palmer")
    driver.frames()
    for name in ("plot_line", "plot_scatter"):
        monkeypatch.setattr(implot, name, noting(getattr(implot, name)))
    monkeypatch.setattr(implot, "begin_plot", begin_plot)
    window = imgui.internal.find_window_by_name("Calibration")
    for place in (0, 300, 600, 900, 1200):
        imgui.internal.set_scroll_y(window, place)
        driver.frames()
    assert set(hues) == {"published", "marshall_palmer"} and len(hues["marshall_palmer"]) > 5
    assert len({*hues["published"]}) == len({*hues["marshall_palmer"]}) == 1
    assert hues["published"][0] != hues["marshall_palmer"][0] and all(legends)
    imgui.internal.set_scroll_y(window, 0)
    driver.frames()
    driver.editor.calibration.compare("published")
    driver.frames()
    assert not any(legends[-5:])  # of the five plots, with one calibration


def test_the_rain_panel_chooses_a_sensor_and_replaces_its_aperture(driver):
    document, live = driver.editor.document, driver.editor.live_rain
    driver.ctx.window_focus("//Rain")
    driver.click("//Rain/Camera")
    driver.ctx.set_ref("//Rain")
    driver.ctx.combo_click("##sensor/rainsense")
    driver.frames()
    assert document.rain.sensor == "rainsense" and live.simulation.sensor.tone_curve == "crushed"
    driver.click("//Rain/##aperture_mm given")
    assert document.rain.aperture_mm == 4.0
    driver.type_in("//Rain/##aperture_mm", 6.0)
    assert document.rain.aperture_mm == 6.0
    driver.ctx.item_click("//Rain/##aperture_mm", 1)
    driver.frames()
    assert document.rain.aperture_mm is None
    driver.press(chord(imgui.Key.mod_ctrl, imgui.Key.z))
    assert document.rain.aperture_mm == 6.0
    driver.click("//Rain/##aperture_mm given")
    assert document.rain.aperture_mm is None
    assert document.history.undo_label == "Aperture"


_CTRL, _KEY = imgui.Key.mod_ctrl, imgui.Key


def test_keys_and_titles_mean_one_thing():
    keys = [keys for command in COMMANDS for keys in chords_of(command)]
    keys += [int(tool.key) for tool in TOOLS if tool.key is not None]
    keys += [int(key) for key in (_KEY.w, _KEY.a, _KEY.s, _KEY.d, _KEY.q, _KEY.e)]
    assert sorted(keys) == sorted(set(keys)), [chord_name(each) for each in keys if keys.count(each) > 1]
    names = [command.name for command in all_commands()] + [tool.name for tool in TOOLS]
    assert len(names) == len(set(names))
    assert {command.menu for command in all_commands()} <= {"", *MENUS}
    assert len({panel.title for panel in BUILT_IN_PANELS}) == len(BUILT_IN_PANELS)


def test_layers_are_locked_copied_named_and_removed(driver):
    editor = driver.editor

    def names():
        return [each.name for each in editor.document.scene.layers]

    driver.click("//Layers/members/###lock layers road")
    assert editor.document.scene.layers[0].locked
    driver.click("//Layers/members/###layers wall")
    assert editor.viewport.options.member == "layers/wall"
    driver.click("//Layers/Duplicate")
    assert names() == ["road", "wall", "wall 2", "sky"]
    assert editor.document.scene.layers[2].gaussians is editor.document.scene.layers[1].gaussians
    driver.ctx.item_double_click("//Layers/members/###layers wall 2")
    driver.frames(3)
    driver.ctx.key_chars_replace_enter("fence")
    driver.frames(3)
    assert (names()[2], editor.viewport.options.member) == ("fence", "layers/fence")
    assert {"wall 2", "fence"} <= set(editor.document.history.labels[-1].partition(" ")[2].split(" to "))
    driver.click("//Layers/Remove")
    assert names() == ["road", "wall", "sky"]
    driver.press(chord(_CTRL, imgui.Key.z))
    assert names() == ["road", "wall", "fence", "sky"]


def test_the_size_of_the_text_changes_when_its_slider_is_let_go(driver):
    driver.panel("Display")
    driver.ctx.scroll_to_item_y("//Display/##font_scale")
    driver.frames()
    preferences, (corner, size) = driver.editor.preferences, driver.area("//Display/##font_scale")
    middle = corner + size / 2
    driver.stroke(middle, middle + [15, 0], middle + [30, 0], lets_go=False)
    assert preferences.value.font_scale == 1.0  # nothing moves under the mouse
    assert np.array_equal(driver.area("//Display/##font_scale")[0], corner)
    driver.ctx.mouse_up(0)
    driver.frames(4)
    assert preferences.value.font_scale > 1.05

"""The timeline, the camera path and the rain over time, regions and drop color, driven by hand."""

import numpy as np
import pytest

from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.editor.edits.rain_keyframes import add_shower, replace_keyframes
from gsrain_engine.editor.overlays import path_overlay_of
from gsrain_engine.editor.rain_regions import face_handles, inset_view
from gsrain_engine.editor.steps import steps_since
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.rain.settings import HAZE_REGION, HEAVIEST_MM_H, RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.view import rain_anchor
from ui.commands.keys import chord
from ui.commands.table import COMMANDS
from window_driver import imgui

KEY = imgui.Key
UNDO = chord(KEY.mod_ctrl, KEY.z)


def flight(driver):
    """Look around, and store four views at 0, 1, 2 and 4 s, by the keyboard alone."""
    editor = driver.editor
    driver.ctx.mouse_move("//View/view")
    for time_s, step in ((0.0, (0, 0, 0)), (1.0, (3, 0.5, 0.5)), (2.0, (3, -1, 0.5)), (4.0, (4, 0.5, 0))):
        editor.playback.clock.seek(time_s)
        editor.viewport.navigation.position = editor.viewport.navigation.position + np.array(step, float)
        driver.frames()
        driver.press(KEY.k)
    return editor.document.scene.path


def drag(driver, start, end, held=()):
    driver.stroke(*(start + share * np.subtract(end, start) for share in (0, 0.3, 0.7, 1.0)), held=held)


def test_the_ruler_fits_again_when_the_minute_of_a_shower_is_undone(driver):
    playback = driver.editor.playback
    driver.panel("Timeline")
    before = playback.timeline.ruler.visible_span_s
    driver.editor.document.edit_keyframes("Add passing shower", add_shower, 0.0)
    playback.show_all()
    driver.frames()
    assert playback.timeline.ruler.visible_span_s > 60
    driver.press(UNDO)
    assert playback.timeline.ruler.visible_span_s == pytest.approx(before)
    playback.timeline.ruler.fit(0.0, 12.0)  # the user's own, not far too long
    own = playback.timeline.ruler.visible_span_s
    driver.editor.document.change_rain("Intensity", intensity_mm_h=3.0)
    driver.press(UNDO)
    assert playback.timeline.ruler.visible_span_s == own


def test_keys_are_added_scrubbed_moved_copied_deleted_and_undone(driver):
    editor = driver.editor
    document, clock, timeline = editor.document, editor.playback.clock, editor.playback.timeline

    def on_ruler(time_s):
        (left, top), (_, height) = driver.area("//Timeline/ruler")
        return np.array([left + timeline.ruler.x(time_s), top + height / 2 - 4])

    path = flight(driver)
    assert path.times_s.tolist() == [0, 1, 2, 4]
    assert document.history.labels[1:] == ["Insert camera keyframe"] * 4
    by_hand = editor.viewport.navigation.position.copy()

    # A click on a key looks through it.
    driver.click("//Timeline/**/key 1")
    assert editor.viewport.options.follow_path and clock.time_s == 1.0
    assert editor.viewport.shot(96, 64).camera.position == pytest.approx(path.positions[1])

    # Dragging the ruler scrubs, and everything follows.
    drag(driver, on_ruler(0.5), on_ruler(3.0))
    assert clock.time_s == pytest.approx(3.0, abs=0.05)
    expected = editor.viewport.path.camera(clock.time_s, 96, 64).position
    assert editor.viewport.shot(96, 64).camera.position == pytest.approx(expected)

    # A drag in time is one step; with Ctrl it copies.
    place = driver.area("//Timeline/**/key 1")[0] + 6
    moved = np.array([timeline.ruler.x(1.5) - timeline.ruler.x(0.0), 0.0])
    steps = len(document.history.labels)
    drag(driver, place, place + moved)
    assert document.scene.path.times_s == pytest.approx([0, 2, 2.5, 4], abs=0.05)  # past the third one
    assert timeline.key == 2
    assert document.scene.path.positions[2] == pytest.approx(path.positions[1])
    assert document.history.labels[steps:] == ["Move keyframe"]
    driver.press(UNDO)
    assert document.scene.path is path
    drag(driver, place, place + 2 * moved, held=(KEY.mod_ctrl,))
    copied = document.scene.path
    assert len(copied.times_s) == 5
    assert np.delete(copied.times_s, timeline.key) == pytest.approx(path.times_s)
    assert copied.times_s[timeline.key] == pytest.approx(4.0, abs=0.1)
    assert copied.positions[timeline.key] == pytest.approx(path.positions[1])
    assert document.history.undo_label == "Copy keyframe"
    driver.press(UNDO)
    assert document.scene.path is path

    # Delete removes the active one.
    driver.click("//Timeline/**/key 2")
    driver.press(KEY.delete)
    assert document.scene.path.times_s.tolist() == [0, 1, 4]
    driver.press(UNDO)
    assert document.scene.path is path

    # A drag of the picture leaves the ride where the camera is.
    driver.click("//Timeline/**/key 3")
    driver.stroke(driver.at(0.5, 0.5), driver.at(0.5, 0.5) + [4, 0], button=1)
    assert not editor.viewport.options.follow_path
    assert editor.viewport.navigation.position == pytest.approx(path.positions[3])
    assert editor.viewport.navigation.position == pytest.approx(by_hand)


def test_a_key_is_dragged_in_the_picture(driver):
    document, viewport = driver.editor.document, driver.editor.viewport
    here = np.array([-4.0, -3.0, 4.0])

    path = flight(driver)
    viewport.navigation.position = here
    viewport.navigation.heading, viewport.navigation.pitch = 0.3, -0.2
    driver.frames(3)
    corner, size = driver.area()
    camera = viewport.shot(*map(int, size)).camera

    def handle(key):
        return corner + next(each.handle_px for each in path_overlay_of(viewport, camera).keys if each.key == key)

    steps, start = len(document.history.labels), handle(2)
    drag(driver, start, start + [40, -30])
    moved = document.scene.path
    assert handle(2) == pytest.approx(start + [40, -30], abs=2)
    depth = [camera.world_to_camera[2, :3] @ each.positions[2] for each in (path, moved)]
    assert depth[0] == pytest.approx(depth[1])  # in the plane that faces the view
    assert np.array_equal(np.delete(moved.positions, 2, axis=0), np.delete(path.positions, 2, axis=0))
    assert document.history.labels[steps:] == ["Move keyframe"]
    assert np.array_equal(viewport.navigation.position, here)  # the view stays

    driver.press(UNDO)
    assert document.scene.path is path
    drag(driver, start, start + [30, -40], held=(KEY.mod_shift,))
    risen = document.scene.path.positions[2] - path.positions[2]
    assert risen[:2] == pytest.approx([0, 0], abs=1e-9) and risen[2] > 0.1

    driver.click("//Timeline/show path")
    drag(driver, start, start + [30, 0])  # nothing is there to take hold of: the view orbits
    assert not np.array_equal(viewport.navigation.position, here)


def test_time_and_values_of_a_rain_keyframe_are_typed_in_its_menu_and_next_to_the_rows(unopened):
    unopened.size_px = 1500, 900
    unopened.run(lambda: type_numbers_of_rain_keyframes(unopened))


def type_numbers_of_rain_keyframes(driver):
    editor = driver.editor
    document, tracks = editor.document, editor.rain_tracks
    hill = RainKeyframes().with_key(0.0, intensity_mm_h=0.0).with_key(4.0, intensity_mm_h=8.0)
    document.edit_keyframes("Hill", replace_keyframes, hill.with_key(2.0, wind_m_s=(1.0, 2.0)))
    driver.ctx.window_focus("//Timeline")
    driver.frames(4)
    driver.click_at(driver.area("//Timeline/**/rain key 1")[0] + 6)
    driver.type_in("//Timeline/**/##key time", 3.21)
    assert document.history.undo_label == "Move rain keyframe" and tracks.active == ("intensity_mm_h", 1)
    driver.double_click("//Timeline/**/##value")
    driver.enter("500")
    last = document.keyframes.keys[-1]
    assert (last.time_s, last.intensity_mm_h) == (pytest.approx(3.21), HEAVIEST_MM_H)
    driver.click_at(driver.area("//Timeline/**/wind key 0")[0] + 6, button=1)
    driver.type_in("//$FOCUSED/##key time", 1.5)
    driver.type_in("//$FOCUSED/##value/$$1", -60.0)
    assert document.keyframes.key_at(1.5).wind_m_s == (1.0, -40.0)
    driver.press(KEY.escape)
    driver.click("//Timeline/**/Whole path")
    assert tracks.active is None
    for _ in range(4):
        document.undo()
    assert document.keyframes == hill.with_key(2.0, wind_m_s=(1.0, 2.0))


def test_all_rain_keyframes_are_made_imported_smoothed_and_cleared_from_the_menu(driver):
    editor = driver.editor
    document, ruler = editor.document, editor.playback.timeline.ruler
    driver.ctx.window_focus("//Timeline")

    def choose(name):
        driver.click("//Timeline/**/row rain")
        driver.ctx.item_click(f"//$FOCUSED/{name}")
        driver.frames(3)

    choose("Add passing shower")
    assert len(document.keyframes.keys) == 7 and ruler.visible_span_s > 60
    choose("Linear")
    assert document.keyframes.between == "linear"
    choose("Clear rain keyframes")
    assert not document.keyframes.keys and ruler.visible_span_s < 20
    instrument = VirtualDisdrometer(RainSimulation.start(RainSettings(intensity_mm_h=20.0)), 0.5)
    write_spectra(driver.folder / "rain.nc", instrument.measure(60.0 * np.arange(4)).spectra)
    for answer, count in (("Cancel", 0), ("Use it", 3)):
        choose("Import disdrometer series...")
        driver.choose_file("Import a series", driver.folder / "rain.nc")
        driver.until(lambda: editor.calibration.series is not None)
        driver.frames(3)
        driver.type_in("//Import disdrometer series/Times faster", 60.0)
        driver.click(f"//Import disdrometer series/{answer}")
        assert len(document.keyframes.keys) == count and editor.calibration.series is None
    times_s = document.keyframes.times_s
    assert np.diff(times_s) == pytest.approx(1.0) and document.keyframes.heaviest_mm_h(document.rain) > 10
    assert not driver.is_open("Import disdrometer series")


def test_a_face_of_the_region_is_dragged_from_outside(driver):
    """The upper face in the inset: the region gets higher, the floor stays, and it is one step."""
    editor = driver.editor

    editor.viewport.options.tool = "Rain regions"
    driver.ctx.window_focus("//View")
    driver.frames(4)
    corner, size = driver.area()
    style = imgui.get_style()
    em = style.font_size_base * style.font_scale_main * style.font_scale_dpi
    inset = np.minimum([15 * em, 11 * em], 0.5 * size).astype(int)
    shot, box = editor.viewport.shot(*map(int, size)), editor.document.rain.streak_region
    anchor = rain_anchor(editor.document.scene, editor.live_rain.simulation, shot)
    camera = inset_view(box, anchor, *inset.tolist()).camera
    (top,) = [each for each in face_handles(box, anchor, camera, inset=0.0) if each.face == (2, True)]
    x, y, z = camera.world_to_camera[:3] @ np.append(top.point_m, 1.0)
    place = corner + size - inset - 0.6 * em + [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
    steps = editor.document.history.cursor
    driver.stroke(place, *(place - [0, up] for up in (4, 8, 12)))
    changed = editor.document.rain.streak_region
    assert changed.maximum_m[2] > box.maximum_m[2] + 0.3
    assert (changed.minimum_m, changed.maximum_m[:2]) == (box.minimum_m, box.maximum_m[:2])
    assert editor.document.history.cursor == steps + 1
    editor.document.undo()
    assert editor.document.rain.streak_region == box


def test_haze_has_a_form_and_maybe_a_region(driver):
    """In the panel and by the command; the steps are those of a command line."""
    editor = driver.editor

    document, saved = editor.document, editor.document.state
    (command,) = [each for each in COMMANDS if each.name == "Haze"]
    assert document.rain.haze == "medium" and command.is_on(document)
    document.change_rain("Intensity", intensity_mm_h=80.0)
    driver.until(lambda: "drops drawn" in editor.viewport.statistics)
    everywhere = driver.picture()
    driver.click("//Rain/Regions")
    driver.click("//Rain/Limit haze to a region")
    assert document.rain.haze_region == HAZE_REGION
    driver.click("//Rain/Show haze region")
    editor.viewport.options.tool = "Rain regions"
    tool = driver.tool("Rain regions")
    driver.ctx.window_focus("//View")
    driver.frames(4)
    driver.tap("//View/**/Haze region")
    assert tool.region == "haze_region"
    driver.tap("//View/**/Reset##region")
    assert document.rain.haze_region is None
    driver.frames(4)
    editor.viewport.options.tool, editor.viewport.options.show_haze_region = "", False
    assert np.array_equal(driver.picture(), everywhere)
    driver.click("//Rain/Regions")
    driver.ctx.set_ref("//Rain")
    driver.ctx.combo_click("##haze/gaussians")
    driver.frames()
    assert document.rain.haze == "gaussians" and command.is_on(document)
    driver.ctx.window_focus("//Rain properties")
    driver.until(lambda: editor.viewport.statistics["haze Gaussians"] > 0)
    command.run(document)
    assert document.rain.haze == "none" and not command.is_on(document)
    driver.frames(3)
    command.run(document)
    assert document.rain.haze == "medium"
    texts = [each.text for each in steps_since(document.history, saved)]
    assert texts[-2:] == ["change-rain haze=none", "change-rain haze=medium"]


def test_the_drop_color_is_picked_from_the_view(driver):
    """A pixel of the wall, which is reddish, then a rectangle of the sky; back to the scene's sky."""
    editor = driver.editor
    editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    driver.frames(3)
    driver.click("//Rain/###pick sky")
    driver.ctx.window_focus("//View")
    driver.frames(3)
    picture = driver.picture()
    row, column = np.unravel_index(np.argmax(picture[..., 0] - picture[..., 2]), picture.shape[:2])
    driver.click_at(driver.area()[0] + [column + 0.5, row + 0.5])
    driver.until(lambda: editor.document.rain.drop_color is not None)
    picked = editor.document.rain.drop_color
    assert picked[0] > picked[2] + 0.1
    driver.stroke(driver.at(0.4, 0.14), driver.at(0.6, 0.2))
    driver.until(lambda: editor.viewport.sky_pick is None and editor.document.rain.drop_color != picked, 200)
    driver.frames()
    assert editor.document.rain.drop_color[2] > editor.document.rain.drop_color[0] + 0.05
    driver.click("//Rain/From sky")
    assert editor.document.rain.drop_color is None


def test_keys_of_a_track_are_inserted_dragged_copied_eased_and_deleted(driver):
    """Each change is one step; the range has a row of its own, and Record follows it."""
    editor = driver.editor
    document, playback, tracks = editor.document, editor.playback, editor.rain_tracks
    ruler = playback.timeline.ruler

    def times():
        return document.keyframes.key_times["intensity_mm_h"]

    def on_row(time_s):
        (left, top), (_, height) = driver.area("//Timeline/**/track rain")
        return np.array([left + ruler.x(time_s), top + height / 2])

    document.change_rain("Intensity", intensity_mm_h=8.5)
    driver.ctx.window_focus("//Timeline")
    driver.frames(3)
    for time_s in (1.0, 3.0):
        driver.point_at(on_row(time_s))
        driver.ctx.mouse_double_click(0)
        driver.frames(3)
    assert times() == pytest.approx([1, 3], abs=0.05)
    drag(driver, on_row(times()[1]), on_row(4.0))
    assert times() == pytest.approx([1, 4], abs=0.05)
    drag(driver, on_row(times()[0]), on_row(2.0), held=(KEY.mod_ctrl,))
    assert times() == pytest.approx([1, 2, 4], abs=0.05)
    driver.press(chord(KEY.mod_ctrl, KEY.c))
    playback.clock.seek(3.0)
    driver.press(chord(KEY.mod_ctrl, KEY.v))
    assert times() == pytest.approx([1, 2, 3, 4], abs=0.05)
    driver.click_at(on_row(times()[0]), button=1)
    driver.ctx.item_click("//$FOCUSED/Hold")
    driver.frames(3)
    document.change_rain("Intensity", intensity_mm_h=0.0)  # at 3 s
    assert document.keyframes.rain_at(document.rain, 1.9).intensity_mm_h == 8.5
    driver.click_at(on_row(times()[0]))
    assert tracks.easing(tracks.active) == "hold"
    driver.press(KEY.delete)
    assert times() == pytest.approx([2, 3, 4], abs=0.05)
    words = ["Insert", "Insert", "Move", "Copy", "Paste", "Ease", "Intensity", "Delete"]
    assert [label.split()[0] for label in document.history.labels[2:]] == words
    assert all(step.text for step in steps_since(document.history, document.history.steps[0].document))
    for _ in range(8):
        driver.press(UNDO)
    assert not document.keyframes.keys

    before_s = playback.clock.time_s
    drag(driver, driver.area("//Timeline/span end")[0] + 6, driver.area("//Timeline/span end")[0] - [100, 0])
    start, end = playback.clock.span_s
    assert playback.clock.time_s == before_s and (start, end) == (0, pytest.approx(end)) and end < 4.5
    extent = editor.render_queue.extent()
    assert extent.length_s == pytest.approx(end, abs=0.04) and extent.frames == round(30 * end)

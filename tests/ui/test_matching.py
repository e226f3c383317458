"""Matches with another view in the real window: switched on, changed and looked at as a person does."""

import numpy as np
from imgui_bundle import ImVec2

from editor.test_matching_view import deep_capture
from gsrain_engine.appearance.correspondence import COLORS, MatchOutcome
from gsrain_engine.datasets.capture_folder import write_views
from window_driver import Driver, imgui


def test_matches_are_shown_over_the_recorded_view(tmp_path):
    for _ in write_views(tmp_path / "wall", deep_capture().views):
        pass
    (tmp_path / "shots").mkdir()
    driver = Driver(tmp_path / "shots", backend="opengl")
    editor, captures = driver.editor, driver.editor.captures
    matching = editor.matching

    def script():
        driver.ctx.window_focus("//Capture")
        driver.frames()
        captures.open(tmp_path / "wall")
        driver.until(lambda: captures.capture is not None)
        captures.look_from(2)
        captures.opacity = 1.0
        driver.until(lambda: not captures.is_working)
        driver.ctx.set_ref("//Capture")
        driver.ctx.item_open("Matching")
        driver.frames()
        before = driver.screen()
        driver.ctx.item_click("Matching/Show matches")
        driver.until(lambda: matching.shown is not None)
        assert matching.problem is None
        assert matching.shown.matched.to.name == "front_2"
        driver.frames()
        assert matching.texture is not None

        # What lies over the picture is green where it matches, when a person asks which pixels do.
        driver.ctx.set_ref("//Capture/Matching")
        driver.ctx.combo_click("As/matching pixels")
        driver.ctx.set_ref("//Capture")
        shown = driver.screen()
        assert matching.mode == "pixels"
        corner = driver.ctx.item_info("//View/view").rect_full
        middle = int((corner.min.y + corner.max.y) / 2), int((corner.min.x + corner.max.x) / 2)
        where = np.s_[middle[0] - 20 : middle[0] + 20, middle[1] - 20 : middle[1] + 20]
        tint = (shown[where] - 0.55 * before[where]).mean(axis=(0, 1)) / 0.45
        np.testing.assert_allclose(tint / 255, COLORS[MatchOutcome.MATCHED], atol=0.06)

        # Under the mouse, the tooltip tells where the pixel is there; the picture stays as it is, and so does the eye.
        place = editor.viewport.navigation.position.copy()
        driver.ctx.mouse_move_to_pos(ImVec2(middle[1], middle[0]))
        driver.frames()
        driver.ctx.item_check("Matching/Lines")
        assert matching.lines
        with_lines = driver.screen()
        lower = np.s_[middle[0] : int(corner.max.y) - 10, middle[1] - 100 : int(corner.max.x) - 10]
        assert np.mean(np.abs(with_lines[lower] - shown[lower]).max(axis=2) > 40) > 0.001
        np.testing.assert_array_equal(editor.viewport.navigation.position, place)

        # The last view of a camera has no next one, which is told.
        captures.look_from(4)
        driver.until(lambda: matching.problem is not None)
        assert matching.shown is None
        driver.ctx.mouse_move("//View/view")
        driver.press(imgui.Key.mod_shift | imgui.Key.m)
        assert not matching.is_on
        driver.frames()
        assert matching.texture is None

    driver.run(script)

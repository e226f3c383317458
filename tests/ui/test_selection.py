"""The selection tools and the Select panel, driven as a person drives them."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.selection.candidates import selected, selected_count
from ui.commands.keys import chord
from ui.tools import TOOLS
from window_driver import Driver, imgui

KEY = imgui.Key


class Hand(Driver):
    """A driver that selects in places of the picture, as shares of its width and height."""

    def draw(self, *places, held=()):
        self.stroke(*(self.at(*each) for each in places), held=held)

    def use(self, name):
        """Pick a tool by its key."""
        self.ctx.mouse_move_to_pos(imgui.ImVec2(*self.at(0.5, 0.6)))
        self.press(next(tool.key for tool in TOOLS if tool.name == name))
        assert self.editor.viewport.options.tool == name

    def counts(self):
        return {member.name: selected(member).size for member in self.editor.document.scene.members}

    @property
    def step(self):
        return self.editor.document.history.undo_label


@pytest.fixture
def hand(tmp_path):
    return Hand(tmp_path)


LOWER = ((0.2, 0.62), (0.9, 0.62), (0.9, 0.95), (0.2, 0.95))
"""Corners of a piece of the picture that shows the road, and nothing else."""


def test_rectangle_and_its_modes_and_undo(hand):
    editor = hand.editor

    def script():
        hand.use("Rectangle")
        hand.draw(LOWER[0], LOWER[2])
        first = hand.counts()
        assert first["road"] > 5 and first["wall"] == first["sky"] == 0
        assert hand.step == f"Select {first['road']:,} by rectangle"
        hand.draw((0.2, 0.2), (0.9, 0.5), held=(KEY.mod_shift,))
        added = hand.counts()
        assert added["wall"] > 0 and added["road"] >= first["road"] and hand.step.startswith("Add ")
        hand.draw(LOWER[0], LOWER[2], held=(KEY.mod_ctrl,))
        assert hand.counts()["road"] == added["road"] - first["road"]
        assert hand.step == f"Remove {first['road']:,} by rectangle"
        hand.draw((0.2, 0.2), (0.55, 0.5), held=(KEY.mod_ctrl, KEY.mod_shift))
        assert 0 < selected_count(editor.document.scene) < sum(added.values()) - first["road"]
        assert hand.step.startswith("Keep ")
        for _ in range(3):
            hand.press(chord(KEY.mod_ctrl, KEY.z))
        assert hand.counts() == first
        start = editor.viewport.navigation.position.copy()
        hand.press(KEY.escape)
        assert editor.viewport.options.tool == ""
        hand.draw((0.4, 0.7), (0.6, 0.7))
        assert hand.counts() == first
        assert np.linalg.norm(editor.viewport.navigation.position - start) > 0.1  # the left button orbits again

    hand.run(script)


def test_lasso_polygon_and_brush(hand):
    def script():
        hand.use("Lasso")
        hand.draw(*LOWER)
        road = hand.counts()["road"]
        assert road > 5 and hand.step == f"Select {road:,} by lasso"
        hand.use("Polygon")
        for corner in LOWER:
            hand.draw(corner)
        assert hand.step.endswith("lasso")  # not closed yet
        hand.press(KEY.enter)
        assert abs(hand.counts()["road"] - road) <= 2
        steps = len(hand.editor.document.history.labels)
        for corner in (*LOWER, LOWER[0]):  # the first corner closes too
            hand.draw(corner, held=(KEY.mod_ctrl,))
        assert hand.counts()["road"] == 0
        for corner in LOWER:
            hand.draw(corner)
        hand.press(KEY.escape)
        hand.use("Polygon")
        hand.press(KEY.enter)
        assert len(hand.editor.document.history.labels) == steps + 1  # the corners are gone
        hand.use("Brush")
        stroke = (0.3, 0.8), (0.5, 0.85), (0.7, 0.8)
        hand.draw(*stroke)
        thin = hand.counts()["road"]
        assert hand.step == f"Select {thin} by brush"
        for _ in range(4):
            hand.press(KEY.right_bracket)
        assert hand.editor.selection.brush_radius_px > 45
        hand.draw(*stroke)
        assert hand.counts()["road"] > thin > 0
        hand.press(KEY.left_bracket)
        assert hand.editor.selection.brush_radius_px < 45

    hand.run(script)


def test_sphere_and_box_are_placed_sized_and_applied(hand):
    editor, options = hand.editor, hand.editor.selection

    def script():
        hand.use("Sphere")
        hand.draw((0.5, 0.75), (0.7, 0.75))
        assert abs(options.ball.center_m[2]) < 0.1  # on the road
        assert options.ball.radius_m > 0.5 and hand.step is None
        hand.press(KEY.enter)
        assert hand.step == f"Select {hand.counts()['road']} by sphere"
        road = editor.document.scene.layers[0]
        means = road.gaussians.means[selected(road).indices]
        assert np.linalg.norm(means - options.ball.center_m, axis=1).max() <= options.ball.radius_m
        hand.tap("//View/**/Drop##sphere")
        assert options.ball is None and hand.counts()["road"] == len(means)
        hand.use("Box")
        hand.draw((0.5, 0.75))
        assert options.box.center_m[2] == pytest.approx(1.0, abs=0.1)
        face = hand.on_screen(options.box.face_m(2, True))
        hand.stroke(face, face - [0, 40])
        assert options.box.size_m[2] > 2.1
        hand.ctx.set_ref("//View")
        hand.type_in("**/##yaw", 30.0)
        assert options.box.yaw_deg == 30
        options.box = replace(options.box, size_m=(9.0, 2.0, 6.0))
        hand.tap("**/Apply##box")
        assert hand.counts()["road"] > 5 and hand.step == f"Select {hand.counts()['road']} by box"

    hand.run(script)


def test_a_range_dragged_over_the_histogram_selects(hand):
    options = hand.editor.selection

    def script():
        hand.ctx.window_focus("//Select")
        hand.ctx.set_ref("//Select")
        hand.ctx.combo_click("##attribute/height (m)")
        hand.frames()
        assert options.attribute == "height" and options.range is None
        hand.click("//Select/Replace##range")  # all of it
        assert selected_count(hand.editor.document.scene) == 944
        corner, size = hand.area("//Select/##attribute plot")
        hand.stroke(corner + size * [0.3, 0.5], corner + size * [0.6, 0.5])
        low, high = options.range
        assert 20 < low < 60 < high < 110  # m; the sky reaches up to 150
        hand.click("//Select/Replace##range")
        heights = hand.editor.document.scene.layers[2].gaussians.means[:, 2]
        assert hand.counts() == {"road": 0, "wall": 0, "sky": int(((heights >= low) & (heights <= high)).sum())}
        assert hand.step == f"Select {hand.counts()['sky']} by height"
        hand.click("//Select/Remove##range")
        assert selected_count(hand.editor.document.scene) == 0

    hand.run(script)

"""The selection tools and the Select panel, driven as a person drives them."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.selection.candidates import selected, selected_count
from small_scene import small_scene
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
def driver(tmp_path):
    return Hand(tmp_path)


LOWER = ((0.2, 0.62), (0.9, 0.62), (0.9, 0.95), (0.2, 0.95))
"""Corners of a piece of the picture that shows the road, and nothing else."""


def test_rectangle_and_its_modes_and_undo(driver):
    editor = driver.editor
    driver.use("Rectangle")
    driver.draw(LOWER[0], LOWER[2])
    first = driver.counts()
    assert first["road"] > 5 and first["wall"] == first["sky"] == 0
    assert driver.step == f"Select {first['road']:,} by rectangle"
    driver.draw((0.2, 0.2), (0.9, 0.5), held=(KEY.mod_shift,))
    added = driver.counts()
    assert added["wall"] > 0 and added["road"] >= first["road"] and driver.step.startswith("Add ")
    driver.draw(LOWER[0], LOWER[2], held=(KEY.mod_ctrl,))
    assert driver.counts()["road"] == added["road"] - first["road"]
    assert driver.step == f"Remove {first['road']:,} by rectangle"
    driver.draw((0.2, 0.2), (0.55, 0.5), held=(KEY.mod_ctrl, KEY.mod_shift))
    assert 0 < selected_count(editor.document.scene) < sum(added.values()) - first["road"]
    assert driver.step.startswith("Keep ")
    for _ in range(3):
        driver.press(chord(KEY.mod_ctrl, KEY.z))
    assert driver.counts() == first
    start = editor.viewport.navigation.position.copy()
    driver.press(KEY.escape)
    assert editor.viewport.options.tool == ""
    driver.draw((0.4, 0.7), (0.6, 0.7))
    assert driver.counts() == first
    assert np.linalg.norm(editor.viewport.navigation.position - start) > 0.1  # the left button orbits again


def test_lasso_polygon_and_brush(driver):
    driver.use("Lasso")
    driver.draw(*LOWER)
    road = driver.counts()["road"]
    assert road > 5 and driver.step == f"Select {road:,} by lasso"
    driver.use("Polygon")
    for corner in LOWER:
        driver.draw(corner)
    assert driver.step.endswith("lasso")  # not closed yet
    driver.press(KEY.enter)
    assert abs(driver.counts()["road"] - road) <= 2
    steps = len(driver.editor.document.history.labels)
    for corner in (*LOWER, LOWER[0]):  # the first corner closes too
        driver.draw(corner, held=(KEY.mod_ctrl,))
    assert driver.counts()["road"] == 0
    for corner in LOWER:
        driver.draw(corner)
    driver.press(KEY.escape)
    driver.use("Polygon")
    driver.press(KEY.enter)
    assert len(driver.editor.document.history.labels) == steps + 1  # the corners are gone
    driver.use("Brush")
    stroke = (0.3, 0.8), (0.5, 0.85), (0.7, 0.8)
    driver.draw(*stroke)
    thin = driver.counts()["road"]
    assert driver.step == f"Select {thin} by brush"
    for _ in range(4):
        driver.press(KEY.right_bracket)
    assert driver.editor.selection.brush_radius_px > 45
    driver.draw(*stroke)
    assert driver.counts()["road"] > thin > 0
    driver.press(KEY.left_bracket)
    assert driver.editor.selection.brush_radius_px < 45


def test_sphere_and_box_are_placed_sized_and_applied(driver):
    editor, options = driver.editor, driver.editor.selection
    driver.use("Sphere")
    driver.draw((0.5, 0.75), (0.7, 0.75))
    assert abs(options.ball.center_m[2]) < 0.1  # on the road
    assert options.ball.radius_m > 0.5 and driver.step is None
    driver.press(KEY.enter)
    assert driver.step == f"Select {driver.counts()['road']} by sphere"
    road = editor.document.scene.layers[0]
    means = road.gaussians.means[selected(road).indices]
    assert np.linalg.norm(means - options.ball.center_m, axis=1).max() <= options.ball.radius_m
    driver.tap("//View/**/Drop##sphere")
    assert options.ball is None and driver.counts()["road"] == len(means)
    driver.use("Box")
    driver.draw((0.5, 0.75))
    height_m = options.box.size_m[2]
    assert options.box.center_m[2] == pytest.approx(height_m / 2, abs=0.1)
    face = driver.on_screen(options.box.face_m(2, True))
    driver.stroke(face, face - [0, 40])
    assert options.box.size_m[2] > 1.05 * height_m
    driver.ctx.set_ref("//View")
    driver.type_in("**/##yaw", 30.0)
    assert options.box.yaw_deg == 30
    options.box = replace(options.box, size_m=(9.0, 2.0, 6.0))
    driver.tap("**/Apply##box")
    assert driver.counts()["road"] > 5 and driver.step == f"Select {driver.counts()['road']} by box"


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.02])
def test_volumes_and_distances_begin_in_the_size_of_what_is_in_view(unopened, metres_per_unit):
    driver = Hand(unopened.folder, replace(small_scene(), metres_per_unit=metres_per_unit))
    driver.run(lambda: _place_volumes(driver))


def _place_volumes(driver):
    options, (_, (_, height_px)) = driver.editor.selection, driver.area()
    shares = []
    for name in ("Box", "Sphere"):
        driver.use(name)
        driver.draw((0.5, 0.75))
        camera = driver.editor.viewport.shot(16, int(height_px)).camera
        volume = options.box if name == "Box" else options.ball
        size_m = volume.size_m[0] if name == "Box" else 2 * volume.radius_m
        depth_m = camera.world_to_camera[2, :3] @ volume.center_m + camera.world_to_camera[2, 3]
        shares.append(size_m * camera.fy / depth_m / height_px)
    assert shares == pytest.approx([0.2, 0.2], abs=0.03)
    radius_m = driver.editor.viewport.core.radius_m
    assert 1e-3 < options.distance_m / radius_m < 2e-2 and 0.2 < options.depth_m / radius_m < 3


def test_a_range_dragged_over_the_histogram_selects(driver):
    options = driver.editor.selection
    driver.ctx.window_focus("//Select")
    driver.ctx.set_ref("//Select")
    driver.ctx.combo_click("##attribute/height (m)")
    driver.frames()
    assert options.attribute == "height" and options.range is None
    driver.click("//Select/Replace##range")  # all of it
    assert selected_count(driver.editor.document.scene) == 944
    corner, size = driver.area("//Select/##attribute plot")
    driver.stroke(corner + size * [0.3, 0.5], corner + size * [0.6, 0.5])
    low, high = options.range
    assert 20 < low < 60 < high < 110  # m; the sky reaches up to 150
    driver.click("//Select/Replace##range")
    heights = driver.editor.document.scene.layers[2].gaussians.means[:, 2]
    assert driver.counts() == {"road": 0, "wall": 0, "sky": int(((heights >= low) & (heights <= high)).sum())}
    assert driver.step == f"Select {driver.counts()['sky']} by height"
    driver.click("//Select/Remove##range")
    assert selected_count(driver.editor.document.scene) == 0

"""A recorded capture in the real window: opened, listed, looked from, clicked and closed."""

import numpy as np
import pytest
from imgui_bundle import ImVec2

from editor.small_capture import COLORS, written_capture
from gsrain_engine.editor.capture_view import LARGE_PX, THUMBNAIL_PX, ImageRequest
from window_driver import Driver, imgui


def _share(pixels: np.ndarray, color: tuple[int, int, int]) -> float:
    return float((np.abs(pixels - color).max(axis=2) <= 10).mean())


def _click_slowly() -> None:
    """Let two clicks be a double click however long a frame takes on a busy machine."""
    io = imgui.get_io()
    io.mouse_single_click_delay = 61.0
    io.mouse_double_click_time = 60.0


def _idle(driver) -> None:
    driver.until(lambda: not driver.editor.captures.is_working)
    driver.frames(6)


@pytest.fixture
def driver(tmp_path):
    return Driver(tmp_path, backend="opengl")


def test_a_capture_is_opened_listed_looked_from_and_closed(driver, tmp_path):
    folder = written_capture(tmp_path / "drive")
    editor, captures = driver.editor, driver.editor.captures
    captures.open(folder)  # its panel comes to the front
    driver.until(lambda: captures.capture is not None)
    assert editor.status.problem is None
    _idle(driver)
    assert {wish.view for wish in captures.textures if wish.width_px == THUMBNAIL_PX} == {0, 1, 2, 3}

    # A double click in the list looks from there, and the recorded picture fills the viewport.
    captures.opacity = 1.0
    _click_slowly()
    views = driver.ctx.window_info("//Capture/views").window.name.replace("/", "\\/")
    driver.ctx.item_double_click(f"//{views}/##view 001")
    driver.frames()
    assert captures.chosen == captures.view_at_camera == 1
    _idle(driver)
    assert ImageRequest(1, LARGE_PX) in captures.textures
    assert _share(driver.screen(), COLORS[1]) > 0.05

    # Keys go from view to view; the switch hides the picture.
    driver.ctx.mouse_move("//View/view")
    driver.press(imgui.Key.page_down)
    assert captures.view_at_camera == 2
    _idle(driver)
    assert _share(driver.screen(), COLORS[2]) > 0.05
    driver.press(imgui.Key.page_up)
    assert captures.view_at_camera == 1
    driver.ctx.set_ref("//Capture")
    driver.ctx.item_click("###Picture")
    assert not captures.show_picture
    assert _share(driver.screen(), COLORS[1]) < 0.02

    # Only the views of one camera are left when it is chosen.
    driver.ctx.combo_click("Camera/right")
    driver.frames()
    assert captures.listed == [1, 3]
    driver.tap("###next view")
    assert captures.chosen == 3

    # Cameras in the picture are clicked; a drag moves on.
    driver.ctx.combo_click("Camera/all cameras")
    editor.viewport.stop_riding()
    editor.viewport.navigation.position = np.array([-3.0, 1.0, 3.0])
    editor.viewport.navigation.heading, editor.viewport.navigation.pitch = -0.2, -0.3
    captures.chosen = 0
    driver.frames(4)
    driver.click_at(driver.on_screen(captures.cameras(editor.document.scene)[3].position))
    assert captures.chosen == 3
    driver.ctx.mouse_double_click()
    driver.frames()
    assert captures.view_at_camera == 3
    driver.drag("//View/view", ImVec2(60, 10))
    assert captures.view_at_camera is None

    driver.ctx.set_ref("//Capture")
    driver.tap("###close capture")
    assert captures.capture is None and captures.textures == {}

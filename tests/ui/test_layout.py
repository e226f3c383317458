"""The layout of docks in windows of other sizes and scales, and what comes back when the window opens again."""

import pytest
from imgui_bundle import glfw_utils
from msgspec.structs import replace

from gsrain_engine.editor.preferences import WindowPlace
from ui.window_place import Monitor, fitted
from window_driver import Driver, imgui

import glfw  # isort: skip  after imgui_bundle, which brings its own library

PANELS = ("Layers", "Edit", "Rain", "Rain properties", "Timeline", "View")


def shares_of(driver):
    """Width and height of each panel as shares of the window."""
    whole = imgui.get_main_viewport().size
    sizes = {each: driver.ctx.window_info(f"//{each}").window.size for each in PANELS}
    return {each: (size.x / whole.x, size.y / whole.y) for each, size in sizes.items()}


def alike(shares):
    """Allow for whole pixels, and for bars and splitters, which are as high at any size."""
    return {each: pytest.approx(own, abs=0.03) for each, own in shares.items()}


@pytest.fixture
def windows(tmp_path):
    """Function that opens a window of a size after another with the same layout, and runs a script in each."""

    def open_window(size_px, dpi_scale, script):
        folder = tmp_path / f"window {len(list(tmp_path.iterdir()))}"
        folder.mkdir()
        driver = Driver(folder)
        driver.layout, driver.size_px, driver.dpi_scale = tmp_path / "window.ini", size_px, dpi_scale
        driver.run(lambda: script(driver))
        driver.editor.close()
        return driver

    return open_window


def drag_side(driver, to_share):
    """Drag the edge between the viewport and the docks at the right."""
    view = driver.ctx.window_info("//View").window
    place = (view.pos.x + view.size.x + 1, view.pos.y + view.size.y / 2)
    driver.stroke(place, (0.8 * view.size.x, place[1]), (imgui.get_main_viewport().size.x * (1 - to_share), place[1]))
    driver.frames(4)


@pytest.mark.parametrize(("size_px", "dpi_scale"), [((1366, 768), 1.0), ((1280, 720), 2.0)])
def test_docks_of_the_first_window_have_their_default_shares(windows, size_px, dpi_scale):
    def look(driver):
        shares = shares_of(driver)
        assert shares["Rain"][0] == pytest.approx(0.29, abs=0.01)
        assert shares["Layers"][0] == pytest.approx(0.71 * 0.275, abs=0.01)
        assert shares["Timeline"] == pytest.approx((0.72, 0.23), abs=0.02)

    windows(size_px, dpi_scale, look)


def test_docks_have_the_same_shares_in_windows_of_other_sizes_and_scales(windows):
    stored = {}

    def arrange(driver):
        drag_side(driver, 0.4)
        stored.update(shares_of(driver))
        assert stored["Rain"][0] == pytest.approx(0.4, abs=0.02)

    windows((1366, 768), 1.0, arrange)
    for size_px, dpi_scale in (((1280, 720), 2.0), ((1366, 768), 1.0), ((1920, 1080), 1.0), ((1366, 768), 1.0)):

        def look(driver):
            driver.frames(4)
            assert not driver.window.workspace.folded.hidden
            assert shares_of(driver) == alike(stored)

        windows(size_px, dpi_scale, look)


def test_docks_keep_their_shares_while_the_window_is_resized(driver):
    before = shares_of(driver)
    window = glfw_utils.glfw_window_hello_imgui()
    for size_px in ((1500, 800), (1100, 720)):
        glfw.set_window_size(window, *size_px)
        driver.until(lambda size=size_px: round(imgui.get_main_viewport().size.x) == size[0])
        driver.frames(4)
        assert shares_of(driver) == alike(before)
    drag_side(driver, 0.5)
    assert shares_of(driver)["Rain"][0] == pytest.approx(0.5, abs=0.02)
    driver.menu("View/Panels/Put everything back in its place")
    driver.frames(4)
    assert shares_of(driver) == alike(before)


def test_the_tab_in_front_of_the_bottom_dock_comes_back(windows):
    def in_front(driver):
        titles = ("Timeline", "Drive plots", "Jobs", "Log", "Layers", "History", "Rain", "Drive")
        return [each for each in titles if not driver.ctx.window_info(f"//{each}").window.hidden]

    def choose(driver):
        for title in ("Log", "History"):
            driver.panel(title)
        driver.frames(4)

    def look(driver):
        driver.frames(4)
        assert in_front(driver) == ["Log", "History", "Rain"]

    windows((1366, 768), 1.0, choose)
    windows((1920, 1080), 1.0, look)
    windows((1366, 768), 2.0, lambda driver: driver.frames(4))  # folded
    windows((1366, 768), 1.0, look)


def place(driver):
    window = glfw_utils.glfw_window_hello_imgui()
    return (*glfw.get_window_pos(window), *glfw.get_window_size(window))


def test_the_window_opens_where_and_as_large_as_it_was_closed(windows, monkeypatch):
    def move(driver):
        window = glfw_utils.glfw_window_hello_imgui()
        glfw.set_window_pos(window, 60, 40)
        glfw.set_window_size(window, 1300, 760)
        driver.until(lambda: place(driver) == (60, 40, 1300, 760))
        driver.frames(4)

    def look(driver):
        assert place(driver) == (60, 40, 1300, 760)

    driver = windows((1366, 768), 1.0, move)
    assert driver.editor.preferences.value.window == WindowPlace(
        position=(60, 40), size=(1300, 760), is_maximized=False
    )
    windows(None, 1.0, look)

    # Maximized by a desktop, which Xvfb has not.
    is_maximized, asked, attribute = [True], [], glfw.get_window_attrib

    def attribute_of(window, name):
        return is_maximized[0] if name == glfw.MAXIMIZED else attribute(window, name)

    def enlarge(driver):
        glfw.set_window_size(glfw_utils.glfw_window_hello_imgui(), 1500, 900)
        driver.until(lambda: place(driver)[2:] == (1500, 900))
        driver.frames(4)

    monkeypatch.setattr(glfw, "get_window_attrib", attribute_of)
    monkeypatch.setattr(glfw, "maximize_window", asked.append)
    driver = windows(None, 1.0, enlarge)
    assert not asked
    expected = WindowPlace(position=(60, 40), size=(1300, 760), is_maximized=True)
    assert driver.editor.preferences.value.window == expected
    is_maximized[0] = False
    driver = windows(None, 1.0, look)
    assert len(asked) == 1 and driver.editor.preferences.value.window == replace(expected, is_maximized=False)


LAPTOP, DESK = Monitor(0, 30, 1366, 738), Monitor(1366, 0, 3840, 2160, 2.0)


@pytest.mark.parametrize(
    ("position", "size", "present", "expected"),
    [
        ((60, 40), (1300, 700), [LAPTOP], ((60, 40), (1300, 700))),
        ((60, 40), (1300, 700), [], ((60, 40), (1300, 700))),
        ((-50, 0), (1300, 700), [LAPTOP], ((0, 30), (1300, 700))),
        ((900, 400), (1300, 700), [LAPTOP], ((66, 68), (1300, 700))),
        ((0, 30), (1900, 1000), [LAPTOP], ((0, 30), (1366, 738))),
        ((1500, 100), (1200, 800), [LAPTOP, DESK], ((1500, 100), (1200, 800))),
        ((4000, 100), (1200, 800), [LAPTOP, DESK], ((2806, 100), (1200, 800))),
        ((1500, 100), (1200, 800), [LAPTOP], (None, (1200, 738))),  # the other one is gone
        (None, (2500, 800), [LAPTOP], (None, (1366, 738))),
    ],
)
def test_a_window_opens_within_the_present_monitors(position, size, present, expected):
    stored = WindowPlace(position=position, size=size, is_maximized=True)
    found = fitted(stored, present)
    assert (found.position, found.size, found.is_maximized) == (*expected, True)

"""The real window under Xvfb, and what a hand on mouse and keyboard can do with it."""

import os
import shutil
import signal
from contextlib import contextmanager
from importlib.metadata import version

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image, ImageGrab

from gsrain_engine.editor.editor import Editor
from gsrain_engine.render.opengl.context import NoOpenGLError
from small_scene import small_scene

if not (os.environ.get("DISPLAY") or shutil.which("Xvfb")):
    pytest.skip("no display and no Xvfb (Debian: xvfb)", allow_module_level=True)

testing = pytest.importorskip("imgui_bundle.immapp.testing")
imgui = pytest.importorskip("imgui_bundle").imgui
hello_imgui = pytest.importorskip("imgui_bundle").hello_imgui

from ui.window import MainWindow  # noqa: E402


def shrink_painting():
    """Shrink what is painted, while nobody looks: the processor paints it, which takes most of a frame's time."""
    scale = imgui.ImVec2(1 / 16, 1 / 16)
    imgui.get_io().display_framebuffer_scale = imgui.get_main_viewport().framebuffer_scale = scale


def wait_for_double_clicks():
    """Let the machine be busy between two clicks of a double click."""
    io = imgui.get_io()
    io.mouse_double_click_time, io.mouse_single_click_delay = 60.0, 61.0  # s


class Driver:
    """A window, and what a hand on mouse and keyboard can do."""

    def __init__(self, tmp_path, scene=None, backend="auto"):
        self.editor = Editor(scene or small_scene())
        self.editor.playback.clock.playing = False
        self.window = MainWindow(lambda: self.editor, backend)
        self.folder = tmp_path
        self.size_px, self.dpi_scale = (1100, 720), 1.0  # without a size, as the last window was closed
        self.layout = None
        """File of the layout of docks, which the window reads and writes; None for the default one."""
        self.ctx = None
        self.actions = 0
        """Clicks, drags, keys and typed values up to now."""
        self._is_seen = self._is_over = False

    def run(self, script):
        self.editor.viewport.options.shrink = 4  # coarse, but for `picture`: it is drawn after each action
        self.editor.preferences.value = replace(
            self.editor.preferences.value, desktop_dialogs=False, hint=False, known_version=version("gsrain")
        )
        parameters = self.window.parameters()
        parameters.ini_disable = self.layout is None
        parameters.ini_folder_type = hello_imgui.IniFolderType.absolute_path
        parameters.ini_filename = str(self.layout or "")
        if self.size_px is not None:
            parameters.app_window_params.window_geometry.size = self.size_px
        parameters.dpi_aware_params.dpi_window_size_factor = self.dpi_scale
        parameters.callbacks.before_imgui_render = self._before_painting

        def act(ctx):
            self.ctx = ctx
            engine = imgui.test_engine.get_io(hello_imgui.get_imgui_test_engine())
            engine.config_watchdog_kill_test = engine.config_watchdog_warning = 600.0  # s; the machine may be busy
            self.until(lambda: self.window.workspace is not None or self.window.failure is not None, 100_000)
            assert self.window.failure is None
            self.window.workspace.max_fps = 0.0
            wait_for_double_clicks()
            self.until(lambda: self.pictures.is_settled, 100_000)
            self.frames(3)
            try:
                script()
            finally:
                self._is_over = True

        try:
            testing.run(test_function=act, runner_params=parameters)
        except (AssertionError, RuntimeError):
            if isinstance(self.window.failure, NoOpenGLError):
                pytest.skip(str(self.window.failure))
            if self.window.failure is not None:
                raise self.window.failure from None
            raise
        finally:
            # The test engine takes all signals of a crash, and a closed pipe for one: what Python does is set again.
            signal.signal(signal.SIGPIPE, signal.SIG_IGN)

    @property
    def pictures(self):
        return self.window.workspace.pictures

    def tool(self, name):
        return next(each for each in self.window.workspace.tools if each.name == name)

    def frames(self, count=2):
        """Let frames go by, and at rest also those until the picture shows what they have changed."""
        for _ in range(count):
            self.ctx.yield_()
        if self.window.workspace is not None and not self.editor.playback.clock.playing:
            results = [self.pictures.last]

            def is_current():
                if self.editor.should_quit or self.window.failure is not None:
                    return True
                if self.pictures.last is not results[-1]:
                    results.append(self.pictures.last)
                viewport = self.editor.viewport
                is_dragged = viewport.drawn_preview is not None  # a new value in each frame
                is_shown = self.pictures.is_current and not viewport.budget.is_settling
                # The second was begun after those frames.
                return len(results) > 2 and (is_dragged or is_shown)

            self.until(is_current)

    def until(self, condition, most=4000, silence_s=0.1):
        for _ in range(most):
            if condition():
                return
            self.let_workers_work(silence_s)
            self.ctx.yield_()
        raise AssertionError("waited in vain")

    def until_worked(self, condition):
        """Wait for the worker of a job, which says what is new: frames meanwhile would only take its processor."""
        self.until(condition, 100_000, silence_s=2.0)

    def let_workers_work(self, silence_s=0.1):
        """Draw no frames that would only take the processor from a picture or a worker with nothing to say yet."""
        if self.window.workspace is not None:
            self.pictures.wait(0.1)
        self.editor.jobs.wait(silence_s)

    @contextmanager
    def journey(self, actions):
        """Count what a hand does meanwhile: it is as many clicks, drags, keys and typed values as stated."""
        before = self.actions
        yield
        taken = self.actions - before
        assert taken == actions, f"{taken} actions, not {actions}"

    def panel(self, title):
        """Bring a panel to the front, by its tab or its name in a small window's strip; returns where its items are."""
        folded = self.window.workspace.folded
        if title in folded.hidden:
            if folded.open != title:
                self.tap(f"//**/###fold {title}")
            return f"//###open panel/{title}/"
        window = self.ctx.window_info(f"//{title}").window
        self.actions += window.hidden  # a click on its tab
        self.ctx.window_focus(f"//{title}")
        self.frames()
        return f"//{title}/"

    def click(self, item):
        self.ctx.window_focus("//" + item.split("/")[2])  # bring its tab to the front
        self.frames()
        self.ctx.item_click(item)
        self.actions += 1
        self.frames()

    def tap(self, item):
        """Click an item of a window that is in front, as a hand does: first it gets there."""
        self.ctx.mouse_move(item)
        self.ctx.yield_()
        self.ctx.item_click(item)
        self.actions += 1
        self.frames(3)

    def double_click(self, item):
        self.ctx.item_double_click(item)
        self.actions += 1
        self.frames(3)

    def choose(self, item, choice):
        """Open a list, and click on one of its rows."""
        self.tap(item)
        self.tap(f"//{self.ctx.window_info('//$FOCUSED').window.name}/**/{choice}")

    def menu(self, place):
        """Click through a menu, as "Rain/Heavy 12 mm/h"."""
        self.ctx.set_ref("//##MainMenuBar")
        self.ctx.menu_click(place)
        self.ctx.set_ref("")
        self.actions += place.replace("\\/", "").count("/") + 1
        self.frames(3)

    def type_in(self, item, value):
        self.ctx.item_input_value(item, value)
        self.actions += 1
        self.frames()

    def drag(self, item, pixels):
        self.ctx.item_drag_with_delta(item, pixels)
        self.actions += 1
        self.frames()

    def area(self, item="//View/view"):
        """Corner and size of an item on the screen, by default of the picture."""
        rect = self.ctx.item_info(item).rect_full
        return np.array([rect.min.x, rect.min.y]), np.array([rect.get_width(), rect.get_height()])

    def at(self, x, y):
        """Screen position of a place in the picture, as shares of its width and height."""
        corner, size = self.area()
        return corner + size * [x, y]

    def on_screen(self, point_m):
        """Screen position of a world point."""
        corner, (width, height) = self.area()
        camera = self.editor.viewport.shot(int(width), int(height)).camera
        x, y, z = camera.world_to_camera[:3] @ np.append(point_m, 1.0)
        return corner + [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]

    def point_at(self, place):
        self.ctx.mouse_move_to_pos(imgui.ImVec2(*map(float, place)))
        self.frames()

    def click_at(self, place, button=0):
        self.point_at(place)
        self.ctx.mouse_click(button)
        self.actions += 1
        self.frames()

    def stroke(self, *places, held=(), button=0, lets_go=True):
        """Press at the first place of the screen, go through the others, and let go; keys are held meanwhile."""
        self.point_at(places[0])
        self.actions += 1
        for key in held:
            self.ctx.key_down(key)
            self.frames()
        self.ctx.mouse_down(button)
        self.frames()
        for place in places[1:]:
            self.ctx.mouse_move_to_pos(imgui.ImVec2(*map(float, place)))
            self.ctx.yield_()
            self.ctx.yield_()
        self.frames()
        if lets_go:
            self.ctx.mouse_up(button)
            self.frames()
        for key in held:
            self.ctx.key_up(key)
            self.frames()

    def choose_file(self, title, path):
        """Type a place into a file dialog, with Enter."""
        self.frames(3)
        self.ctx.item_click(f"//{title}/##name")
        self.enter(str(path))

    def enter(self, text):
        """Type into the field that has the focus, with Enter."""
        self.ctx.key_chars_replace_enter(text)
        self.actions += 1
        self.frames(3)

    def is_open(self, title):
        """Tell whether a dialog is on the screen."""
        info = self.ctx.window_info(f"//{title}", imgui.test_engine.TestOpFlags_.no_error)
        return info.window is not None and info.window.active

    def press(self, chord):
        self.ctx.key_press(chord)
        self.actions += 1
        self.frames()

    def screen(self):
        """The window, as a person sees it: RGB values from 0 to 255."""
        self._is_seen = True
        self.frames(3)
        self._is_seen = False
        width, height = (round(side * self.dpi_scale) for side in self.size_px)
        return np.asarray(ImageGrab.grab(xdisplay=None).convert("RGB")).astype(int)[:height, :width]

    def _before_painting(self):
        if self._is_over:  # a window at rest would close seconds later
            hello_imgui.get_runner_params().fps_idling.enable_idling = False
        if not self._is_seen:
            shrink_painting()

    def picture(self):
        """Image of the viewport, by the screenshot command, with all pixels."""
        path = self.folder / f"picture{len(list(self.folder.iterdir()))}.png"
        options = self.editor.viewport.options
        shrink, options.shrink = options.shrink, 1
        self.ctx.yield_()  # to have what was changed before taken over
        self.editor.viewport.screenshot = path
        self.until(path.exists)
        options.shrink = shrink
        return np.asarray(Image.open(path)).astype(int)

"""A mouse whose events come from the X server, several of them between two frames."""

import ctypes

from imgui_bundle import glfw_utils, immapp

import glfw  # isort: skip
from gsrain_engine.editor.editor import Editor
from small_scene import small_scene
from ui.window import MainWindow
from window_driver import hello_imgui, imgui

_FRAMES = 6  # in which the window has to have answered: move, press and release take one each
_PRESS, _RELEASE, _MOTION = 4, 5, 6  # numbers of the X protocol
_LEFT, _LEFT_IS_DOWN = 1, 1 << 8


class XEvent(ctypes.Structure):
    """Event of a button or of the pointer, as Xlib lays it out."""

    _fields_ = (
        ("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int), ("display", ctypes.c_void_p),
        *((name, ctypes.c_ulong) for name in ("window", "root", "subwindow", "time")),
        *((name, ctypes.c_int) for name in ("x", "y", "x_root", "y_root")),
        ("state", ctypes.c_uint), ("button", ctypes.c_uint), ("same_screen", ctypes.c_int),
        ("room", ctypes.c_long * 24),
    )  # fmt: skip


class XMouse:
    """Sends events to the open window, as other programs may."""

    def __init__(self):
        self._x11 = ctypes.CDLL("libX11.so.6")
        self._x11.XOpenDisplay.restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(None))

    def click(self, place):
        """Move to a place, press and let go, all before the next frame."""
        for kind, state, button in ((_MOTION, 0, 0), (_PRESS, 0, _LEFT), (_RELEASE, _LEFT_IS_DOWN, _LEFT)):
            window = glfw.get_x11_window(glfw_utils.glfw_window_hello_imgui())
            event = XEvent(kind, window=window, x=round(place.x), y=round(place.y), state=state, button=button)
            event.same_screen = 1
            assert self._x11.XSendEvent(self._display, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(event))
        self._x11.XSync(self._display, 0)

    def close(self):
        self._x11.XCloseDisplay(self._display)


def run_in_frames(script):
    """Open a window and go on with the script in each of its frames, without the test engine: it has its own mouse."""
    editor = Editor(small_scene())
    editor.playback.clock.playing = False
    steps = script()

    def go_on(_workspace):
        if next(steps, script) is script:
            hello_imgui.get_runner_params().app_shall_exit = True

    window = MainWindow(lambda: editor, "opengl-quads", on_frame=go_on)
    parameters = window.parameters()
    parameters.ini_disable = True
    immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    window.close()
    if window.failure is not None:
        raise window.failure


def test_a_click_that_comes_with_the_move_to_its_tab_counts():
    clicks = ("History", "Select", "Layers", "Jobs", "Edit", "Timeline")
    answers = []

    def script():
        mouse = XMouse()
        yield from (None for _ in range(_FRAMES))
        for title in clicks:
            window = imgui.internal.find_window_by_name(title)
            mouse.click(window.dc.dock_tab_item_rect.get_center())
            yield from (None for _ in range(_FRAMES))
            answers.append(not window.hidden)
        mouse.close()

    run_in_frames(script)
    assert answers == [True] * len(clicks)

"""Mouse and keyboard whose events come from the X server, several of them between two frames."""

import ctypes
import time
from contextlib import suppress

import numpy as np
import pytest
from imgui_bundle import ImVec2, glfw_utils, immapp

import glfw  # isort: skip
from gsrain_engine.editor.editor import Editor
from small_scene import small_scene
from ui.commands.keys import chord
from ui.input_queue import XEvent
from ui.widgets.numbers import slide
from ui.widgets.text import key_names
from ui.window import MainWindow
from window_driver import hello_imgui, imgui, shrink_painting, wait_for_double_clicks

try:
    _XTST = ctypes.CDLL("libXtst.so.6")
except OSError:
    pytest.skip("no XTEST library (Debian: libxtst6)", allow_module_level=True)

_FRAMES = 6  # in which the window has to have answered: move, press and release take one each
_PRESS, _RELEASE = 4, 5  # numbers of the X protocol
_LEFT, _LEFT_IS_DOWN = 1, 1 << 8
_CTRL, _CMD, _BACKSPACE, _ENTER = (
    0xFFE3,
    0xFFEB,
    0xFF08,
    0xFF0D,
)  # numbers of X keys; those of letters are their characters
_PANELS = ("Short", "Long")  # the second one has a scroll bar
_BUTTONS = 8


class XInput:
    """Mouse and keyboard of the X server that the open window is on."""

    def __init__(self):
        self._x11 = ctypes.CDLL("libX11.so.6")
        self._x11.XOpenDisplay.restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(None))
        self._window = glfw_utils.glfw_window_hello_imgui()
        glfw.focus_window(self._window)

    def move(self, place):
        left, top = glfw.get_window_pos(self._window)
        _XTST.XTestFakeMotionEvent(self._display, -1, left + round(place.x), top + round(place.y), 0)

    def button(self, is_down):
        _XTST.XTestFakeButtonEvent(self._display, _LEFT, is_down, 0)

    def key(self, symbol, is_down):
        code = self._x11.XKeysymToKeycode(self._display, ctypes.c_ulong(symbol))
        # GLFW ignores a second press of a key in the same millisecond.
        _XTST.XTestFakeKeyEvent(self._display, code, is_down, ctypes.c_ulong(2))

    def button_at(self, place, is_down, time_ms):
        """Send an event of the button as of a time of the X server, in ms."""
        window = glfw.get_x11_window(self._window)
        event = XEvent(_PRESS if is_down else _RELEASE, window=window, x=round(place.x), y=round(place.y), button=_LEFT)
        event.state, event.time, event.same_screen = 0 if is_down else _LEFT_IS_DOWN, time_ms % 2**32, 1
        self._x11.XSendEvent(self._display, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(event))

    def sync(self):
        """Wait until all events have come to the window's connection."""
        for display in (self._display, ctypes.c_void_p(glfw.get_x11_display())):
            self._x11.XSync(display, 0)

    def close(self):
        self._x11.XCloseDisplay(self._display)


class Panels(MainWindow):
    """A window with two panels of a few widgets, instead of an editor."""

    def __init__(self, frame_ms):
        super().__init__(lambda: None)
        self.frame_ms = frame_ms
        self.places, self.answers, self.values = {}, [], dict.fromkeys(_PANELS, 0.0)
        self.answered, self.texts = dict(self.values), dict.fromkeys(_PANELS, "")

    def _load(self):
        pass

    def run(self, script):
        """Go on with a script in each frame; for Dear ImGui, each takes as long as stated."""
        parameters = self.parameters()
        parameters.ini_disable, parameters.fps_idling.fps_max = True, 0.0
        parameters.app_window_params.window_geometry.size = (640, 480)
        parameters.docking_params.docking_splits = [
            hello_imgui.DockingSplit("MainDockSpace", "Right", imgui.Dir.right, 0.5)
        ]
        parameters.docking_params.dockable_windows = [
            hello_imgui.DockableWindow(panel, space, lambda panel=panel: self._draw(panel))
            for panel, space in zip(_PANELS, ("MainDockSpace", "Right"), strict=True)
        ]
        steps = script()

        def go_on():
            glfw.set_time(glfw.get_time() + self.frame_ms / 1000)
            shrink_painting()
            with suppress(StopIteration):
                return next(steps)
            hello_imgui.get_runner_params().app_shall_exit = True

        parameters.callbacks.before_imgui_render = go_on
        immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
        self.close()
        if self.failure is not None:
            raise self.failure

    def _draw(self, panel):
        for number in range(_BUTTONS):
            if imgui.button(f"Button {number}"):
                self.answers.append(("click", panel, number))
            self._note_place(panel, number)
            if imgui.begin_popup_context_item():
                self.answers.append(("right click", panel, number))
                imgui.close_current_popup()
                imgui.end_popup()
        if imgui.selectable("Row", False, imgui.SelectableFlags_.allow_double_click)[0]:
            self.answers.append(("double" if imgui.is_mouse_double_clicked(0) else "single", panel))
        self._note_place(panel, "row")
        _, self.values[panel] = slide("##value", self.values[panel], 0.0, 1.0, "%.2f")
        if not imgui.is_any_item_active() and self.values[panel] != self.answered[panel]:
            self.answers.append(("drag", panel, round(self.values[panel], 1)))
            self.answered[panel] = self.values[panel]
        self._note_place(panel, "slider")
        is_entered, self.texts[panel] = imgui.input_text(
            "##text", self.texts[panel], imgui.InputTextFlags_.enter_returns_true
        )
        if is_entered:
            self.answers.append(("text", panel, self.texts[panel]))
        self._note_place(panel, "text")
        imgui.dummy(ImVec2(10, 900 if panel == "Long" else 1))
        if panel == "Short" and imgui.is_key_chord_pressed(chord(imgui.Key.mod_ctrl, imgui.Key.p)):
            imgui.open_popup("Dialog")
            self.texts["Dialog"] = ""
        if imgui.begin_popup_modal("Dialog")[0]:
            if imgui.is_window_appearing():
                imgui.set_keyboard_focus_here()
            flags = imgui.InputTextFlags_.enter_returns_true
            is_entered, self.texts["Dialog"] = imgui.input_text("##name", self.texts["Dialog"], flags)
            if is_entered:
                self.answers.append(("text", "Dialog", self.texts["Dialog"]))
                imgui.close_current_popup()
            imgui.end_popup()
        if panel == "Short" and imgui.is_key_chord_pressed(int(imgui.Key.i)):
            self.answers.append(("key", "I"))
        if panel == "Short" and imgui.is_key_chord_pressed(chord(imgui.Key.mod_ctrl, imgui.Key.i)):
            self.answers.append(("key", "Ctrl+I"))

    def _note_place(self, panel, name):
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        self.places[panel, name] = lambda x=0.5: ImVec2(low.x + x * (high.x - low.x), (low.y + high.y) / 2)


class Hand:
    """Plan of what a quick hand does: events of `XInput` with their times in ms."""

    def __init__(self, window):
        self.window, self.random = window, np.random.default_rng(1)
        self.events, self.time_ms, self.expected = [], 0, []

    def do(self, later_ms, name, *arguments):
        self.time_ms += later_ms
        self.events.append((self.time_ms, name, arguments))

    def pause(self):
        self.time_ms += round(self.window.frame_ms * self.random.uniform(1.5, 2.5))

    def press(self, place):
        self.pause()
        self.do(0, "move", place)
        self.do(0, "button", True)

    def hold(self):
        return self.random.integers(60, 121)

    def click(self, panel, number, hold_ms):
        self.press(self.window.places[panel, number](0.5))
        self.do(hold_ms, "button", False)
        self.expected.append(("click", panel, number))

    def double_click(self, panel):
        self.press(self.window.places[panel, "row"](0.1))
        for is_down in (False, True, False):
            self.do(self.hold(), "button", is_down)
        self.expected += [("single", panel), ("double", panel)]

    def drag(self, panel, *shares):
        places = [self.window.places[panel, "slider"](share) for share in np.linspace(*shares, 4)]
        self.press(places[0])
        for place in places[1:]:
            self.do(20, "move", place)
        self.do(0, "button", False)
        self.expected.append(("drag", panel, shares[-1]))

    def shortcut(self, with_ctrl):
        """Press I, and let Ctrl go first."""
        self.pause()
        if with_ctrl:
            self.do(0, "key", _CTRL, True)
        self.do(20, "key", ord("i"), True)
        if with_ctrl:
            self.do(self.hold(), "key", _CTRL, False)
        self.do(10, "key", ord("i"), False)
        self.expected.append(("key", "Ctrl+I" if with_ctrl else "I"))

    def type_in(self, panel):
        """Type a word with a mistake into a field."""
        self.press(self.window.places[panel, "text"](0.5))
        self.do(self.hold(), "button", False)
        for symbol in (*map(ord, "bll"), _BACKSPACE, _BACKSPACE, *map(ord, "ee"), _ENTER):
            self.do(10, "key", symbol, True)
            self.do(20, "key", symbol, False)
        self.expected.append(("text", panel, "bee"))

    def type_in_dialog(self):
        """Type a word into a dialog that a shortcut opens."""
        self.pause()
        self.do(0, "key", _CTRL, True)
        for symbol in map(ord, "pab"):
            self.do(10, "key", symbol, True)
            self.do(20, "key", symbol, False)
            if symbol == ord("p"):
                self.do(0, "key", _CTRL, False)
        for is_down in (True, False):
            self.do(10, "key", _ENTER, is_down)
        self.expected.append(("text", "Dialog", "ab"))

    def type_number(self, panel):
        """Type a number after a double click on a slider."""
        self.press(self.window.places[panel, "slider"](0.5))
        for is_down in (False, True, False):
            self.do(self.hold(), "button", is_down)
        for symbol in (*map(ord, "0.5"), _ENTER):
            self.do(10, "key", symbol, True)
            self.do(20, "key", symbol, False)
        self.expected.append(("drag", panel, 0.5))


@pytest.mark.parametrize("frame_ms", [200, 40])
def test_nothing_is_lost_and_nothing_becomes_another_thing_at_any_frame_rate(frame_ms):
    window = Panels(frame_ms)
    hand = Hand(window)

    def script():
        yield from range(_FRAMES)
        for number in range(50):
            hand.click(_PANELS[number % 2], number % _BUTTONS, 700 if number % 10 == 0 else hand.hold())
        for number in range(20):
            hand.double_click(_PANELS[number % 2])
        for number in range(20):
            hand.drag(_PANELS[number % 2], *((0.2, 0.8) if number % 4 < 2 else (0.8, 0.2)))
        for number in range(20):
            hand.shortcut(with_ctrl=number % 2 == 0)
        for panel in _PANELS:
            hand.type_in(panel)
            hand.type_number(panel)
        hand.type_in_dialog()
        wait_for_double_clicks()
        x_input, events = XInput(), iter(hand.events)
        due = next(events)
        for frame in range(2 * hand.time_ms // frame_ms):  # those of the second half are for what waits at the end
            while due is not None and due[0] < frame * frame_ms:
                getattr(x_input, due[1])(*due[2])
                due = next(events, None)
            x_input.sync()
            if due is None and len(window.answers) >= len(hand.expected):
                break
            yield
        yield from range(_FRAMES)
        x_input.close()

    window.run(script)
    assert window.answers == hand.expected


def test_double_clicks_are_measured_between_the_presses_however_long_frames_take():
    window = Panels(200)
    cases = [(350, 0), (450, 0), (350, 2), (450, 2)]  # time in ms and frames from a press to the next

    def script():
        yield from range(_FRAMES)
        x_input, start_ms = XInput(), int(1000 * time.monotonic()) - 10_000
        for number, (apart_ms, frames) in enumerate(cases):
            place = window.places[_PANELS[number % 2], "row"](0.5)
            x_input.move(place)
            for press_ms in (start_ms, start_ms + apart_ms):
                x_input.button_at(place, True, press_ms)
                x_input.button_at(place, False, press_ms + 80)
                x_input.sync()
                yield from range(frames)
            yield from range(2 * _FRAMES)
            start_ms += 1000
        x_input.close()

    window.run(script)
    answers = [answer for answer, _ in window.answers]
    assert answers == ["single", "double", "single", "single"] * 2


def test_cmd_is_ctrl_and_is_named_so_where_dear_imgui_behaves_as_on_macos():
    window, named = Panels(40), []

    def script():
        yield from range(_FRAMES)
        named.append(key_names("Undo (Ctrl+Z)"))
        imgui.get_io().config_mac_osx_behaviors = True
        named.append(key_names("Undo (Ctrl+Z)"))
        x_input = XInput()
        for modifier in (_CTRL, _CMD):
            for symbol, is_down in ((modifier, True), (ord("i"), True), (ord("i"), False), (modifier, False)):
                x_input.key(symbol, is_down)
            x_input.sync()
            yield from range(_FRAMES)
        x_input.close()

    window.run(script)
    assert window.answers == [("key", "Ctrl+I")]
    assert named == ["Undo (Ctrl+Z)", "Undo (Cmd+Z)"]


def run_in_frames(script):
    """Open a window and go on with the script in each of its frames, without the test engine: it has its own mouse."""
    editor = Editor(small_scene())
    editor.playback.clock.playing = False
    steps = script(editor)

    def go_on(_workspace):
        if next(steps, script) is script:
            hello_imgui.get_runner_params().app_shall_exit = True

    window = MainWindow(lambda: editor, "opengl-quads", on_frame=go_on)
    parameters = window.parameters()
    parameters.ini_disable, parameters.callbacks.before_imgui_render = True, shrink_painting
    immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    window.close()
    if window.failure is not None:
        raise window.failure


def test_clicks_on_tabs_and_in_panels_that_scroll_count(monkeypatch):
    tabs, presets = ("History", "Select", "Layers", "Jobs", "Edit", "Timeline", "Rain"), ("12", "1.2", "0", "8.5")
    places, answers = {}, []

    def noting_places(draw):
        def noting_place(text, *arguments):
            drawn = draw(text, *arguments)
            low = imgui.get_item_rect_min()
            places[text.rpartition("#")[2]] = ImVec2(low.x + 8, low.y + 8)
            return drawn

        return noting_place

    for name in ("button", "checkbox"):
        monkeypatch.setattr(imgui, name, noting_places(getattr(imgui, name)))

    def script(editor):
        yield from range(_FRAMES)
        x_input = XInput()

        def click(place):
            x_input.move(place)
            x_input.button(True)
            x_input.button(False)
            x_input.sync()
            yield from range(_FRAMES)

        for title in tabs:
            window = imgui.internal.find_window_by_name(title)
            yield from click(window.dc.dock_tab_item_rect.get_center())
            answers.append(not window.hidden)
        assert imgui.internal.find_window_by_name("Rain").scroll_max.y > 0
        for preset in presets:
            yield from click(places[preset])
            answers.append(editor.document.rain.intensity_mm_h)
        for _ in range(2):
            yield from click(places["Streaks"])
            answers.append(editor.document.rain.streaks)
        x_input.close()

    run_in_frames(script)
    assert answers == [True] * len(tabs) + [12.0, 1.2, 0.0, 8.5] + [False, True]

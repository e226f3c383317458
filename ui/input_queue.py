"""Events of mouse and keyboard, delivered to Dear ImGui in frames of their own, so that none is lost at any frame rate.

Dear ImGui merges most of what comes between two frames. So it loses a press that comes with the move to its place (a
tab or an overlapped item counts it only if the mouse was over it one frame before), the end of a drag that comes with
the release, and the Ctrl of a shortcut that comes with Ctrl's release; and it measures double clicks between frames.
Here a frame ends before and after each press and release of a button, after each press of a key, and before keys that
follow the mouse; double clicks are measured between the presses. What is typed after a press that opens a text field
waits until the field can have it.
"""

import ctypes
import math
import time
from collections import deque
from collections.abc import Callable
from itertools import takewhile
from typing import Any

from imgui_bundle import imgui

import glfw  # isort: skip

_MODIFIERS = range(glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SUPER + 1)
_Type = imgui.internal.InputEventType
_DOUBLE_CLICK_S = 0.4  # between the presses, as in GTK and Qt
_OPENING_FRAMES = 4  # after a press, in which a dialog opens, a text field in it appears, and gets the focus


class InputQueue:
    """Queue of a window's events, which Dear ImGui's own callbacks translate."""

    def __init__(self, window: Any) -> None:
        """`window` is GLFW's, with the callbacks of Dear ImGui."""
        self._window = window
        imgui.get_io().mouse_double_click_time = _DOUBLE_CLICK_S
        self._ends = deque[int]()
        """Ids of the events that are the last of their frames."""
        self._presses = dict[int, tuple[int, bool]]()
        """Button of each press that waits, by the event's id, and whether it continues a double click."""
        self._typed = set[int]()
        """Ids of the characters that wait."""
        self._opening = 0
        """Frames in which the last press may still open a text field."""
        self._pressed_s = dict[int, float]()
        """Time of the last press of each button."""
        self._later = imgui.ImVector_InputEvent(), 0
        """Copy of the queue during a frame, and the number of its events that are not for later frames."""
        self._has_left = False
        self._times = X11PressTimes(window) if glfw.get_platform() == glfw.PLATFORM_X11 else None
        self._of_imgui = dict[str, Callable[..., None]]()
        self._callbacks = [  # have to live as long as the window
            self._replace("MouseButton", glfw._GLFWmousebuttonfun, self._on_button),
            self._replace("Key", glfw._GLFWkeyfun, self._on_key),
            self._replace("Char", glfw._GLFWcharfun, self._on_character),
            self._replace("CursorEnter", glfw._GLFWcursorenterfun, self._on_enter),
        ]

    def begin_frame(self) -> bool:
        """Leave in the queue what the next frame takes, before `imgui.new_frame`; returns whether more waits."""
        queue, io = _queue(), imgui.get_io()
        io.config_input_trickle_event_queue = True
        if self._has_left and not len(queue):
            self._has_left = False
            self._of_imgui["CursorEnter"](self._window, 0)
        while self._ends and (not len(queue) or self._ends[0] < queue[0].event_id):
            self._presses.pop(self._ends[0], None)
            self._typed.discard(self._ends.popleft())
        self._opening = max(self._opening - 1, 0)
        if not self._ends:
            return False
        end, events = self._ends[0], imgui.ImVector_InputEvent(queue)
        if end in self._typed and self._opening and not io.want_text_input:
            queue.clear()
            self._later = events, 0
            return True
        self._opening = _OPENING_FRAMES
        if io.want_text_input and end in self._typed:  # a text field takes any number of characters at once
            end = list(takewhile(self._typed.__contains__, self._ends))[-1]
            io.config_input_trickle_event_queue = False
        if end in self._presses:
            button, is_repeated = self._presses[end]
            io.mouse_clicked_time[button] = math.inf if is_repeated else -math.inf
        while queue[len(queue) - 1].event_id > end:
            queue.pop_back()
        self._later = events, len(queue)
        return len(events) > len(queue)

    def continue_frame(self) -> None:
        """Return to the queue what later frames take, after `imgui.new_frame`."""
        events, count = self._later
        for number in range(count, len(events)):
            _queue().push_back(events[number])
        self._later = imgui.ImVector_InputEvent(), 0

    def end_frame(self) -> bool:
        """Read the events that have come meanwhile, with the times of presses; returns whether any wait."""
        if self._times is not None:
            self._times.read()
            glfw.poll_events()  # at once: presses that come between both have no times
        return len(_queue()) > 0

    def _replace(self, name: str, kind: Any, callback: Callable[..., None]) -> object:
        """Replace a callback of Dear ImGui, which the functions of the glfw package would not return."""
        replacement = kind(callback)
        self._of_imgui[name] = getattr(glfw._glfw, f"glfwSet{name}Callback")(self._window, replacement)
        return replacement

    def _end_here(self) -> None:
        """End a frame after the newest event."""
        queue = _queue()
        if len(queue) and (not self._ends or self._ends[-1] != queue[len(queue) - 1].event_id):
            self._ends.append(queue[len(queue) - 1].event_id)

    def _on_button(self, window: Any, button: int, action: int, modifiers: int) -> None:
        if _newest_type() == _Type.mouse_pos:
            self._end_here()
        self._of_imgui["MouseButton"](window, button, action, modifiers)
        self._end_here()
        if action == glfw.PRESS and _newest_type() == _Type.mouse_button:
            now_s, late_s = self._times.take() if self._times is not None else (time.monotonic(), 0.0)
            since_s = now_s - late_s - self._pressed_s.get(button, -math.inf)
            self._presses[self._ends[-1]] = button, since_s < imgui.get_io().mouse_double_click_time
            self._pressed_s[button] = now_s

    def _on_key(self, window: Any, key: int, code: int, action: int, modifiers: int) -> None:
        if _newest_type() not in (_Type.key, _Type.text):
            self._end_here()
        self._of_imgui["Key"](window, key, code, action, modifiers)
        if action == glfw.PRESS and key not in _MODIFIERS:
            self._end_here()

    def _on_character(self, window: Any, character: int) -> None:
        """Let a character share the frame of its key: if that opens a text field, the character is not for it."""
        queue = _queue()
        is_of_key = len(queue) > 0 and bool(self._ends) and self._ends[-1] == queue[len(queue) - 1].event_id
        is_of_key = is_of_key and _newest_type() in (_Type.key, _Type.text)
        self._of_imgui["Char"](window, character)
        if is_of_key:
            self._typed.discard(self._ends.pop())
        self._end_here()
        if self._ends:
            self._typed.add(self._ends[-1])

    def _on_enter(self, window: Any, entered: int) -> None:
        """Let the mouse leave after all events: Dear ImGui would move those that wait to where the mouse is by then."""
        self._has_left = not entered and len(_queue()) > 0
        if not self._has_left:
            self._of_imgui["CursorEnter"](window, entered)


def _queue() -> imgui.ImVector_InputEvent:
    return imgui.get_current_context().input_events_queue


def _newest_type() -> imgui.internal.InputEventType:
    queue = _queue()
    return queue[len(queue) - 1].type if len(queue) else _Type.none


class X11PressTimes:
    """Times at which the X server got the presses of buttons; GLFW passes none, and reads them once per frame."""

    def __init__(self, window: Any) -> None:
        self._x11 = ctypes.CDLL("libX11.so.6")
        self._display = ctypes.c_void_p(glfw.get_x11_display())
        self._window = glfw.get_x11_window(window)
        self._waiting_s = deque[float]()
        self._read_s = time.monotonic()

    def read(self) -> None:
        """Read the events that wait, and put them back."""
        self._waiting_s.clear()
        self._read_s = time.monotonic()
        events = (XEvent * self._x11.XEventsQueued(self._display, _QUEUED_AFTER_READING))()
        for event in events:
            self._x11.XNextEvent(self._display, ctypes.byref(event))
            if event.type == _BUTTON_PRESS and event.window == self._window and event.button not in _WHEEL:
                self._waiting_s.append(_local_s(event.time))
        for event in reversed(events):
            self._x11.XPutBackEvent(self._display, ctypes.byref(event))

    def take(self) -> tuple[float, float]:
        """Return the time in s of the press that GLFW delivers now, as of `time.monotonic`, and how early it may be."""
        if self._waiting_s:
            return self._waiting_s.popleft(), 0.0
        now_s = time.monotonic()
        return now_s, min(now_s - self._read_s, _MAX_LATE_S)


_QUEUED_AFTER_READING, _BUTTON_PRESS, _WHEEL = 1, 4, range(4, 8)  # numbers of Xlib and of the X protocol
_MAX_AGE_MS = 60_000
_MAX_LATE_S = 0.15  # a busy machine may stop the program for longer, and one at rest delivers events at once


def _local_s(server_ms: int) -> float:
    """Convert a time of an X server: that of a local one counts from the same start, another's is not known here."""
    now_s = time.monotonic()
    age_ms = (int(1000 * now_s) - server_ms) % 2**32
    return now_s - age_ms / 1000 if age_ms < _MAX_AGE_MS else now_s


class XEvent(ctypes.Structure):
    """Event as Xlib lays out that of a button, in the size of the largest."""

    _fields_ = (
        ("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int), ("display", ctypes.c_void_p),
        *((name, ctypes.c_ulong) for name in ("window", "root", "subwindow", "time")),
        *((name, ctypes.c_int) for name in ("x", "y", "x_root", "y_root")),
        ("state", ctypes.c_uint), ("button", ctypes.c_uint), ("same_screen", ctypes.c_int),
        ("padding", ctypes.c_int * 25),
    )  # fmt: skip

"""An OpenGL context without a window whose driver tells when it is lost (EGL 1.5, on a device)."""

import ctypes
import ctypes.util
import os
from typing import Any

_POINTER, _INT = ctypes.c_void_p, ctypes.c_int
_OPENGL_API, _PLATFORM_DEVICE, _DRAW = 0x30A2, 0x313F, 0x3059
_MOST_DEVICES = 64
_CONFIG = (
    0x3033, 0x0001,  # EGL_SURFACE_TYPE, EGL_PBUFFER_BIT
    0x3040, 0x0008,  # EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT
    0x3038,  # EGL_NONE
)  # fmt: skip
_CONTEXT = (
    0x3098, 4,  # EGL_CONTEXT_MAJOR_VERSION
    0x30FB, 3,  # EGL_CONTEXT_MINOR_VERSION
    0x30FD, 0x0001,  # EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT
    0x31BD, 0x31BF,  # EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY, EGL_LOSE_CONTEXT_ON_RESET
    0x3038,  # EGL_NONE
)  # fmt: skip


class EglContext:
    """The loader object that moderngl asks for entry points. Raises `OSError` where there is no such context."""

    def __init__(self) -> None:
        library = ctypes.CDLL(ctypes.util.find_library("EGL") or "libEGL.so.1")
        self._address = _function(library.eglGetProcAddress, _POINTER, ctypes.c_char_p)
        self._current = _function(library.eglGetCurrentContext, _POINTER)
        self._current_display = _function(library.eglGetCurrentDisplay, _POINTER)
        self._current_surface = _function(library.eglGetCurrentSurface, _POINTER, _INT)
        self._make_current = _function(library.eglMakeCurrent, _INT, *[_POINTER] * 4)
        self._destroy = _function(library.eglDestroyContext, _INT, _POINTER, _POINTER)
        self._display, config = self._device(), _POINTER()
        initialize = _function(library.eglInitialize, _INT, *[_POINTER] * 3)
        choose = _function(library.eglChooseConfig, _INT, _POINTER, _POINTER, _POINTER, _INT, _POINTER)
        create = _function(library.eglCreateContext, _POINTER, *[_POINTER] * 4)
        found = _INT()
        _need(initialize(self._display, None, None), "no display")
        _need(choose(self._display, _numbers(_CONFIG), ctypes.byref(config), 1, ctypes.byref(found)), "no config")
        _need(found.value and _function(library.eglBindAPI, _INT, _INT)(_OPENGL_API), "no OpenGL")
        self._context = _need(
            create(self._display, config, None, _numbers(_CONTEXT)), "no context that tells of resets"
        )
        self._before: list[tuple[int | None, ...]] = []
        self.enter()

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an entry point, 0 where there is none."""
        return self._address(name.encode()) or 0

    def enter(self) -> None:
        """Make the context current on this thread."""
        display, surface = self._current_display() or self._display, self._current_surface(_DRAW)
        self._before.append((display, surface, surface, self._current()))
        _need(self._make_current(self._display, None, None, self._context), "the context can't be current")

    def exit(self) -> None:
        """Give this thread back the context that it had before, none where that is gone."""
        if not self._make_current(*self._before.pop()):
            self._make_current(self._display, None, None, None)

    def __enter__(self) -> None:
        self.enter()

    def __exit__(self, *_: object) -> None:
        self.exit()

    def release(self) -> None:
        if self._context:
            self._destroy(self._display, self._context)
            self._context = None

    def _device(self) -> int:
        """Open the display of a device: the first, or that of GLCONTEXT_DEVICE_INDEX as everywhere with moderngl."""
        devices, count = (_POINTER * _MOST_DEVICES)(), _INT()
        query, wanted = self._address(b"eglQueryDevicesEXT"), int(os.environ.get("GLCONTEXT_DEVICE_INDEX", "0"))
        display = self._address(b"eglGetPlatformDisplayEXT")
        _need(query and display, "no devices")
        ctypes.CFUNCTYPE(_INT, _INT, _POINTER, _POINTER)(query)(_MOST_DEVICES, devices, ctypes.byref(count))
        _need(0 <= wanted < count.value, f"no device {wanted}")
        return ctypes.CFUNCTYPE(_POINTER, _INT, _POINTER, _POINTER)(display)(_PLATFORM_DEVICE, devices[wanted], None)


def _function(function: Any, result: Any, *arguments: Any) -> Any:
    function.restype, function.argtypes = result, arguments
    return function


def _numbers(values: tuple[int, ...]) -> Any:
    return (_INT * len(values))(*values)


def _need(value: Any, otherwise: str) -> Any:
    if not value:
        raise OSError(otherwise)
    return value

"""OpenGL contexts without a window (EGL or OSMesa; WGL, CGL), the versions, and detection of lost contexts."""

import ctypes
import ctypes.util
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TypeVar

import moderngl

RENDERER_VERSION = 430
"""OpenGL 4.3, which draws scenes: compute shaders and storage buffers."""
WINDOW_VERSION = 410
"""OpenGL 4.1, of the interface and of pictures that the processor has drawn: the newest of macOS."""
VERSIONS = (WINDOW_VERSION,) if sys.platform == "darwin" else (RENDERER_VERSION, WINDOW_VERSION)
"""Versions to ask for, in this order. Some drivers give exactly that one (NVIDIA), others their newest (Mesa)."""
_NVIDIA_DEVICE = Path("/dev/nvidiactl")
ContextSource = Literal["auto", "egl", "osmesa"]
_Created = TypeVar("_Created")


class NoOpenGLError(OSError):
    """Raised if there is no OpenGL that is new enough; lists the attempts and the packages to install."""


def open_newest(create: Callable[[int], _Created]) -> _Created:
    """Return what `create` makes for the first of `VERSIONS` for which it raises no error."""
    for version in VERSIONS[:-1]:
        with suppress(Exception):
            return create(version)
    return create(VERSIONS[-1])


def open_context(source: ContextSource = "auto", lowest: int = RENDERER_VERSION) -> moderngl.Context:
    """Open a context without a window. It is current within `with context:`, which may be nested.

    Raises `NoOpenGLError` if none has the version `lowest`, such as `WINDOW_VERSION`.
    """
    openers = {"egl": _open_egl, "osmesa": lambda: _context_of(_OSMesa())}
    tried: list[str] = []
    is_old = False
    for name in openers if source == "auto" else (source,):
        try:
            context = openers[name]()
            context.__exit__(None, None, None)
        except Exception as error:  # drivers raise all kinds of errors; the message lists them
            tried.append(f"{name}: {error}")
            continue
        if context.version_code >= lowest:
            return context
        is_old = True
        tried.append(f"{name}: {version_name(context.version_code)}")
        context.release()
    needed = f"no {version_name(lowest)} without a window ({'; '.join(tried)})"
    raise NoOpenGLError(f"{needed}. {_remedy(source, is_old=is_old)}")


def version_name(code: int) -> str:
    """Name a version of moderngl, such as "OpenGL 4.1" for 410."""
    return f"OpenGL {code // 100}.{code // 10 % 10}"


def can_draw_scenes(context: moderngl.Context) -> bool:
    """Return whether `SplatRenderer` can draw in a context; the window shows the processor's pictures in others."""
    return context.version_code >= RENDERER_VERSION


def check_can_draw_scenes(context: moderngl.Context) -> None:
    """Raise `NoOpenGLError` unless `can_draw_scenes`."""
    if not can_draw_scenes(context):
        raise NoOpenGLError(f"{lack_of(context)}: --backend auto or cpu draws by the processor")


def lack_of(context: moderngl.Context) -> str:
    """Reason why an old context draws no scenes, in a few words."""
    needed = version_name(RENDERER_VERSION)
    return f"{version_name(context.version_code)} has no compute shaders ({needed} and later have)"


def _remedy(source: ContextSource, *, is_old: bool) -> str:
    """Return the way to a newer OpenGL on this system; `is_old` if there is one at all."""
    if sys.platform == "darwin":
        return "macOS has 4.1 at most; --backend cpu needs none"
    if is_old:
        return "A newer driver may bring it; --backend cpu needs none"
    if sys.platform == "win32":
        return "The driver of the graphics card brings it; --backend cpu needs none"
    packages = "libosmesa6" if source == "osmesa" else "libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
    return "; ".join(filter(None, [f"On Debian: apt-get install --no-install-recommends {packages}", nvidia_remedy()]))


def nvidia_remedy() -> str:
    """Return how a container gets the OpenGL of the machine's NVIDIA GPU, or an empty text without such a GPU."""
    if not _NVIDIA_DEVICE.exists():
        return ""
    return "start a container with NVIDIA_DRIVER_CAPABILITIES=graphics (or all) for the OpenGL of its NVIDIA GPU"


def is_software(context: moderngl.Context) -> bool:
    """True if the CPU executes this context's drawing (Mesa's llvmpipe, softpipe, swrast)."""
    name = context.info["GL_RENDERER"].lower()
    return any(word in name for word in ("llvmpipe", "softpipe", "swrast", "software"))


def _open_egl() -> moderngl.Context:
    """Open a context with reset notification, or without it if the driver lacks it."""
    try:
        loader = EglContext()
        context = _context_of(loader)
    except (OSError, AttributeError):  # no such library or function
        # On Windows, one of a hidden window. moderngl's stub types keyword arguments of a loader as a dictionary.
        options: Any = {"backend": "egl"} if sys.platform == "linux" else {}
        return open_newest(lambda version: moderngl.create_context(standalone=True, require=version, **options))
    monitor_context(context, loader.load_opengl_function)
    return context


def _context_of(loader: Any) -> moderngl.Context:
    return moderngl.create_context(context=loader, require=WINDOW_VERSION)


class _OSMesa:
    """Context loader for moderngl based on OSMesa (Mesa's off-screen library, GL/osmesa.h)."""

    _ATTRIBUTES = (
        0x22, 0x1908,  # OSMESA_FORMAT, OSMESA_RGBA
        0x30, 24,  # OSMESA_DEPTH_BITS
        0x33, 0x34,  # OSMESA_PROFILE, OSMESA_CORE_PROFILE
    )  # fmt: skip
    _MAJOR, _MINOR = 0x36, 0x37  # OSMESA_CONTEXT_MAJOR_VERSION, OSMESA_CONTEXT_MINOR_VERSION

    def __init__(self) -> None:
        name = os.environ.get("GSRAIN_OSMESA_LIBRARY") or ctypes.util.find_library("OSMesa") or "libOSMesa.so.8"
        library = ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        library.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_uint] + [ctypes.c_int] * 2
        library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        self._library, self._depth = library, 0

        def create(version: int) -> int:
            versioned = (self._MAJOR, version // 100, self._MINOR, version // 10 % 10)
            handle = library.OSMesaCreateContextAttribs(_numbers((*self._ATTRIBUTES, *versioned, 0)), None)
            return _need(handle, f"{name} gives no {version_name(version)} core context")

        self._handle: int | None = open_newest(create)
        self._screen = (ctypes.c_ubyte * (4 * 4 * 4))()  # the default framebuffer is never used
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an entry point, or 0."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> None:
        if not self._library.OSMesaMakeCurrent(self._handle, self._screen, 0x1401, 4, 4):  # GL_UNSIGNED_BYTE
            raise RuntimeError("OSMesaMakeCurrent failed")
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """Release the context from this thread after as many calls as `__enter__`."""
        self._depth -= 1
        if not self._depth:
            self._library.OSMesaMakeCurrent(None, None, 0, 0, 0)

    def release(self) -> None:
        if self._handle:
            self._library.OSMesaDestroyContext(self._handle)
            self._handle = None


# EGL context with reset notification
# EGL 1.5, on a device.

_POINTER, _INT = ctypes.c_void_p, ctypes.c_int
_OPENGL_API, _PLATFORM_DEVICE, _DRAW = 0x30A2, 0x313F, 0x3059
_MAX_DEVICES = 64
_CONFIG = (
    0x3033, 0x0001,  # EGL_SURFACE_TYPE, EGL_PBUFFER_BIT
    0x3040, 0x0008,  # EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT
    0x3038,  # EGL_NONE
)  # fmt: skip
_MAJOR, _MINOR = 0x3098, 0x30FB  # EGL_CONTEXT_MAJOR_VERSION, EGL_CONTEXT_MINOR_VERSION
_CONTEXT = (
    0x30FD, 0x0001,  # EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT
    0x31BD, 0x31BF,  # EGL_CONTEXT_OPENGL_RESET_NOTIFICATION_STRATEGY, EGL_LOSE_CONTEXT_ON_RESET
    0x3038,  # EGL_NONE
)  # fmt: skip


class EglContext:
    """Context loader for moderngl based on EGL. Raises `OSError` if there is no such context."""

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

        def create_of(version: int) -> int:
            attributes = _numbers((_MAJOR, version // 100, _MINOR, version // 10 % 10, *_CONTEXT))
            return _need(create(self._display, config, None, attributes), "no context that tells of resets")

        self._context: int | None = open_newest(create_of)
        self._before: list[tuple[int | None, ...]] = []
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        return self._address(name.encode()) or 0

    def __enter__(self) -> None:
        display, surface = self._current_display() or self._display, self._current_surface(_DRAW)
        self._before.append((display, surface, surface, self._current()))
        _need(self._make_current(self._display, None, None, self._context), "the context can't be current")

    def __exit__(self, *_: object) -> None:
        """Restore the thread's previous context, or none if it no longer exists."""
        if not self._make_current(*self._before.pop()):
            self._make_current(self._display, None, None, None)

    def release(self) -> None:
        if self._context:
            self._destroy(self._display, self._context)
            self._context = None

    def _device(self) -> int:
        """Open the display of a device: the first, or GLCONTEXT_DEVICE_INDEX as in moderngl."""
        devices, count = (_POINTER * _MAX_DEVICES)(), _INT()
        query, index = self._address(b"eglQueryDevicesEXT"), int(os.environ.get("GLCONTEXT_DEVICE_INDEX", "0"))
        display = self._address(b"eglGetPlatformDisplayEXT")
        _need(query and display, "no devices")
        ctypes.CFUNCTYPE(_INT, _INT, _POINTER, _POINTER)(query)(_MAX_DEVICES, devices, ctypes.byref(count))
        _need(0 <= index < count.value, f"no device {index}")
        return ctypes.CFUNCTYPE(_POINTER, _INT, _POINTER, _POINTER)(display)(_PLATFORM_DEVICE, devices[index], None)


def _function(function: Any, result: Any, *arguments: Any) -> Any:
    function.restype, function.argtypes = result, arguments
    return function


def _numbers(values: tuple[int, ...]) -> Any:
    return (_INT * len(values))(*values)


def _need(value: Any, otherwise: str) -> Any:
    if not value:
        raise OSError(otherwise)
    return value


# Lost contexts
# A driver restart or a removed card destroys everything in GPU memory.


class DeviceLostError(OSError):
    """Raised if the contents of the graphics card are lost; the context can no longer be used."""

    def __init__(self) -> None:
        super().__init__("the graphics driver has restarted, or the card is gone: what was being drawn is lost")


class ContextLossMonitor:
    """Remembers that a context is lost, since some drivers report it only once."""

    def __init__(self, ask: Callable[[], int]) -> None:
        """`ask` is the driver's glGetGraphicsResetStatus: 0 if the context works."""
        self.ask = ask
        self._is_lost = False

    def is_lost(self) -> bool:
        """Return whether the context was ever lost. The query takes about a microsecond."""
        self._is_lost = self._is_lost or self.ask() != 0
        return self._is_lost

    def wait_for_driver(self, timeout_s: float) -> None:
        """Wait until the driver has restarted, as reported by its reset status."""
        until = time.monotonic() + timeout_s
        while self.ask() and time.monotonic() < until:
            time.sleep(0.05)


def monitor_context(context: moderngl.Context, address_of: Callable[[str], int | None]) -> None:
    """Attach a loss monitor to a context; `address_of` finds entry points of OpenGL by name.

    Drivers report losses only for contexts created with reset notification.
    """
    endings = ["", *(each for each in ("KHR", "ARB") if f"GL_{each}_robustness" in context.extensions)]
    for ending in endings if context.version_code >= 450 else endings[1:]:  # a nonzero address does not prove support
        if address := address_of(f"glGetGraphicsResetStatus{ending}"):
            context.extra = ContextLossMonitor(reset_status_function(address))
            return


def context_monitor(context: moderngl.Context) -> ContextLossMonitor | None:
    """Loss monitor of a context; None if its driver doesn't report losses."""
    return context.extra


def check_context(context: moderngl.Context) -> None:
    """Raise `DeviceLostError` if the context is lost, so that drawn or read data may be invalid."""
    monitor = context_monitor(context)
    if monitor is not None and monitor.is_lost():
        raise DeviceLostError


def reset_status_function(address: int) -> Callable[[], int]:
    """Wrap glGetGraphicsResetStatus at an address as a Python function."""
    return ctypes.CFUNCTYPE(ctypes.c_uint)(address)

"""Where OpenGL comes from when there is no window: EGL, or OSMesa where EGL is missing."""

import ctypes
import ctypes.util
import os
from typing import Any, Literal

import moderngl

from .egl_context import EglContext
from .lost_context import watch

REQUIRED_VERSION = 430
"""OpenGL 4.3: compute shaders and storage buffers."""

ContextSource = Literal["auto", "egl", "osmesa"]


class NoOpenGLError(OSError):
    """No OpenGL 4.3 could be had; says what was tried and what to install."""


def open_context(source: ContextSource = "auto") -> moderngl.Context:
    """Open an OpenGL 4.3 context without a window. It is current within `with context:`, which may be nested."""
    openers = {"egl": _open_egl, "osmesa": _open_osmesa}
    tried: list[str] = []
    for name in openers if source == "auto" else (source,):
        try:
            context = openers[name]()
            context.__exit__(None, None, None)
            return context
        except Exception as error:  # drivers fail in their own ways: whatever they say goes into the message
            tried.append(f"{name}: {error}")
    packages = "libosmesa6" if source == "osmesa" else "libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
    raise NoOpenGLError(
        "no OpenGL 4.3 without a window (" + "; ".join(tried) + "). On Debian: "
        f"apt-get install --no-install-recommends {packages}"
    )


def is_software(context: moderngl.Context) -> bool:
    """Whether a processor, not a GPU, executes this context's drawing (Mesa's llvmpipe, softpipe, swrast)."""
    name = context.info["GL_RENDERER"].lower()
    return any(word in name for word in ("llvmpipe", "softpipe", "swrast", "software"))


def _open_egl() -> moderngl.Context:
    """Open a context that tells when it is lost; where the driver has none, one that does not."""
    try:
        loader: Any = EglContext()
        context = moderngl.create_context(context=loader, require=REQUIRED_VERSION)
    except (OSError, AttributeError):  # no such library, or no such function in it
        return _open_plain_egl()
    watch(context, loader.load_opengl_function)
    return context


def _open_plain_egl() -> moderngl.Context:
    options: Any = {"backend": "egl"}  # moderngl's stub types keyword arguments of a loader as a dictionary
    return moderngl.create_context(standalone=True, require=REQUIRED_VERSION, **options)


def _open_osmesa() -> moderngl.Context:
    loader: Any = _OSMesa()
    return moderngl.create_context(context=loader, require=REQUIRED_VERSION)


class _OSMesa:
    """The loader object that moderngl asks for entry points (Mesa's off-screen library, GL/osmesa.h)."""

    _ATTRIBUTES = (
        0x22, 0x1908,  # OSMESA_FORMAT, OSMESA_RGBA
        0x30, 24,  # OSMESA_DEPTH_BITS
        0x33, 0x34,  # OSMESA_PROFILE, OSMESA_CORE_PROFILE
        0x36, 4,  # OSMESA_CONTEXT_MAJOR_VERSION
        0x37, 3,  # OSMESA_CONTEXT_MINOR_VERSION
        0,
    )  # fmt: skip

    def __init__(self) -> None:
        name = os.environ.get("GSRAIN_OSMESA_LIBRARY") or ctypes.util.find_library("OSMesa") or "libOSMesa.so.8"
        library = ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        library.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_uint] + [ctypes.c_int] * 2
        library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        attributes = (ctypes.c_int * len(self._ATTRIBUTES))(*self._ATTRIBUTES)
        self._library, self._depth = library, 0
        self._handle = library.OSMesaCreateContextAttribs(attributes, None)
        if not self._handle:
            raise RuntimeError(f"{name} gives no OpenGL 4.3 core context")
        self._screen = (ctypes.c_ubyte * (4 * 4 * 4))()  # nothing is ever drawn to the default framebuffer
        self.enter()

    def load_opengl_function(self, name: str) -> int:
        """Return the address of an entry point, 0 where there is none."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def enter(self) -> None:
        """Make the context current on this thread."""
        if not self._library.OSMesaMakeCurrent(self._handle, self._screen, 0x1401, 4, 4):  # GL_UNSIGNED_BYTE
            raise RuntimeError("OSMesaMakeCurrent failed")
        self._depth += 1

    def exit(self) -> None:
        """Leave no context current on this thread, once for each time that it was entered."""
        self._depth -= 1
        if not self._depth:
            self._library.OSMesaMakeCurrent(None, None, 0, 0, 0)

    def __enter__(self) -> None:
        self.enter()

    def __exit__(self, *_: object) -> None:
        self.exit()

    def release(self) -> None:
        if self._handle:
            self._library.OSMesaDestroyContext(self._handle)
            self._handle = None

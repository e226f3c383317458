"""Draws coloured quads with pyrender on EGL: unlit, either smooth or exact to the pixel's centre."""

import os
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from gsrain_engine.scene.camera import Camera

NEAR_M, FAR_M = 0.2, 2500.0
_WINDOW = "pyrender.viewer"


class MeshRasterizer:
    """A stage of meshes that stay on the GPU between pictures. Not for a thread that holds a window's context."""

    def __init__(self) -> None:
        self._pyrender = _load_pyrender()
        self._stage = self._pyrender.Scene(bg_color=(1.0, 1.0, 1.0, 1.0))

    def add(
        self,
        corners: Float32[np.ndarray, "n 4 3"],
        colors: Float[np.ndarray, "n 4 4"],
        to_world: Float64[np.ndarray, "4 4"],
        *,
        blended: bool = False,
    ) -> Any:
        """Put quads on the stage, seen from both sides; returns a handle for `draw` and `remove`.

        `colors` are display values with alpha; alpha counts only where `blended`.
        """
        n = len(corners)
        halves = np.array([0, 1, 2, 0, 2, 3], np.uint32)
        triangles = (4 * np.arange(n, dtype=np.uint32)[:, None] + halves).reshape(-1, 3)
        material = self._pyrender.MetallicRoughnessMaterial(
            doubleSided=True, alphaMode="BLEND" if blended else "OPAQUE", baseColorFactor=(1.0, 1.0, 1.0, 1.0)
        )
        primitive = self._pyrender.Primitive(
            positions=corners.reshape(-1, 3), color_0=colors.reshape(-1, 4), indices=triangles, material=material
        )
        return self._stage.add(self._pyrender.Mesh([primitive]), pose=to_world)

    def remove(self, node: Any) -> None:
        """Take quads off the stage."""
        self._stage.remove_node(node)

    def draw(
        self, camera: Camera, shown: Sequence[Any], *, exact: bool
    ) -> tuple[UInt8[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
        """Draw some of the stage in order: colour over white, and depth in metres along the view axis (0: nothing).

        With `exact`, one sample at each pixel's centre; otherwise colour is the mean of four.
        """
        lens = self._pyrender.IntrinsicsCamera(camera.fx, camera.fy, camera.cx, camera.cy, znear=NEAR_M, zfar=FAR_M)
        opencv_to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
        held = self._stage.add(lens, pose=camera.camera_to_world @ opencv_to_opengl)
        self._stage.main_camera_node = held
        color, depth = _renderer().draw(self._stage, shown, camera.width, camera.height, exact)
        self._stage.remove_node(held)
        return np.array(color), np.array(depth, np.float32)


@cache
def _load_pyrender() -> ModuleType:
    """Import pyrender for EGL. Its release 0.1.45 asks NumPy for `infty`, which NumPy 2 no longer has.

    Its window, which nothing here opens, is left out: that needs pyglet, and pyglet libraries of X.
    """
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    np.__dict__.setdefault("infty", np.inf)
    if "pyrender" not in sys.modules:
        window = ModuleType(_WINDOW)
        window.Viewer = None  # pyright: ignore[reportAttributeAccessIssue]
        sys.modules.setdefault(_WINDOW, window)
    import pyrender

    return pyrender


@cache
def _renderer() -> Any:
    """Return the process's one renderer: pyrender's contexts can't be made twice, so it is kept to the end."""
    _load_pyrender()
    from OpenGL import EGL, GL
    from pyrender.constants import RenderFlags
    from pyrender.platforms.egl import EGLPlatform
    from pyrender.renderer import Renderer

    class UnlitRenderer(Renderer):
        exact = False
        order: Sequence[Any] = ()

        def _sorted_mesh_nodes(self, scene: Any) -> Any:
            return self.order  # pyrender's own order is that of a set, and where surfaces meet the first one wins

        def _get_camera_matrices(self, scene: Any) -> Any:
            if self.exact:  # the drawing pass has just switched multisampling on
                GL.glDisable(GL.GL_MULTISAMPLE)
            return super()._get_camera_matrices(scene)

        def draw(self, scene: Any, shown: Sequence[Any], width: int, height: int, exact: bool) -> Any:
            with _current(EGL, platform):
                self.viewport_width, self.viewport_height = width, height
                self.exact, self.order = exact, shown
                return self.render(scene, RenderFlags.FLAT | RenderFlags.OFFSCREEN)

    platform = EGLPlatform(64, 64)
    with _current(EGL, platform, create=True):
        return UnlitRenderer(64, 64)


@contextmanager
def _current(egl: Any, platform: Any, *, create: bool = False) -> Generator[None]:
    """Make pyrender's context current, and afterwards the one that was current before, if any."""
    before = egl.eglGetCurrentContext()
    surfaces = egl.eglGetCurrentSurface(egl.EGL_DRAW), egl.eglGetCurrentSurface(egl.EGL_READ)
    display = egl.eglGetCurrentDisplay()
    if create:
        platform.init_context()
    platform.make_current()
    try:
        yield
    finally:
        if before:
            egl.eglMakeCurrent(display, *surfaces, before)
        else:
            egl.eglMakeCurrent(egl.eglGetCurrentDisplay(), egl.EGL_NO_SURFACE, egl.EGL_NO_SURFACE, egl.EGL_NO_CONTEXT)

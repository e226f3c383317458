"""Ground-truth views of the built-in street, rasterized from its mesh by pyrender on EGL."""

import os
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.geometry import Pose, scaled_camera
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.labels import Label

from .build import StreetSurfaces, displayed_colors, lead_track, street_surfaces
from .layout import StreetParameters
from .lighting import Illumination
from .mesh import Quads

NEAR_M, FAR_M = 0.2, 2500.0
_WINDOW = "pyrender.viewer"


class MeshRasterizer:
    """Meshes that stay on the GPU between images. Not for a thread that owns a window's context."""

    def __init__(self) -> None:
        self._pyrender = _load_pyrender()
        self._stage = self._pyrender.Scene(bg_color=(1.0, 1.0, 1.0, 1.0))

    def add(
        self,
        corners: Float32[np.ndarray, "n 4 3"],
        colors: Float[np.ndarray, "n 4 4"],
        to_world: Pose,
        *,
        blended: bool = False,
    ) -> Any:
        """Add two-sided quads; returns a handle for `draw` and `remove`.

        `colors` are display values with alpha, which is used only if `blended`.
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
        self._stage.remove_node(node)

    def draw(
        self, camera: Camera, shown: Sequence[Any], *, exact: bool
    ) -> tuple[UInt8[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
        """Draw some meshes in order: color over white, and depth in meters along the view axis (0: nothing).

        With `exact`, one sample at each pixel's center; otherwise color is the mean of four.
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
    """Import pyrender for EGL. Its release 0.1.45 uses `numpy.infty`, which NumPy 2 removed.

    Its viewer is replaced by an empty module, because it needs pyglet, which needs X libraries.
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
    """Return the process's single renderer: pyrender can't create its context twice."""
    _load_pyrender()
    from OpenGL import EGL, GL
    from pyrender.constants import RenderFlags
    from pyrender.platforms.egl import EGLPlatform
    from pyrender.renderer import Renderer

    class UnlitRenderer(Renderer):
        exact = False
        order: Sequence[Any] = ()

        def _sorted_mesh_nodes(self, scene: Any) -> Any:
            return self.order  # pyrender orders by a set, and the first surface wins at intersections

        def _get_camera_matrices(self, scene: Any) -> Any:
            if self.exact:  # the drawing pass has just enabled multisampling
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
    """Make pyrender's context current, and afterwards the previous one, if any."""
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


# Ground-truth views
# The mesh has the same quads and baked light as the street's Gaussians. Color is unlit, with four samples a pixel;
# surface, depth, normal and label are those at the pixel's center, without blending.

_OPAQUE = 0.9  # minimum opacity of surfaces; other quads are shadows that darken the image
_NO_SURFACE = 0xFFFFFF
_SUPERSAMPLED_PX = 1_500_000
"""Maximum number of pixels for drawing at twice the size (with four samples a pixel) and averaging."""


def capture_street(
    cameras: Sequence[Camera],
    times_s: Sequence[float],
    street: StreetSurfaces | StreetParameters | None = None,
    *,
    names: Sequence[str] | None = None,
    with_lead: bool = True,
) -> Capture:
    """Render the street's mesh: one view for each camera (in the world) and its time.

    The street is built from its parameters (by default the standard ones) unless its surfaces are given.

    Every view has depth, normals, labels (`gsrain_engine.scene.labels.Label`) and a mask that excludes the lead
    car. Raises ValueError if the numbers of cameras, times and names differ.
    """
    if len(cameras) != len(times_s) or (names is not None and len(names) != len(cameras)):
        raise ValueError(f"{len(cameras)} cameras need as many times and names")
    surfaces = street if isinstance(street, StreetSurfaces) else street_surfaces(street)
    views = StreetViews(surfaces, with_lead=with_lead)
    named = names or [f"{k:04d}" for k in range(len(cameras))]
    return Capture(
        "street", tuple(views.view(camera, t, name) for camera, t, name in zip(cameras, times_s, named, strict=True))
    )


class StreetViews:
    """Renderer of one street's views, which keeps its mesh on the GPU."""

    def __init__(self, surfaces: StreetSurfaces, *, with_lead: bool = True) -> None:
        lead = surfaces.lead
        street = Quads.joined(quads for name, quads in surfaces.layers.items() if name != "sky")
        sky = surfaces.layers["sky"]
        matte = np.concatenate([_lit(street, surfaces.light()), _lit(sky, surfaces.light())])
        street = Quads.joined([street, sky])
        self._track = lead_track(surfaces.layout.parameters) if with_lead else None
        self._rasterizer = MeshRasterizer()
        self._street = _Staged(self._rasterizer, street, matte, surfaces.light(), 0)
        self._lead = _Staged(
            self._rasterizer, lead, _lit(lead, surfaces.lead_light()), surfaces.lead_light(), len(street)
        )
        nothing = np.zeros((1, 3), np.float32)
        self._normals = np.concatenate([street.normals, lead.normals, nothing])
        self._labels = np.concatenate([street.labels, lead.labels, np.zeros(1, np.uint8)])

    def view(self, camera: Camera, time_s: float, name: str) -> CaptureFrame:
        """Render the street at a time, with all per-pixel data."""
        pose = self._track.pose(time_s) if self._track is not None else None
        image = self._image(camera, pose)
        surface, depth = self._surfaces(camera, pose)
        label = self._labels[surface]
        solid = (label != Label.SKY) & (label != Label.NOTHING)
        normal = self._normals[surface]
        mask = (surface < self._lead.first) | (surface == len(self._labels) - 1)
        if pose is not None:  # besides the street, only the lead car has normals
            normal = np.where(mask[..., None], normal, normal @ pose[:3, :3].T.astype(np.float32))
        away = np.sum(normal * _rays(camera), axis=2, keepdims=True) > 0
        return CaptureFrame(
            name=name,
            camera=camera,
            image_source=image,
            time_s=time_s,
            depth_source=np.where(solid, depth, 0).astype(np.float32),
            normals_source=np.where(solid[..., None], np.where(away, -normal, normal), 0).astype(np.float32),
            labels_source=label,
            mask_source=mask,
            sky_source=label == Label.SKY,
        )

    def _image(self, camera: Camera, pose: Pose | None) -> UInt8[np.ndarray, "h w 3"]:
        placed = [(self._street, np.eye(4))] + ([(self._lead, pose)] if pose is not None else [])
        shown = [node for staged, to_world in placed for node in staged.colored(self._rasterizer, camera, to_world)]
        scale = 2 if camera.width * camera.height <= _SUPERSAMPLED_PX else 1
        larger = scaled_camera(camera, scale * camera.width, scale * camera.height)
        image, _ = self._rasterizer.draw(larger, shown, exact=False)
        return image if scale == 1 else cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)

    def _surfaces(
        self, camera: Camera, pose: Pose | None
    ) -> tuple[Int64[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
        """Return the quad at each pixel's center (numbered through street and lead car), and its depth."""
        shown = [self._street.numbered(np.eye(4))]
        if pose is not None:
            shown.append(self._lead.numbered(pose))
        coded, depth = self._rasterizer.draw(camera, shown, exact=True)
        numbers = coded.astype(np.int64) @ np.array([1, 1 << 8, 1 << 16])
        # Grids of different pitch meet without shared corners, so about one pixel in 100,000 falls between them.
        rows, columns = np.nonzero(numbers == _NO_SURFACE)
        beside = np.where(columns > 0, columns - 1, columns + 1)
        depth[rows, columns] = depth[rows, beside]
        numbers[rows, columns] = numbers[rows, beside]
        return np.where(numbers == _NO_SURFACE, len(self._labels) - 1, numbers), depth


class _Staged:
    """A mesh on the GPU: matte quads and quad numbers are kept, glossy quads are recolored for each view."""

    def __init__(
        self,
        rasterizer: MeshRasterizer,
        quads: Quads,
        matte: Float32[np.ndarray, "n 4 3"],
        light: Illumination,
        first: int,
    ) -> None:
        self.quads, self.matte, self.light, self.first = quads, matte, light, first
        solid = quads.opacity >= _OPAQUE
        is_matte = solid & (quads.gloss == 0)
        self._glossy = solid & (quads.gloss > 0)
        self._nodes: dict[str, Any] = {}
        if is_matte.any():
            colors = self._colors_from(np.zeros(3), is_matte)
            self._nodes["matte"] = rasterizer.add(quads.corners[is_matte], colors, np.eye(4))
        if not solid.all():
            colors = self._colors_from(np.zeros(3), ~solid)
            self._nodes["shadow"] = rasterizer.add(quads.corners[~solid], colors, np.eye(4), blended=True)
        ids = first + np.flatnonzero(solid)
        coded = np.stack([ids & 255, ids >> 8 & 255, ids >> 16, np.full_like(ids, 255)], axis=1) / 255.0
        each = np.repeat(coded[:, None].astype(np.float32), 4, axis=1)
        self._numbers = rasterizer.add(quads.corners[solid], each, np.eye(4))

    def colored(self, rasterizer: MeshRasterizer, camera: Camera, to_world: Pose) -> list[Any]:
        """Handles of the mesh in the colors visible from this camera."""
        if "glossy" in self._nodes:
            rasterizer.remove(self._nodes.pop("glossy"))
        if self._glossy.any():
            eye = np.linalg.inv(to_world)[:3] @ np.append(camera.position, 1.0)
            colors = self._colors_from(eye, self._glossy)
            self._nodes["glossy"] = rasterizer.add(self.quads.corners[self._glossy], colors, to_world)
        for node in self._nodes.values():
            node.matrix = to_world
        return [self._nodes[kind] for kind in ("matte", "glossy", "shadow") if kind in self._nodes]

    def _colors_from(
        self, eye: Float64[np.ndarray, "3"], chosen: Bool[np.ndarray, " n"]
    ) -> Float32[np.ndarray, "m 4 4"]:
        """Display color and alpha of the corners of chosen quads, seen from `eye` in the quads' own frame."""
        quads, matte = self.quads.take(chosen), self.matte[chosen]
        colors = np.ones((len(quads), 4, 4), np.float32)
        for corner in range(4):
            towards = quads.corners[:, corner] - eye
            towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-6)
            colors[:, corner, :3] = displayed_colors(quads, self.light, matte[:, corner], towards)
        colors[..., 3] = np.where(quads.opacity < _OPAQUE, quads.opacity, 1)[:, None]
        return colors

    def numbered(self, to_world: Pose) -> Any:
        """Handle of the mesh with each surface in the color of its number."""
        self._numbers.matrix = to_world
        return self._numbers


def _lit(quads: Quads, light: Illumination) -> Float32[np.ndarray, "n 4 3"]:
    return np.stack([light.display_colors(quads, quads.corners[:, k]) for k in range(4)], axis=1)


def _rays(camera: Camera) -> Float64[np.ndarray, "h w 3"]:
    """Direction of each pixel's ray in the world, 1 m along the view axis."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    local = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=2)
    return local @ camera.world_to_camera[:3, :3]

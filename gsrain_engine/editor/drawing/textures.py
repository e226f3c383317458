"""Textures of captures, jobs and CPU renders, and capture points, in the window's OpenGL context and thread."""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any, get_args

import moderngl
import numpy as np
from jaxtyping import UInt8

from ...choices import RenderMode
from ...compile_cache import compiled_kernels, has_kernels, mark_kernels
from ...kernel_helpers import KernelHelpers
from ...rain.frame import RainCamera
from ...rain.settings import RainSettings
from ...rain.simulation import OVERCAST, RainSimulation
from ...render.cpu.renderer import CpuRenderer
from ...render.cpu.splats import FEW
from ...render.draw import draw
from ...render.frame_input import FrameInput, Quality
from ...render.opengl.buffers import sized_target
from ...render.opengl.shaders import load_program
from ...render.still_scene import StillScene
from ...render.view import RenderView
from ...scene.camera import Camera, look_at
from ...scene.gaussians import Gaussians
from ...scene.ground_water import GroundWater
from ...scene.lamps import Lamp
from ...scene.lod_order import sort_into_lod_order
from ...scene.lod_tree import average_below, build_lod_tree, cut_lod_tree
from ...scene.named_view import NamedView
from ...scene.scene import DrawItem, Layer, Scene
from ..capture_view import CaptureController, ImageRequest, PointSample
from ..jobs.job import Job
from ..matching import MatchingController
from ..viewport.options import Texture
from ..views import picture_pixels

_NEAR_M, _POINT_PX = 0.05, 3.0
_PER_FRAME = 4  # maximum number of images uploaded

logger = logging.getLogger("gsrain")


class CachedTexture:
    """A texture of an image in display colors, first row on top, that is written only when the image changes."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.pixels: UInt8[np.ndarray, "h w c"] | None = None
        self._texture: moderngl.Texture | None = None

    def show(self, pixels: UInt8[np.ndarray, "h w c"] | None) -> Texture | None:
        """Upload an image; None frees the texture."""
        if pixels is self.pixels:
            return self.texture
        self.pixels, old = pixels, self._texture
        if old is not None and (pixels is None or (old.height, old.width, old.components) != pixels.shape):
            old.release()
            self._texture = None
        if pixels is not None:
            height, width, channels = pixels.shape
            self._texture = self._texture or self._context.texture((width, height), channels, alignment=1)
            self._texture.write(np.ascontiguousarray(pixels), alignment=1)
        return self.texture

    @property
    def texture(self) -> Texture | None:
        texture = self._texture
        return None if texture is None else Texture(texture.glo, texture.width, texture.height)


class CaptureTextures:
    """Textures of the open capture."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._pictures: dict[ImageRequest, CachedTexture] = {}
        self._program: moderngl.Program | None = None
        self._points: tuple[PointSample, moderngl.VertexArray, list[moderngl.Buffer]] | None = None
        self._target: moderngl.Framebuffer | None = None
        self._drawn: tuple[object, ...] | None = None
        self._matching = CachedTexture(context)

    def update(self, captures: CaptureController, matching: MatchingController) -> None:
        """Upload new images, release old ones, and update the textures of both. Once a frame."""
        there = {} if captures.pictures is None else dict(captures.pictures)
        for request in [each for each, cached in self._pictures.items() if there.get(each) is not cached.pixels]:
            self._pictures.pop(request).show(None)
        for request in [each for each in there if each not in self._pictures][:_PER_FRAME]:
            self._pictures[request] = CachedTexture(self._context)
            self._pictures[request].show(there[request])
        captures.textures = {
            request: texture for request, cached in self._pictures.items() if (texture := cached.texture) is not None
        }
        matching.texture = self._matching.show(matching.picture)

    def draw_points(self, captures: CaptureController, scene: Scene, camera: Camera) -> None:
        """Draw the points for a camera of the viewport's size, on a transparent background."""
        captures.points_texture = None
        if captures.points is None or not captures.show_points:
            return
        matrix = camera.world_to_camera @ captures.to_world(scene)
        state = captures.points, matrix.tobytes(), camera.width, camera.height, camera.fx, camera.cx, camera.cy
        target = self._target_of(camera.width, camera.height)
        if state != self._drawn:
            self._draw(captures.points, matrix, camera, target)
            self._drawn = state
        texture = target.color_attachments[0]
        captures.points_texture = Texture(texture.glo, camera.width, camera.height)

    def _draw(self, points: PointSample, matrix: np.ndarray, camera: Camera, target: moderngl.Framebuffer) -> None:
        vertices, program = self._vertices_of(points)
        program["capture_to_camera"] = tuple(matrix.T.ravel().tolist())  # column-major
        program["focal_px"], program["center_px"] = (camera.fx, camera.fy), (camera.cx, camera.cy)
        program["image_size"] = (camera.width, camera.height)
        program["near_m"], program["size_px"] = _NEAR_M, _POINT_PX
        window = self._context.detect_framebuffer()
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0)
        self._context.enable(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        vertices.render(moderngl.POINTS)
        self._context.disable(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        window.use()

    def _vertices_of(self, points: PointSample) -> tuple[moderngl.VertexArray, moderngl.Program]:
        if self._program is None:
            self._program = load_program(self._context, "capture_points.vert", "capture_points.frag")
        if self._points is None or self._points[0] is not points:
            for old in (self._points[1], *self._points[2]) if self._points is not None else ():
                old.release()
            buffers = [self._context.buffer(np.ascontiguousarray(each)) for each in (points.positions, points.colors)]
            content = [(buffers[0], "3f", "position"), (buffers[1], "3f1", "color")]
            self._points = points, self._context.vertex_array(self._program, content), buffers
        return self._points[1], self._program

    def _target_of(self, width: int, height: int) -> moderngl.Framebuffer:
        target = sized_target(self._context, self._target, (width, height))
        if target is not self._target:
            self._target, self._drawn = target, None
        return target


class JobPreviews:
    """One texture for each running job that has a preview."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._cached: dict[Job[Any], CachedTexture] = {}

    def update(self, running: Iterable[Job[Any]]) -> dict[Job[Any], Texture]:
        """Upload new previews of running jobs, and return all. Once a frame."""
        for job in [each for each in self._cached if each.state != "running"]:
            self._cached.pop(job).show(None)
        for job in running:
            if job.progress.preview is not None:
                self._cached.setdefault(job, CachedTexture(self._context)).show(job.progress.preview)
        return {job: texture for job, each in self._cached.items() if (texture := each.texture) is not None}


class ViewPictures:
    """One texture for each named view that has a picture."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._cached: dict[bytes, CachedTexture] = {}

    def update(self, views: Iterable[NamedView]) -> dict[str, Texture]:
        """Upload new pictures, some in each frame, and return all by the names of their views. Once a frame."""
        pictures = {view.name: view.picture for view in views if view.picture is not None}
        for gone in self._cached.keys() - set(pictures.values()):
            self._cached.pop(gone).show(None)
        for picture in [each for each in set(pictures.values()) if each not in self._cached][:_PER_FRAME]:
            self._cached[picture] = CachedTexture(self._context)
            self._cached[picture].show(picture_pixels(picture))
        cached = {name: self._cached[each].texture for name, each in pictures.items() if each in self._cached}
        return {name: texture for name, texture in cached.items() if texture is not None}


class CpuTexture:
    """A CPU renderer, whose kernels compile in the background, and the texture of its images."""

    def __init__(self, context: moderngl.Context) -> None:
        self.renderer = CpuRenderer()
        self._context = context
        self._texture: moderngl.Texture | None = None
        self._compiled = threading.Event()
        self._is_compiling = False
        self.has_failed = False
        """True if the kernels can't be compiled."""
        self.compiled: int | None = None
        """Number of kernels that another process has compiled so far; None if none does."""

    def compile(self) -> None:
        """Start to compile or load the kernels in the background, once in a process."""
        if _are_loaded.is_set():
            self._compiled.set()
        elif not self._is_compiling:
            self._is_compiling = True
            threading.Thread(target=self._compile, name="compile kernels", daemon=True).start()

    @property
    def is_ready(self) -> bool:
        """True if drawing will not wait for the compiler."""
        return self._compiled.is_set()

    def upload(self) -> moderngl.Texture:
        """Copy the renderer's last image into a texture."""
        rgba = self.renderer.read().rgba
        size = (rgba.shape[1], rgba.shape[0])
        if self._texture is None or self._texture.size != size:
            if self._texture is not None:
                self._texture.release()
            self._texture = self._context.texture(size, 4, dtype="f4")
            self._texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self._texture.write(np.ascontiguousarray(rgba))
        return self._texture

    def _compile(self) -> None:
        try:
            load_kernels(lambda count: setattr(self, "compiled", count))
        except Exception:  # OpenGL draws instead, slower, if it can
            self.has_failed = True
            logger.exception("The processor's kernels can't be compiled")
        else:
            _are_loaded.set()
            self._compiled.set()


_loading = threading.Lock()
_are_loaded = threading.Event()
"""Set as soon as this process has all kernels of a picture in memory."""

_COUNT_S = 0.5  # between reports


def load_kernels(report: Callable[[int], object] = lambda _count: None) -> None:
    """Load all kernels of a picture; those that are missing are compiled by other processes first.

    The compiler holds Python's lock, so that in this process it would stop the interface. `report` is called with the
    number of kernels that are compiled so far.
    """
    with _loading:
        if not has_kernels():
            with suppress(OSError):  # no process can be started: this one compiles
                helpers = KernelHelpers()
                while helpers.are_running:
                    report(compiled_kernels())
                    time.sleep(_COUNT_S)
        compile_kernels()


def compile_kernels() -> None:
    """Draw one Gaussian and many, in all modes, so that each kernel is compiled or read from the cache.

    What most first pictures show comes first: `packaging/kernel_table.py` notes the order.
    """
    one, many = _balls(1), _balls(FEW)
    camera = Camera(32, 32, 32.0, 32.0, 16.0, 16.0)
    renderer, parts = CpuRenderer(), [DrawItem(one, np.eye(4))]
    sort_into_lod_order(one)
    renderer.draw([DrawItem(many, np.eye(4))], camera)
    for degree in (1, 4, 9, 16):
        renderer.draw([DrawItem(one.with_sh(np.zeros((1, degree, 3), np.float32)), np.eye(4))], camera, with_depth=True)
    _draw_rain(renderer)
    view = RainCamera(camera, np.eye(4), np.zeros(3))
    for model in ("physical", "paper"):
        rain = RainSettings(intensity_mm_h=1.0, model=model)
        renderer.draw(parts, camera, RainSimulation.start(rain).frame(0.0, view))
    tree = build_lod_tree(many)
    average_below(tree, many.sh)
    cut_lod_tree(tree, camera, np.eye(4))
    for mode in get_args(RenderMode):
        renderer.draw(parts, camera, mode=mode)
    mark_kernels()


def _draw_rain(renderer: CpuRenderer) -> None:
    """Draw rain on dry ground; then the mirror of a puddle under a lamp, and drops on glass, with rain and without."""
    ground, sky = (replace(_balls(1), means=np.array([[x, 0.0, 0.0]], np.float32)) for x in (3.0, 500.0))
    cover = np.full((1, 1, 2), 255, np.uint8)
    cover.flags.writeable = False  # as of scenes from files
    water = GroundWater((0.0, -5.0), 10.0, cover)
    lamp = Lamp(position=(4.0, 0.0, 1.0), intensity_m2=1.0)
    dry = Scene("road", (Layer("ground", ground), Layer("sky", sky, kind="sky")), ground_m=0.0)
    puddle = replace(dry, name="puddle", water=water, lamps=(lamp,))
    pose = look_at(np.array([0.0, 0.0, 1.5]), np.array([4.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    shot = RenderView(Camera.from_fov(64, 48, 50.0, pose), 0.02)
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=4.0))
    draw(renderer, FrameInput.of(dry, rainfall, OVERCAST, shot)).read_uint8()
    for intensity, wetness in ((4.0, None), (0.0, 1.0)):
        for lamps in ("none", None):
            rain = RainSettings(intensity_mm_h=intensity, wetness=wetness, lamps=lamps, glass="windshield")
            rainfall = RainSimulation.start(rain)
            draw(renderer, FrameInput.of(puddle, rainfall, OVERCAST, shot, Quality(still=StillScene())))
            picture = draw(renderer, FrameInput.of(puddle, rainfall, OVERCAST, shot))
            pixels = picture.read_uint8()
            pixels[20:24, 30:34] = 255  # a lamp, whose light the film on wiped glass spreads
            for each in picture.filters:
                each.picture(pixels)


def _balls(count: int) -> Gaussians:
    """Gaussians in front of a camera at the origin, all at one place."""
    means, quaternions = np.zeros((count, 3), np.float32), np.zeros((count, 4), np.float32)
    means[:, 2], quaternions[:, 0] = 2, 1
    scales, opacities = np.full((count, 3), 0.1, np.float32), np.ones(count, np.float32)
    return Gaussians(means, scales, quaternions, opacities, np.zeros((count, 1, 3), np.float32))

"""Draws Gaussians with OpenGL: project each once, sort by depth, blend instanced quads from back to front."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import moderngl
import numpy as np
from jaxtyping import Float32, Float64, UInt32

from gsrain_engine.rain.rain_gaussians import RainGaussians
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Part

from .frame import Frame
from .gpu_arrays import CHUNK, GpuArrays
from .shaders import load_compute_shader, load_program
from .statistics import RenderStatistics, Stopwatch

NEAR_M = 0.2
"""Gaussians whose centre is nearer than this are left out, as in the reference rasterizer."""

_SPLAT_BYTES = 48
_CULLED = np.uint32(0xFFFFFFFF)
_SPLATS, _DEPTHS, _ORDER = 4, 5, 6  # storage bindings after the four of the Gaussians


class SplatRenderer:
    """Renders scene and rain into one picture in the current OpenGL context.

    Call it on the thread and inside the context that it was made with.
    """

    name = "opengl"

    def __init__(self, context: moderngl.Context, precision: Literal["half", "single"] = "single") -> None:
        self.context = context
        self.statistics = RenderStatistics()
        self.arrays = GpuArrays(context)
        self._dtype = "f2" if precision == "half" else "f4"
        self._project = load_compute_shader(context, "splat_project.comp")
        self._programs: dict[tuple[str, ...], tuple[moderngl.Program, moderngl.VertexArray]] = {}
        self._storage: dict[int, moderngl.Buffer] = {}
        self._targets: dict[str, _Target] = {}
        self._picture: moderngl.Texture | None = None

    @property
    def picture(self) -> moderngl.Texture:
        """The last picture: premultiplied display colour, first row on top."""
        assert self._picture is not None, "draw before looking at the picture"
        return self._picture

    def draw(
        self,
        parts: Sequence[Part],
        camera: Camera,
        rain: RainGaussians | None = None,
        *,
        with_depth: bool = False,
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; the result is `picture`, and `read()` fetches it.

        `camera` is in the world (metres). Depth is the scene's own: rain takes no part in it.
        """
        self.statistics = RenderStatistics(stages_ms={"project": 0.0, "sort": 0.0, "draw": 0.0})
        drops = rain.gaussians if rain is not None and len(rain.gaussians) else None
        scene_count = sum(len(part.gaussians) for part in parts)
        total = scene_count + (len(drops) if drops is not None else 0)
        self.statistics.gaussians = total
        self._reserve(total)

        with self._timed("project"):
            first = 0
            for part in parts:
                self._dispatch(part.gaussians, part.to_world, camera, first, is_rain=False)
                first += len(part.gaussians)
            if drops is not None:
                self._dispatch(drops, np.eye(4), camera, first, is_rain=True)
            self.context.memory_barrier()
            keys = np.frombuffer(self._storage[_DEPTHS].read(4 * total), np.uint32)
        with self._timed("sort"):
            order = back_to_front(keys)
        with self._timed("draw"):
            light = rain.light_linear if drops is not None and rain is not None and rain.mixing == "linear" else None
            self._blend(order, camera, with_depth=with_depth, linear_rain=light is not None)
            if light is not None:
                self._resolve_rain(light)
            self.context.finish()
        self._picture = self._targets["rainy" if light is not None else "splats"].color
        self.statistics.splats_drawn = len(order)
        self.arrays.release_unused()

    def read(self) -> Frame:
        """Fetch the last picture (and depth, if it was drawn) from the GPU."""
        rgba = self._fetch(self.picture)
        depth = self._targets["splats"].depth
        if depth is None:
            return Frame(rgba)
        weighted, weight = np.moveaxis(self._fetch(depth), -1, 0)
        return Frame(rgba, np.where(weight > 0.5, weighted / np.maximum(weight, np.float32(0.5)), np.float32(0)))

    def _fetch(self, texture: moderngl.Texture) -> Float32[np.ndarray, "h w c"]:
        width, height = texture.size
        values = np.frombuffer(texture.read(), np.float16 if texture.dtype == "f2" else np.float32)
        return values.reshape(height, width, texture.components).astype(np.float32)

    def upload(self, gaussians: Gaussians, slice_size: int = CHUNK // 16) -> Iterator[float]:
        """Bring Gaussians to the GPU ahead of their first frame, a slice at each step."""
        return self.arrays.upload(gaussians, slice_size)

    def _timed(self, stage: str) -> Stopwatch:
        return Stopwatch(self.statistics.stages_ms, stage)

    def _reserve(self, count: int) -> None:
        limit = self.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
        if _SPLAT_BYTES * count > limit:
            raise MemoryError(
                f"{count} Gaussians need a storage block of {_SPLAT_BYTES * count >> 20} MiB; "
                f"this OpenGL driver allows {limit >> 20} MiB"
            )
        for binding, size in ((_SPLATS, _SPLAT_BYTES), (_DEPTHS, 4), (_ORDER, 4)):
            held = self._storage.get(binding)
            if held is None or held.size < size * count:
                if held is not None:
                    held.release()
                self._storage[binding] = self.context.buffer(reserve=max(1, size * (count + count // 8)))

    def _dispatch(
        self, gaussians: Gaussians, to_world: Float64[np.ndarray, "4 4"], camera: Camera, first: int, *, is_rain: bool
    ) -> None:
        object_to_camera = camera.world_to_camera @ to_world
        uniforms = {
            "coefficients": gaussians.sh.shape[1],
            "object_to_camera": tuple(object_to_camera.T.ravel()),
            "camera_in_object": tuple(np.linalg.inv(object_to_camera)[:3, 3]),
            "intrinsics": (camera.fx, camera.fy, camera.cx, camera.cy),
            "image_size": (camera.width, camera.height),
            "near": NEAR_M,
            "is_rain": is_rain,
        }
        for name, value in uniforms.items():
            self._project[name] = value
        for binding in (_SPLATS, _DEPTHS):
            self._storage[binding].bind_to_storage_buffer(binding)
        for index, chunk in enumerate(self.arrays.buffers(gaussians).chunks()):
            for binding, buffer in enumerate(chunk):
                buffer.bind_to_storage_buffer(binding)
            count = min(CHUNK, len(gaussians) - index * CHUNK)
            self._project["count"] = count
            self._project["first_splat"] = first + index * CHUNK
            self._project.run(-(-count // 256))

    def _blend(self, order: UInt32[np.ndarray, " m"], camera: Camera, *, with_depth: bool, linear_rain: bool) -> None:
        """Draw the splats of an order over nothing."""
        target = self._target("splats", (camera.width, camera.height), shares=linear_rain, depth=with_depth)
        switches = ("LINEAR_RAIN",) * linear_rain + ("WITH_DEPTH",) * with_depth
        program, vertices = self._program("splat.vert", "splat.frag", switches)
        program["image_size"] = (camera.width, camera.height)
        before = self.context.detect_framebuffer()
        target.framebuffer.use()
        target.framebuffer.clear()
        if len(order):
            self._storage[_ORDER].write(order)
            self._storage[_SPLATS].bind_to_storage_buffer(_SPLATS)
            self._storage[_ORDER].bind_to_storage_buffer(_ORDER)
            self.context.enable_only(moderngl.BLEND)
            self.context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
            vertices.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(order))
            self.context.enable_only(moderngl.NOTHING)
        before.use()

    def _resolve_rain(self, light: Float32[np.ndarray, "3"]) -> None:
        """Put scene and rain together in linear light."""
        splats = self._targets["splats"]
        assert splats.shares is not None
        target = self._target("rainy", splats.color.size)
        program, vertices = self._program("screen.vert", "rain_resolve.frag")
        program["rain_light"] = tuple(light)
        for unit, (name, texture) in enumerate((("clear_scene", splats.color), ("shares", splats.shares))):
            texture.use(unit)
            program[name] = unit
        before = self.context.detect_framebuffer()
        target.framebuffer.use()
        vertices.render(moderngl.TRIANGLES, vertices=3)
        before.use()

    def _program(
        self, vertex: str, fragment: str, switches: tuple[str, ...] = ()
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        key = (fragment, *switches)
        if key not in self._programs:
            program = load_program(self.context, vertex, fragment, switches=switches)
            self._programs[key] = program, self.context.vertex_array(program, [])
        return self._programs[key]

    def _target(self, name: str, size: tuple[int, int], *, shares: bool = False, depth: bool = False) -> "_Target":
        held = self._targets.get(name)
        wanted = (size, shares, depth)
        if held is None or held.layout != wanted:
            if held is not None:
                held.release()
            self._targets[name] = _Target.make(self.context, wanted, self._dtype)
        return self._targets[name]


_Layout = tuple[tuple[int, int], bool, bool]


@dataclass(slots=True)
class _Target:
    """Textures that are drawn into; the fragment shader's locations 0, 1, 2."""

    layout: _Layout
    color: moderngl.Texture
    shares: moderngl.Texture | None
    depth: moderngl.Texture | None
    framebuffer: moderngl.Framebuffer

    @classmethod
    def make(cls, context: moderngl.Context, layout: _Layout, dtype: str) -> "_Target":
        size, with_shares, with_depth = layout
        color = context.texture(size, 4, dtype=dtype)
        color.filter = moderngl.NEAREST, moderngl.NEAREST
        # Without rain the second attachment keeps its place for the third, at one pixel's price in memory a channel.
        shares = context.texture(size, 2, dtype=dtype) if with_shares or with_depth else None
        depth = context.texture(size, 2, dtype="f4") if with_depth else None
        attachments = [each for each in (color, shares, depth) if each is not None]
        return cls(layout, color, shares, depth, context.framebuffer(attachments))

    def release(self) -> None:
        self.framebuffer.release()
        for texture in (self.color, self.shares, self.depth):
            if texture is not None:
                texture.release()


def back_to_front(depth_keys: UInt32[np.ndarray, " n"]) -> UInt32[np.ndarray, " m"]:
    """Indices of the Gaussians that are drawn, farthest first; of equal depths the lowest index is nearest.

    A depth key holds the bits of a positive float32, which sort like the number itself.
    """
    visible = np.flatnonzero(depth_keys != _CULLED)
    # One 64-bit number a splat, depth above index: no two are equal, so any fast sort is a stable one.
    pairs = (depth_keys[visible].astype(np.uint64) << np.uint64(32)) | visible.astype(np.uint64)
    pairs.sort()
    return (pairs[::-1] & np.uint64(0xFFFFFFFF)).astype(np.uint32)

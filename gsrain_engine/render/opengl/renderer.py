"""OpenGL renderer: projects, sorts by depth and blends tiles or quads, all on the GPU."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float32, UInt8

from ...choices import RenderMode
from ...rain.frame import RainFrame
from ...rain.lamp_light import LampLight, light_in_picture
from ...rain.medium import RainMedium
from ...scene.camera import Camera
from ...scene.gaussians import SH_C0, Gaussians, IdentityKey, scene_cache
from ...scene.lens import PixelRays
from ...scene.scene import DrawItem
from ...water.mirror import LensMirror, Mirror
from ..cpu.compositing import expected
from ..renderer import (
    FARTHEST_M,
    MAX_FRAGMENTS,
    MIN_WEIGHT,
    NEAREST_M,
    Color,
    Frame,
    PendingImage,
    RenderStatistics,
    timed,
)
from .buffers import GpuArrays, GrowableBuffer, Harmonics, ProjectedSplatBuffer, check_gpu_memory
from .context import check_can_draw_scenes, check_context, is_software
from .projection import ProjectionPass, sky_uniforms
from .shaders import GpuTimers, Switches, load_compute_shader, load_program
from .sort import SLOTS, CpuSort, RadixSort, count_in
from .tiles import TileRasterizer

_QUADS_BY_INSTANCE = 128
"""Splats per instance; instances of one quad would leave a GPU's vertex units idle. As in splat.vert."""


_RAYS_UNIT = 7  # texture unit of a lens's rays; those of pictures and lamps are below

Rasterizer = Literal["tiles", "quads"]
"""Compute shaders that blend tiles front to back, or the rasterizer that blends quads back to front.

GPUs draw tiles many times faster, software rasterizers quads.
"""


class FramebufferLayout(NamedTuple):
    """Attachments of a framebuffer: the fragment shader's locations 0 to 3; lamps need depth."""

    size: tuple[int, int]
    shares: bool = False
    depth: bool = False
    lamps: bool = False


@dataclass(slots=True)
class Framebuffer:
    """Framebuffer with its textures."""

    layout: FramebufferLayout
    color: moderngl.Texture
    shares: moderngl.Texture | None
    depth: moderngl.Texture | None
    lamps: moderngl.Texture | None
    framebuffer: moderngl.Framebuffer

    @classmethod
    def make(cls, context: moderngl.Context, layout: FramebufferLayout) -> "Framebuffer":
        """Create the textures of a layout.

        Raises `MemoryError` if the graphics card is full, and `ValueError` for a larger picture than it can draw.
        """
        largest = int(context.info["GL_MAX_TEXTURE_SIZE"])
        if max(layout.size) > largest:
            width, height = layout.size
            raise ValueError(
                f"a picture of {width}x{height} samples exceeds the {largest} px of this graphics card: choose a "
                "smaller size or supersampling, or the back end cpu"
            )
        color = context.texture(layout.size, 4, dtype="f4")
        color.filter = moderngl.NEAREST, moderngl.NEAREST
        # Without rain the second attachment only keeps the location of the third.
        with_shares = layout.shares or layout.depth
        shares = context.texture(layout.size, 2, dtype="f4") if with_shares else None
        depth = context.texture(layout.size, 4 if layout.lamps else 2, dtype="f4") if layout.depth else None
        lamps = context.texture(layout.size, 4, dtype="f4") if layout.lamps else None
        check_gpu_memory(context, 16 * layout.size[0] * layout.size[1])
        attachments = [each for each in (color, shares, depth, lamps) if each is not None]
        return cls(layout, color, shares, depth, lamps, context.framebuffer(attachments))

    def release(self) -> None:
        self.framebuffer.release()
        for texture in (self.color, self.shares, self.depth, self.lamps):
            if texture is not None:
                texture.release()


class SplatRenderer:
    """Renders scene and rain into one image in the current OpenGL context, without reading counts back to the CPU.

    Call it on the thread and in the context in which it was created.

    Args:
        context: OpenGL 4.3 or later; raises `NoOpenGLError` for others.
        harmonics: GPU storage of colors.
        activates: Make the context current to draw and read, so that several can be used alternately on one thread.
        rasterizer: None takes quads on software rasterizers, or else tiles.
        timers: Measure the stages of a frame; pass them to measure whole frames instead, in a stage around `draw`.
    """

    name = "opengl"

    def __init__(
        self,
        context: moderngl.Context,
        harmonics: Harmonics = "half",
        *,
        activates: bool = False,
        rasterizer: Rasterizer | None = None,
        timers: GpuTimers | None = None,
    ) -> None:
        check_can_draw_scenes(context)
        self.context = context
        self._active: AbstractContextManager[object] = context if activates else nullcontext()
        self.arrays = GpuArrays(context, harmonics)
        self._projection = ProjectionPass(context, self.arrays)
        self._store = ProjectedSplatBuffer(context)
        self._is_software = is_software(context)
        self._sort = CpuSort(context) if self._is_software else RadixSort(context)
        self.rasterizer: Rasterizer = rasterizer or ("quads" if self._is_software else "tiles")
        self._tiles = TileRasterizer(context) if self.rasterizer == "tiles" else None
        self._timers = timers or GpuTimers(context)
        quads = 4 * np.arange(_QUADS_BY_INSTANCE, dtype=np.uint32)[:, None]
        # Two triangles per quad of an instance; both start with the quad's first vertex.
        self._quads = context.buffer((quads + np.array([0, 1, 2, 1, 3, 2], np.uint32)).tobytes())
        self._programs: dict[tuple[object, ...], tuple[moderngl.Program, moderngl.VertexArray]] = {}
        self._targets: dict[str, Framebuffer] = {}
        self._bytes = _ByteReader(context)
        self._requests: list[_ByteRequest] = []
        """Requests of the last image, until the next one is drawn."""
        self._image: moderngl.Texture | None = None
        self._lights: dict[str, moderngl.Texture] = {}
        self._rays: tuple[PixelRays, moderngl.Texture] | None = None
        self.statistics = RenderStatistics()
        """Statistics of the last image if it was read, or else of the one before, to avoid waiting for the GPU."""
        self._drawn: RenderStatistics | None = None
        self._makes_drops = False
        self._redraw: Callable[[], None] = lambda: None
        """Draws the last image once more, if pairs had no room."""

    @property
    def draws_lenses(self) -> bool:
        """True if cameras may have lenses and rolling shutters: tiles do, quads do not."""
        return self._tiles is not None

    @property
    def picture(self) -> moderngl.Texture:
        """Last image: premultiplied display color, top row first."""
        assert self._image is not None, "draw before looking at the picture"
        return self._image

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        mirror: Mirror | LensMirror | None = None,
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; the result is `picture`, and `read()` fetches it.

        `camera` is in the world (meters). Depth is the scene's own, without rain. Raises `ValueError` for a lens or a
        rolling shutter without tiles.
        """
        if not (camera.is_pinhole or self.draws_lenses):
            raise ValueError("opengl-quads draws pinhole cameras with a global shutter; choose cpu or opengl-tiles")
        with self._active:
            light, films_ms = None, dict[str, float]()
            if mirror is not None:
                with timed(films_ms, "mirror"):
                    self._draw(_film_items(parts), camera)
                    self._complete()
                    light = self._uploaded(mirror.reflected(self._fetch(self.picture)[..., :2]))
            self._draw(parts, camera, rain, with_depth=with_depth, mode=mode, mirrored=light)
            (self._drawn or self.statistics).stages_ms |= films_ms
            self.arrays.release_unused()

    def _draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        mirrored: moderngl.Texture | None = None,
    ) -> None:
        if self._requests:
            self._complete()
            self._requests.clear()
        self._take_stock()
        self._drawn = RenderStatistics(
            gaussians=sum(part.drawn_count for part in parts), stages_ms={"project": 0.0, "sort": 0.0, "draw": 0.0}
        )
        falling = rain if rain is not None and not rain.is_clear and mode == "splats" else None
        self._drawn.haze_drawn = len(falling.haze) if falling is not None else 0
        self._makes_drops = falling is not None and falling.draws_drops and camera.is_pinhole
        if falling is not None and not camera.is_pinhole:
            self._drawn.drops_drawn = len(falling.drops.numbers)
        before = self.context.detect_framebuffer()
        self.context.memory_barrier()  # otherwise shaders may overwrite data that the last frame still reads
        with self._timers.stage("project"):
            slots = self._projection.project(self._store, parts, camera, falling, mode)
        with self._timers.stage("sort"):
            self._projection.compact_visible(self._store, self._sort, slots)
            order = self._sort.sort(self._store.work)
        light = falling.light_linear if falling is not None and falling.is_linear else None
        lit = falling.lamp_light if falling is not None and falling.is_linear else None
        with_depth = with_depth or mode == "depth" or lit is not None
        medium = falling.medium if falling is not None else None
        if self._tiles is not None:
            self._redraw = partial(
                self._blend_tiles, order, slots.all, camera, mode, light, medium, lit, mirrored, with_depth=with_depth
            )
            self._redraw()
        else:
            with self._timers.stage("draw"):
                self._blend_quads(
                    order, camera, mode, medium, lit, with_depth=with_depth, linear_rain=light is not None
                )
                self._image = self._mirrored(self._lit(self._resolve(mode, light), lit), mirrored)
        before.use()
        if self._is_software:
            self._take_stock()

    def read(self) -> Frame:
        """Fetch the last image (and depth, if it was drawn) from the GPU.

        Raises `DeviceLostError` if the GPU was reset meanwhile: the data would be invalid.
        """
        with self._active:
            self._complete()
            rgba = self._fetch(self.picture)
            depth = self._targets["splats"].depth
            sums = None if depth is None else self._fetch(depth)
            check_context(self.context)
            if sums is None:
                return Frame(rgba)
            return Frame(rgba, expected(sums[..., 0], sums[..., 1], MIN_WEIGHT))

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        """Fetch the last image as bytes over a background; raises as `read` does."""
        return self.request_uint8(background)()

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        """Start to fetch the last image as bytes over a background: the GPU copies it before it draws the next.

        The returned function waits for it and raises as `read` does; before the call, other images may be drawn.
        """
        with self._active:
            request = self._bytes.start(self.picture, background)
        self._requests.append(request)

        def result() -> UInt8[np.ndarray, "h w 3"]:
            with self._active:
                if request in self._requests:
                    self._complete()
                image = request.image()
                check_context(self.context)
                return image

        return result

    def _complete(self) -> None:
        """Read the statistics of the last image; draw it once more, and copy it as requested, if pairs had no room."""
        self._take_stock()
        while self.statistics.pairs_left_out:
            self._redraw()
            self.statistics.pairs_left_out = self._pairs_left_out()
            for request in self._requests:
                self._bytes.copy(self.picture, request)

    def finish(self) -> None:
        """Wait for the last image without reading it, and bring `statistics` up to date."""
        with self._active:
            self._take_stock()

    def _take_stock(self) -> None:
        """Read the statistics of the last image from the GPU."""
        if self._drawn is None:
            return
        self.statistics, self._drawn = self._drawn, None
        self.statistics.stages_ms |= self._timers.collect()
        self.statistics.splats_drawn = count_in(self._store.work)
        self.statistics.pairs_left_out = self._pairs_left_out()
        if self._makes_drops:
            self.statistics.drops_drawn = self._projection.drops.found_count()

    def _pairs_left_out(self) -> int:
        return 0 if self._tiles is None else self._tiles.pairs_left_out()

    def _fetch(self, texture: moderngl.Texture) -> Float32[np.ndarray, "h w c"]:
        width, height = texture.size
        return np.frombuffer(texture.read(), np.float32).reshape(height, width, texture.components).copy()

    def _blend_tiles(
        self,
        order: moderngl.Buffer,
        capacity: int,
        camera: Camera,
        mode: RenderMode,
        rain_light: Float32[np.ndarray, "3"] | None,
        medium: RainMedium | None,
        lit: LampLight | None,
        mirrored: moderngl.Texture | None,
        *,
        with_depth: bool,
    ) -> None:
        """Draw the sorted splats, at most `capacity`, tile by tile."""
        assert self._tiles is not None
        size = camera.width, camera.height
        target = self._target("splats", FramebufferLayout(size, False, with_depth, lit is not None))
        switches = _switches(mode, with_depth=with_depth, linear_rain=rain_light is not None, medium=medium, lit=lit)
        lights: dict[str, Any] = {} if rain_light is None else {"rain_light": tuple(rain_light)}
        if medium is not None:
            lights |= sky_uniforms(medium)
            if camera.is_pinhole:
                lights["intrinsics"] = camera.fx, camera.fy, camera.cx, camera.cy
        if not camera.is_pinhole:
            switches = {**switches, "LENS": 1}
            self._bound_rays(camera.rays).use(_RAYS_UNIT)
            lights["rays"] = _RAYS_UNIT
            if medium is not None:
                lights["medium_by_distance"] = medium.by_distance
        self._tiles.draw(
            self._store, order, capacity, (target.color, target.depth, target.lamps), switches, lights, self._timers
        )  # fmt: skip
        with self._timers.stage("draw"):
            picture = self._resolve(mode, None)
            lit_picture = self._lit(picture, lit) if camera.lens is None else self._lit_along(picture, lit, camera)
            self._image = self._mirrored(lit_picture, mirrored)

    def _blend_quads(
        self,
        order: moderngl.Buffer,
        camera: Camera,
        mode: RenderMode,
        medium: RainMedium | None,
        lit: LampLight | None,
        *,
        with_depth: bool,
        linear_rain: bool,
    ) -> None:
        """Draw the sorted splats into an empty framebuffer, or upon the medium's airlight."""
        size = camera.width, camera.height
        target = self._target("splats", FramebufferLayout(size, linear_rain, with_depth, lit is not None))
        switches = _switches(mode, with_depth=with_depth, linear_rain=linear_rain, lit=lit)
        macros = {**switches, **self._store.switches}
        program, vertices = self._program("splat.vert", "splat.frag", macros, self._quads)
        program["image_size"] = size
        target.framebuffer.use()
        target.framebuffer.clear()
        if medium is not None:
            sky, corners = self._program("screen.vert", "medium_sky.frag", switches)
            for name, value in sky_uniforms(medium).items():
                sky[name] = value
            sky["intrinsics"] = camera.fx, camera.fy, camera.cx, camera.cy
            corners.render(moderngl.TRIANGLES, vertices=3)
        self._store.bind()
        order.bind_to_storage_buffer(SLOTS)
        context = self.context
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.ONE, moderngl.ONE if mode == "overdraw" else moderngl.ONE_MINUS_SRC_ALPHA
        context.provoking_vertex = moderngl.FIRST_VERTEX_CONVENTION
        vertices.render_indirect(self._store.work, moderngl.TRIANGLES, count=1)
        context.provoking_vertex = moderngl.LAST_VERTEX_CONVENTION
        context.enable_only(moderngl.NOTHING)

    def _resolve(self, mode: RenderMode, rain_light: Float32[np.ndarray, "3"] | None) -> moderngl.Texture:
        """Combine scene and rain in linear light, or turn numbers into heat colors."""
        splats = self._targets["splats"]
        if rain_light is not None:
            assert splats.shares is not None
            program, vertices = self._program("screen.vert", "rain_resolve.frag", {})
            program["rain_light"] = tuple(rain_light)
            textures = {"clear_scene": splats.color, "shares": splats.shares}
        elif mode in ("depth", "overdraw"):
            program, vertices = self._program("screen.vert", "heat.frag", {"DEPTH": 1} if mode == "depth" else {})
            program["ends"] = (NEAREST_M, FARTHEST_M) if mode == "depth" else (0.0, float(MAX_FRAGMENTS))
            numbers = splats.depth if mode == "depth" else splats.color
            assert numbers is not None
            textures = {"numbers": numbers}
        else:
            return splats.color
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            program[name] = unit
        target = self._target("resolved", FramebufferLayout(splats.layout.size))
        target.framebuffer.use()
        vertices.render(moderngl.TRIANGLES, vertices=3)
        return target.color

    def _lit(self, picture: moderngl.Texture, lit: LampLight | None) -> moderngl.Texture:
        """Add the light of lamps to a picture."""
        splats = self._targets["splats"]
        if lit is None or splats.lamps is None or splats.depth is None:
            return picture
        has_medium = lit.table.size > 0
        program, vertices = self._program("screen.vert", "lamp_light.frag", {"MEDIUM": 1} if has_medium else {})
        for name, value in self._projection.drops.lamps.picture_uniforms(lit).items():
            program[name] = value
        textures = {"picture": picture, "drop_light": splats.lamps}
        if has_medium:
            textures["depths"] = splats.depth
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            program[name] = unit
        target = self._target("lit", FramebufferLayout(splats.layout.size))
        target.framebuffer.use()
        vertices.render(moderngl.TRIANGLES, vertices=3)
        return target.color

    def _lit_along(self, picture: moderngl.Texture, lit: LampLight | None, camera: Camera) -> moderngl.Texture:
        """Add the light of lamps to a picture through a lens; computed on the processor."""
        splats = self._targets["splats"]
        if lit is None or splats.lamps is None or splats.depth is None:
            return picture
        light = self._fetch(splats.lamps)[..., :3].copy()
        if lit.table.size:
            sums = self._fetch(splats.depth)
            light += light_in_picture(lit, sums[..., 2].copy(), sums[..., 1].copy(), camera.rays)
        light[~camera.rays.is_imaged] = 0
        return self._mirrored(picture, self._uploaded(light, "lamps"), "lit")

    def _bound_rays(self, rays: PixelRays) -> moderngl.Texture:
        """Texture of the rays of a camera with a lens, held for the next picture."""
        if self._rays is None or self._rays[0] is not rays:
            if self._rays is not None:
                self._rays[1].release()
            height, width = rays.is_imaged.shape
            texels = np.dstack([rays.directions, rays.is_imaged.astype(np.float32)])
            texture = self.context.texture((width, height), 4, texels.tobytes(), dtype="f4")
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
            self._rays = rays, texture
        return self._rays[1]

    def _uploaded(self, light: Float32[np.ndarray, "h w 3"], name: str = "mirror") -> moderngl.Texture:
        """Texture of linear light, which is used until the next one of that name."""
        height, width = light.shape[:2]
        held = self._lights.get(name)
        if held is None or held.size != (width, height):
            if held is not None:
                held.release()
            self._lights[name] = held = self.context.texture((width, height), 3, dtype="f4")
            check_gpu_memory(self.context, light.nbytes)
        held.write(np.ascontiguousarray(light).data)
        return held

    def _mirrored(
        self, picture: moderngl.Texture, light: moderngl.Texture | None, name: str = "mirrored"
    ) -> moderngl.Texture:
        """Add linear light, such as that which wet ground reflects, to a picture."""
        if light is None:
            return picture
        program, vertices = self._program("screen.vert", "add_light.frag", {})
        for unit, (sampler, texture) in enumerate({"picture": picture, "light": light}.items()):
            texture.use(unit)
            program[sampler] = unit
        target = self._target(name, FramebufferLayout(picture.size))
        target.framebuffer.use()
        vertices.render(moderngl.TRIANGLES, vertices=3)
        return target.color

    def _program(
        self, vertex: str, fragment: str, switches: Switches, indices: moderngl.Buffer | None = None
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        key = (fragment, *switches.items())
        if key not in self._programs:
            program = load_program(self.context, vertex, fragment, switches=switches)
            self._programs[key] = program, self.context.vertex_array(program, [], index_buffer=indices)
        return self._programs[key]

    def _target(self, name: str, layout: FramebufferLayout) -> Framebuffer:
        held = self._targets.get(name)
        if held is None or held.layout != layout:
            if held is not None:
                held.release()
            self._targets[name] = Framebuffer.make(self.context, layout)
        return self._targets[name]


def _switches(
    mode: RenderMode,
    *,
    with_depth: bool,
    linear_rain: bool,
    medium: RainMedium | None = None,
    lit: LampLight | None = None,
) -> Switches:
    """Macros of splat.frag, medium_sky.frag and tile_blend.comp."""
    switches = {"LINEAR_RAIN": linear_rain, "WITH_DEPTH": with_depth, "MEDIUM": medium is not None}
    switches["LAMPS"] = lit is not None
    switches |= {"ELLIPSOIDS": mode == "ellipsoids", "OVERDRAW": mode == "overdraw"}
    return {name: 1 for name, is_set in switches.items() if is_set}


_BYTE_BUFFERS = 2  # images that may be on their way to the processor at once


class _ByteRequest:
    """Image on its way from the GPU, in a buffer that only reading uses, so that drivers put it into main memory."""

    def __init__(self, buffer: GrowableBuffer, size: tuple[int, int], background: Color) -> None:
        self.buffer, self.size, self.background = buffer, size, background
        self._image: UInt8[np.ndarray, "h w 3"] | None = None

    @property
    def nbytes(self) -> int:
        return 3 * self.size[0] * self.size[1]

    def image(self) -> UInt8[np.ndarray, "h w 3"]:
        """Wait for the image; from then on its buffer is free."""
        if self._image is None:
            width, height = self.size
            pixels = np.frombuffer(self.buffer.buffer.read(self.nbytes), np.uint8)
            self._image = pixels.reshape(height, width, 3)
        return self._image


class _ByteReader:
    """Converts images to bytes on the GPU, and copies them to a ring of buffers from which they are read later."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shader = load_compute_shader(context, "picture_bytes.comp")
        self._words = GrowableBuffer(context)
        self._ring = [GrowableBuffer(context) for _ in range(_BYTE_BUFFERS)]
        self._requests: dict[int, _ByteRequest] = {}
        """Last request of each buffer of the ring."""
        self._count = 0

    def start(self, picture: moderngl.Texture, background: Color) -> _ByteRequest:
        place = self._count % _BYTE_BUFFERS
        self._count += 1
        if place in self._requests:
            self._requests[place].image()  # or the new image would replace it
        request = self._requests[place] = _ByteRequest(self._ring[place], picture.size, background)
        self.copy(picture, request)
        return request

    def copy(self, picture: moderngl.Texture, request: _ByteRequest) -> None:
        """Convert an image and copy it into the buffer of a request."""
        fours = -(-picture.size[0] * picture.size[1] // 4)
        self._words.reserve(12 * fours)
        self._words.bind(0)
        picture.use(0)
        self._shader.set(picture=0, size=picture.size, background=request.background)
        self._shader.run_all(-(-fours // 256))
        self._context.memory_barrier()
        target = request.buffer.reserve(request.nbytes)
        self._context.copy_buffer(target, self._words.buffer, size=request.nbytes)


class Screen:
    """Converts images for the screen: background, display gain, 8 bits.

    Two textures take turns, so that the last image can be displayed while another thread draws the next.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = load_program(context, "screen.vert", "tonemap.frag")
        self._vertices = context.vertex_array(self._program, [])
        self._last: tuple[moderngl.Texture, moderngl.Framebuffer] | None = None
        self._next: tuple[moderngl.Texture, moderngl.Framebuffer] | None = None

    def show(
        self,
        picture: moderngl.Texture,
        background: Color = (0.0, 0.0, 0.0),
        gain: float = 1.0,
        sharpness: float = 0.0,
    ) -> moderngl.Texture:
        """Tone-map a premultiplied image; `gain` multiplies linear light.

        `sharpness` is a factor on each pixel's difference from its four neighbors, for images that are enlarged.
        """
        if self._next is not None and self._next[0].size != picture.size:
            for old in reversed(self._next):
                old.release()
            self._next = None
        if self._next is None:
            texture = self._context.texture(picture.size, 4)
            self._next = texture, self._context.framebuffer([texture])
        self._last, self._next = self._next, self._last
        texture, framebuffer = self._last
        picture.use(0)
        self._program["picture"], self._program["background"], self._program["gain"] = 0, background, gain
        self._program["sharpness"] = sharpness
        before = self._context.detect_framebuffer()
        framebuffer.use()
        self._vertices.render(moderngl.TRIANGLES, vertices=3)
        before.use()
        return texture


# Films and standing water, as colors: the rasterizers have no channels for them


def _film_items(items: Sequence[DrawItem]) -> list[DrawItem]:
    """Items whose colors are their shares of films (red) and standing water (green), for renderers without channels."""
    return [
        item._replace(
            gaussians=_film_colored(item.gaussians, IdentityKey(item.film)), wet_sh=None, selected=None, colors=None
        )
        for item in items
    ]


@scene_cache(maxsize=64)
def _film_colored(gaussians: Gaussians, film: IdentityKey) -> Gaussians:
    shares: np.ndarray | None = film.of  # pyright: ignore[reportAssignmentType]
    color = np.zeros((len(gaussians), 1, 3), np.float32)
    if shares is not None:
        color[:, 0, :2] = shares
    return gaussians.with_sh((color - np.float32(0.5)) / np.float32(SH_C0))

"""Live view: panes, camera mosaic and screenshots, uploads of scenes in slices, and sampling of the sky color."""

import logging
import math
import time
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Literal

import moderngl
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ...backends import measure_device, rasterizer_for
from ...choices import RenderMode
from ...compile_cache import has_kernels
from ...rain.frame import SkyLight
from ...rain.simulation import RainSimulation
from ...render.draw import draw
from ...render.frame_input import CameraMemory, FrameInput, Mount, Quality
from ...render.images import write_png
from ...render.level_of_detail import LodCut, LodSubset, Thinning
from ...render.opengl.buffers import GpuArrays
from ...render.opengl.context import can_draw_scenes, check_context, version_name
from ...render.opengl.renderer import Screen, SplatRenderer
from ...render.passes.glass import ego_motion
from ...render.relief import Relief
from ...render.renderer import Color, DrawnPicture, Renderer, timed
from ...render.sky_color import SkyColor, sample_sky
from ...render.still_scene import StillScene
from ...render.view import RenderView
from ...render.view_reuse import ViewReuse
from ...scene.camera import Camera
from ...scene.gaussians import Gaussians, IdentityKey
from ...scene.lod_tree import MIN_GAUSSIANS, PIXEL, merged_harmonics
from ...scene.scene import Actor, Layer, RigCamera, Scene
from ...threads import half_of_cores
from ..viewport.options import FULL_QUALITY, QualityLevel, Texture
from ..viewport.picking import mean_color_in_rectangle
from ..viewport_state import PendingScene
from .frame import DrawnImage, DrawResult, MosaicInput, MosaicResult, RenderInput, SplitPane
from .live_trees import LiveCut, LiveTrees
from .textures import CpuTexture

logger = logging.getLogger("gsrain")
WindowBackend = Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"]
_STAND_IN_GAUSSIANS = 1_500_000  # larger scenes wait for the CPU kernels: software OpenGL would take minutes
_LOADING_S = 10.0  # time to load cached kernels on a busy machine; after it, they are assumed to need compiling
_UPLOAD_S = 0.01  # time per frame for uploading slices of a scene
_MIRROR_EVERY = 3  # pictures of reduced quality that share a mirror image
_FEWER = 1 / 8  # share of the Gaussians of parts without a tree, in pictures that merge details
_FEWER_ASIDE = QualityLevel(1 / 8, 1.0)  # of small images next to the viewport, during playback
_MERGED_ASIDE = QualityLevel(1.0, 1.0, error_px=1.0)  # the same, where details can be merged
SHARPNESS = 0.75
"""Of pictures with fewer pixels, which are enlarged: pictures of the street are nearest to exact ones then."""
_ASIDE_TIME = 1 / 10  # share of the time that these images take, during playback
_CHUNK_SIZE = 1 << 16  # number of new Gaussians that a frame uploads directly; for more, the last scene stays visible


class LiveView:
    """Draws the viewport's panes, in an OpenGL context that is current on the calling thread.

    The fastest way draws (`measure_device`): tiles on a GPU; if OpenGL is a software rasterizer, the CPU renderer,
    which draws the same image several times faster. OpenGL substitutes, without rain, until another process has
    compiled the CPU kernels; if they are cached, the viewport waits for them instead, because compiling shaders takes
    longer. `backend` overrides the choice. Where OpenGL is too old for `SplatRenderer`, it only shows the processor's
    images: a `backend` of OpenGL raises `NoOpenGLError` there.
    """

    def __init__(
        self,
        context: moderngl.Context,
        backend: WindowBackend = "auto",
        finish: Callable[[], None] | None = None,
        checkpoint: Callable[[], None] = lambda: None,
    ) -> None:
        """`finish` waits until everything is drawn, by default as the context does.

        `checkpoint` is called between the stages of a pane's picture; what it raises ends the drawing.
        """
        self.context = context
        self._finish = finish or context.finish
        self.speed = measure_device(context)
        """Times by which the back end was chosen."""
        on_cpu = self.speed.is_cpu_fastest if backend == "auto" else backend == "cpu"
        self._opengl: SplatRenderer | None = None
        """None where it is too old."""
        if can_draw_scenes(context) or not on_cpu:
            self._opengl = SplatRenderer(context, rasterizer=rasterizer_for(backend, self.speed))
        self.arrays = GpuArrays(context) if self._opengl is None else self._opengl.arrays
        """Arrays of Gaussians on the GPU."""
        self._checkpoint = checkpoint
        self._cpu = CpuTexture(context) if on_cpu else None
        self._waits_until = 0.0
        self._compiles = False  # kernels that are not in the cache
        if self._cpu is not None:
            self._compiles = not has_kernels()
            self._cpu.compile()
            self._waits_until = 0.0 if self._compiles else time.perf_counter() + _LOADING_S
        self._on_cpu = self._gpu_is_full = self._can_draw = self._is_empty = False
        self._panes = (_PaneImage(context), _PaneImage(context))
        self._memory = CameraMemory()
        self._filtered: dict[Hashable, moderngl.Texture] = {}
        """Textures of pictures through glass, by camera."""
        self._pane_count = 1
        self._has_built = False
        self._sky = SkyColorSampler()
        self._unused_sky: SkyColor | None = None
        """Sample of a picture that was given up, for the next one."""
        self._pending: PendingScene | None = None
        self._preparing: Iterator[None] = iter(())
        self._is_pending_ready = False
        self._upload = SceneUpload(self.arrays)
        self._is_uploading = False  # a pane still shows an older scene
        self._upload_until = 0.0
        self._thinnings: dict[float, LodSubset] = {}
        self._thinned: Scene | None = None
        self.trees = LiveTrees()
        """Trees of the scenes on the screen, for pictures by the processor."""

    def draw(self, frame: RenderInput) -> DrawResult:
        """Draw a frame. Returns the last textures if nothing has changed.

        If the scene exceeds GPU memory, the CPU renderer takes over.
        """
        try:
            return self._draw(frame)
        except MemoryError as error:
            if self._on_cpu or self._gpu_is_full:
                raise
            self._gpu_is_full = True
            self._cpu = self._cpu or CpuTexture(self.context)
            self._cpu.compile()
            self._upload.give_up()
            self.arrays.release_everything()
            problem = f"{error}: the processor draws from now on"
            return DrawResult(frame, self.last_textures, self.last_reliefs, is_compiling=True, problems=[problem])

    def _draw(self, frame: RenderInput) -> DrawResult:
        if self._cpu is not None and self._cpu.has_failed:
            if self._opengl is None:
                version = version_name(self.context.version_code)
                raise OSError(f"the processor's kernels can't be compiled, and {version} draws no scenes instead")
            self._cpu, self._gpu_is_full, self._compiles = None, False, False
            for pane in self._panes:
                pane.state = None  # drawn again, with rain
        self._on_cpu = self._cpu is not None and self._cpu.is_ready  # once a frame: it may change at any moment
        self._can_draw = self._cpu is None or self._on_cpu or self._substitutes_cpu(frame.scene)
        if frame.harmonics != self.arrays.harmonics:
            self.arrays.keep_harmonics_as(frame.harmonics)
            self._upload.give_up()
            self._pending, self._is_pending_ready = None, False  # its upload starts over
        self._is_uploading, self._upload_until = False, time.perf_counter() + _UPLOAD_S
        self._prepare(frame)
        self._pane_count = len(frame.panes)
        for pane in self._panes[: -self._pane_count]:
            if pane.scene is not None:
                pane.state, pane.scene, pane.still = None, None, StillScene()
        self._release_closed_scene(frame)
        scenes = (frame.scene, *(side.scene for side in frame.panes)) if self._on_cpu else ()
        self.trees.follow(scenes)
        result = DrawResult(frame, is_compiling=not self._can_draw, is_pending_ready=self._is_pending_ready)
        result.is_preparing = self._compiles and not self.is_settled
        result.kernels = self._cpu.compiled if self._cpu is not None and result.is_preparing else None
        if self._can_draw:
            self._sample_sky(frame, result)
        sky = (result.sky or frame.sky).at(frame.overcast)
        # The last pane, on the right, is the document itself: statistics are those of its image.
        started, panes = time.perf_counter(), self._panes[-self._pane_count :]
        drawn = [self._draw_pane(frame, side, pane, sky) for side, pane in zip(frame.panes, panes, strict=True)]
        if self._cpu is not None and (drawn[-1] or not self._can_draw) and frame.scene.gaussian_count:
            self._cpu.compile()  # after the first image, which compiling would delay
        rows_ms = dict[str, float]()
        if any(drawn):
            with timed(rows_ms, "show"):
                self._finish()
        for pane, is_drawn in zip(panes, drawn, strict=True):
            for row, milliseconds in (pane.rows_ms if is_drawn else {}).items():
                rows_ms[row] = rows_ms.get(row, 0.0) + milliseconds
        if drawn[-1]:
            milliseconds = 1000 * (time.perf_counter() - started) - self._shared_ms(frame, panes)
            result.drawn = self._measured(frame, milliseconds, rows_ms)
        if frame.screenshot is not None:
            self._save_screenshot(frame.screenshot, frame.divider, result)
            result.has_screenshot = True
        if frame.thumbnail and self._can_draw:
            result.thumbnail = self._displayed_pixels(frame.divider)
        samples = frame.samples_sky and not result.sky_is_exact and not self._sky.is_through
        result.is_catching_up = self._is_uploading or (samples and self._can_draw)
        result.textures, result.reliefs, result.is_settled = self.last_textures, self.last_reliefs, self.is_settled
        result.has_cuts = self._on_cpu and frame.mode == "splats" and self.trees.cover(scenes)
        self._unused_sky = None
        return result

    @property
    def is_settled(self) -> bool:
        """True if no other back end takes over from the active one."""
        return self._is_empty or self._cpu is None or self._cpu.is_ready or self._cpu.has_failed

    @property
    def last_textures(self) -> tuple[moderngl.Texture, ...]:
        """Last textures, one per pane."""
        return tuple(pane.texture for pane in self._panes[-self._pane_count :])

    @property
    def last_reliefs(self) -> tuple[Relief | None, ...]:
        """Reliefs of the last textures."""
        return tuple(pane.relief for pane in self._panes[-self._pane_count :])

    def draw_aside(
        self, images: MosaicInput, camera: RigCamera, screen: Screen, reuse: ViewReuse
    ) -> moderngl.Texture | None:
        """Draw a small image next to the viewport after `draw`, or None; in playback with fewer Gaussians, mirrors."""
        if not self._can_draw or (not self._on_cpu and self._upload.missing(images.scene) > _CHUNK_SIZE):
            return None
        quality = FULL_QUALITY
        if images.is_playing:
            quality = _MERGED_ASIDE if self._on_cpu and self.trees.cover([images.scene]) else _FEWER_ASIDE
        thinning = self.thinning(quality, images.scene)
        scene, name, view = images.scene, f"rig/{camera.name}", images.view_of(camera)
        past = ego_motion(scene, view).motion
        mount = Mount(self._memory, name, past, camera.camera_to_ego[:3, :3])
        reflected = thinning.reflected if isinstance(thinning, LiveCut) else None
        drawn = Quality(thinning=thinning, reflected=reflected, reuse=reuse if images.is_playing else None)
        frame = FrameInput.of(scene, images.rainfall, images.sky, view, drawn, without={"sensor"}, mount=mount)
        with half_of_cores() if images.is_playing else nullcontext():
            picture = draw(self._renderer, frame)
        return screen.show(self._texture(picture, name, images.background), images.background, 2.0**images.gain_ev)

    def _substitutes_cpu(self, scene: Scene) -> bool:
        """Return whether OpenGL draws until the CPU renderer is ready."""
        if self._opengl is None:
            return False
        waits = time.perf_counter() < self._waits_until  # its kernels are loaded soon
        return not (waits or self._gpu_is_full) and scene.gaussian_count <= _STAND_IN_GAUSSIANS

    @property
    def _renderer(self) -> Renderer:
        if self._cpu is not None and self._on_cpu:
            return self._cpu.renderer
        assert self._opengl is not None, "nothing is drawn before the processor can"
        return self._opengl

    def _texture(self, picture: DrawnPicture, camera: Hashable, background: Color) -> moderngl.Texture:
        """Texture of a picture that was just drawn; of one behind glass, that of its camera."""
        if not picture.filters:
            if self._cpu is not None and self._on_cpu:
                return self._cpu.upload()
            assert self._opengl is not None, "drawn before"
            return self._opengl.picture
        pixels = picture.read_uint8(background)
        height, width = pixels.shape[:2]
        texture = self._filtered.get(camera)
        if texture is None or texture.size != (width, height):
            if texture is not None:
                texture.release()
            texture = self._filtered[camera] = self.context.texture((width, height), 3, alignment=1)
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        texture.write(pixels, alignment=1)
        return texture

    def _release_closed_scene(self, frame: RenderInput) -> None:
        """Free the resources of the previous scene, once, after it was closed."""
        is_empty = not frame.scene.members and frame.pending is None
        if is_empty and not self._is_empty:
            self._sky.forget()
            self._thinnings.clear()
            self._thinned = frame.scene
            self._upload.give_up()
            self.arrays.release_everything()
            for pane in self._panes:
                pane.still, pane.reuse, pane.relief = StillScene(), ViewReuse(_MIRROR_EVERY), None
            if self._cpu is not None:
                self._cpu.renderer.release_scenes()
        self._is_empty = is_empty
        if self._thinned is not frame.scene:
            self._thinned = frame.scene
            for thinning in self._thinnings.values():
                thinning.forget_all_but(member.gaussians for member in frame.scene.members)

    def _sample_sky(self, frame: RenderInput, result: DrawResult) -> None:
        """Continue to sample the sky color if it is out of date, and measure a color that was picked."""
        if frame.samples_sky:
            resting, whole = not (frame.is_moving or frame.is_playing), frame.screenshot is not None
            camera, trees = frame.view.camera, self.trees if self._on_cpu else None
            result.sky = self._sky.look(
                self._renderer, frame.scene, camera, frame.sky, trees, resting=resting or self._on_cpu, at_once=whole
            )
            if result.sky is None and self._sky.is_through:
                result.sky = self._unused_sky
            self._unused_sky = result.sky
            result.sky_is_exact = self._sky.is_exact
        if frame.picked is not None:
            region, *weather = frame.picked
            result.picked_color = mean_color_in_rectangle(
                self._renderer, frame.scene, frame.view, region, frame.background, *weather
            )

    def _draw_pane(self, frame: RenderInput, side: SplitPane, pane: "_PaneImage", sky: SkyLight) -> bool:
        """Draw a pane unless it is up to date; return whether it was drawn."""
        scene = self._drawable(side.scene, pane, whole=frame.screenshot is not None)
        quality = frame.quality
        state = (_fingerprint(frame, scene, side.rainfall, sky), quality, self._on_cpu)
        if state == pane.state or not self._can_draw:
            return False
        if pane.scene is not scene:
            pane.still = StillScene()  # the last one would hold the last scene
        # Without a scene, rain has nothing to fall on; while its kernels compile, it would wait for them.
        rainfall = side.rainfall if scene.members and (self._on_cpu or not self._compiles) else None
        selection = frame.selection and frame.screenshot is None
        thinning = self.thinning(quality, scene, frame.mode, exact=frame.screenshot is not None)
        name = f"pane/{self._panes.index(pane)}"
        drawn = Quality(
            frame.mode, thinning=thinning, reflected=thinning.reflected if isinstance(thinning, LiveCut) else None,
            selection=selection, reuse=None if quality.is_exact else pane.reuse,
            still=pane.still if quality.has_backdrop else None,
        )  # fmt: skip
        mount = Mount(self._memory, name)
        whole = FrameInput.of(scene, rainfall, sky, frame.view, drawn, without={"sensor"}, mount=mount)
        is_alone = quality.is_exact or not (frame.is_moving or frame.is_playing)
        with self._interruptible(), nullcontext() if is_alone else half_of_cores():
            picture = draw(self._renderer, whole)
            pane.relief = self._relief(scene, frame.view)
        sharpness = SHARPNESS if quality.scale < 1 else 0.0
        with timed(picture.passes_ms, "show"):
            texture = self._texture(picture, name, frame.background)
            pane.texture = pane.screen.show(texture, frame.background, 2.0**frame.gain_ev, sharpness)
        pane.rows_ms = picture.rows_ms
        pane.state, pane.scene = state, scene
        return True

    def _relief(self, scene: Scene, view: RenderView) -> Relief | None:
        """Relief of the processor's last picture; OpenGL draws pictures faster than cameras move on."""
        depth = None if self._cpu is None or not self._on_cpu else self._cpu.renderer.read().rough_depth
        return None if depth is None else Relief.of(depth(), view.camera, scene, view.time_s)

    @contextmanager
    def _interruptible(self) -> Generator[None]:
        """Let the checkpoint end the drawing within the block; samples of the sky, for one, go on to their end."""
        if self._cpu is None:
            yield
            return
        renderer = self._cpu.renderer
        before, renderer.checkpoint = renderer.checkpoint, self._checkpoint
        try:
            yield
        finally:
            renderer.checkpoint = before

    def _drawable(self, scene: Scene, pane: "_PaneImage", *, whole: bool) -> Scene:
        """The scene; or unless `whole` the last one, while much of the new one has yet to be uploaded."""
        if self._on_cpu or not self._can_draw or pane.scene is None or whole:
            return scene
        if self._upload.missing(scene) <= _CHUNK_SIZE or self._upload.missing(pane.scene):
            return scene
        if self._upload.go_on(scene, self._upload_until):
            return scene
        self._is_uploading = True
        return pane.scene

    def thinning(
        self, quality: QualityLevel, scene: Scene, mode: RenderMode = "splats", *, exact: bool = False
    ) -> Thinning | None:
        """Choose the drawn Gaussians: of a large scene a cut, whose number falls with the square of its error."""
        merges = quality.error_px > 0
        share = _FEWER if merges else quality.gaussians
        subset = None if share == 1 else self._thinnings.setdefault(share, LodSubset(share))
        if merges and subset is not None and mode == "splats":
            return LiveCut(quality.error_px, self.trees, subset)
        is_large = mode == "splats" and not exact and scene.gaussian_count >= MIN_GAUSSIANS
        if is_large and any(each.tree is not None for each in scene.members):
            return LodCut(PIXEL / math.sqrt(share), subset)
        return subset

    def _shared_ms(self, frame: RenderInput, panes: "tuple[_PaneImage, ...]") -> float:
        """Time that the last picture took for backdrops, unless they change with each picture."""
        built_ms = sum(pane.still.built_ms for pane in panes) if frame.quality.has_backdrop else 0.0
        before, self._has_built = self._has_built, built_ms > 0
        return 0.0 if before else built_ms

    def _measured(self, frame: RenderInput, milliseconds: float, rows_ms: Mapping[str, float]) -> DrawnImage:
        statistics, camera = self._renderer.statistics, frame.view.camera
        figures = {
            "frame ms": milliseconds,
            "megapixels": 1e-6 * camera.width * camera.height,
            **{f"{row} ms": value for row, value in rows_ms.items()},
            "Gaussians": statistics.gaussians,
            "splats drawn": statistics.splats_drawn,
            "drops drawn": statistics.drops_drawn,
            "haze Gaussians": statistics.haze_drawn,
        }
        if self.trees.nbytes:
            figures["merged details MB"] = 1e-6 * self.trees.nbytes
        if statistics.pairs_left_out:
            figures["tile pairs without room"] = statistics.pairs_left_out
        renderer = self._renderer
        name = f"opengl-{renderer.rasterizer}" if isinstance(renderer, SplatRenderer) else renderer.name
        return DrawnImage(frame.quality, milliseconds, name, self.speed.reason, figures)

    def _prepare(self, frame: RenderInput) -> None:
        """Continue to prepare the pending scene for its first frame."""
        if frame.pending is not self._pending:
            if not self._is_pending_ready:
                self._upload.give_up()
            elif self._pending is not None and self._pending.is_opened:
                self._sky.forget()
                self.arrays.release_all_but(uploads_of(frame.scene.members))
            self._pending, self._is_pending_ready = frame.pending, False
            self._preparing = iter(()) if frame.pending is None else self._preparations(frame.pending.scene)
        while self._pending is not None and not self._is_pending_ready:
            self._is_pending_ready = next(self._preparing, self) is self
            if time.perf_counter() >= self._upload_until:
                break

    def _preparations(self, scene: Scene) -> Iterator[None]:
        for member in scene.members:
            for thinning in self._thinnings.values():
                thinning.growth(member.gaussians)
                yield
        if self._cpu is None or (not self._on_cpu and self._substitutes_cpu(scene)):
            while not self._upload.go_on(scene, self._upload_until):
                yield

    def _displayed_pixels(self, divider: float) -> UInt8[np.ndarray, "h w 3"]:
        """Read back the last image; of two panes both, on their sides of the divider."""
        pictures = [
            np.frombuffer(texture.read(), np.uint8).reshape(texture.height, texture.width, 4)[..., :3]
            for texture in self.last_textures
        ]
        check_context(self.context)
        pixels = pictures[-1].copy()
        if len(pictures) == 2:
            at = round(divider * pixels.shape[1])
            pixels[:, :at] = pictures[0][:, :at]
        return pixels

    def _save_screenshot(self, path: Path, divider: float, result: DrawResult) -> None:
        pixels = self._displayed_pixels(divider)
        try:
            write_png(path, pixels)
        except OSError as error:
            result.problems.append(f"{path}: the screenshot can't be saved: {error.strerror or error}")
        else:
            logger.info("Saved %s", path)


class _PaneImage:
    """Texture of one pane, and the state it was drawn from."""

    def __init__(self, context: moderngl.Context) -> None:
        self.screen = Screen(context)
        self.texture = context.texture((1, 1), 4, np.zeros(4, np.uint8))
        self.relief: Relief | None = None
        self.state: Hashable = None
        self.scene: Scene | None = None
        self.reuse = ViewReuse(_MIRROR_EVERY)
        self.still = StillScene()
        self.rows_ms: dict[str, float] = {}
        """Time of each row of *Statistics* in its last picture."""


def _fingerprint(frame: RenderInput, scene: Scene, rainfall: RainSimulation, sky: SkyLight) -> Hashable:
    """Everything that a pane's image depends on; scenes and rains are values and compare by identity."""
    view, camera, time_s = frame.view, frame.view.camera, frame.view.time_s
    has_glass = rainfall.rain.glass != "none"
    raining = frame.mode == "splats" and (has_glass or not rainfall.state_at(time_s).is_clear)
    wet = rainfall.wetness_at(time_s), rainfall.soaked_share_at(time_s)
    ground = (*wet, rainfall.overcast_at(time_s), rainfall.rain.mirror)
    return (
        scene.appearance,
        rainfall if raining else None,
        sky if raining else None,
        time_s if raining or scene.actors else 0.0,
        (camera.world_to_camera.tobytes(), camera.width, camera.height, camera.fx),
        b"" if view.velocity_m_s is None or not raining else view.velocity_m_s.tobytes(),
        (frame.background, frame.gain_ev, frame.mode, frame.harmonics, frame.selection),
        ground if scene.has_wet_colors or scene.water is not None else None,
    )


# Uploads of Gaussians to the GPU in slices


class SceneUpload:
    """Uploads one scene at a time; earlier scenes stay on the GPU as long as there is room."""

    def __init__(self, arrays: GpuArrays) -> None:
        self._arrays = arrays
        self._scene: Scene | None = None
        self._slices: Iterator[float] = iter(())

    def missing(self, scene: Scene) -> int:
        """Number of Gaussians a frame would have to upload to draw a scene."""
        return sum(self._arrays.missing(*each) for each in uploads_of(each for each in scene.members if each.visible))

    def go_on(self, scene: Scene, until_s: float) -> bool:
        """Upload missing slices of a scene until a time of `time.perf_counter`; return whether all are uploaded."""
        if scene is not self._scene:
            parts = list(uploads_of(each for each in scene.members if each.visible))
            self._scene = scene
            self._slices = (
                slice_ for gaussians, wet_sh in parts for slice_ in self._arrays.upload(gaussians, wet_sh=wet_sh)
            )
        while next(self._slices, None) is not None:
            if time.perf_counter() >= until_s:
                return False
        self._scene = None
        return True

    def give_up(self) -> None:
        """Release the slices uploaded for a scene that will not be shown."""
        self._scene, self._slices = None, iter(())
        self._arrays.release_awaited()


def uploads_of(members: Iterable[Layer | Actor]) -> Iterator[tuple[Gaussians, Float32[np.ndarray, "n k 3"] | None]]:
    """Gaussians and wet colors of members, and of their trees."""
    for each in members:
        yield each.gaussians, each.wet_sh
        if each.tree is not None and each.tree.fits(each.gaussians):
            yield each.tree.nodes, None if each.wet_sh is None else merged_harmonics(each.tree, each.wet_sh)


# Sky color, sampled after each change of the scene, one image a frame, so that no frame stalls

_ELSEWHERE_M = 2.0  # from where no sky was found
_QUICK = 60_000  # number of Gaussians that a first sample draws; a second, full one follows
_MERGED_PX = 1.0  # details that are merged instead, where there are trees


class SkyColorSampler:
    """Sky color of the last sample; the first sample finishes immediately, later ones over several frames."""

    def __init__(self) -> None:
        self._sampled: Hashable = None
        """Scene state of the last sample; None before the first."""
        self.is_exact = False
        """True if the last sample included every Gaussian of the present scene, and has found its sky."""
        self._skyless_at: Float64[np.ndarray, 3] | None = None
        """Position from which the last whole sample found no sky: one from elsewhere may."""
        self._requested: Hashable = None
        self._renderer: Renderer | None = None
        self._progress: Generator[None, None, SkyColor] | None = None
        self._is_full = False
        """True if the sample in progress draws all Gaussians."""
        self._skyless: str | None = None
        """Scene of which it was logged that it shows no sky."""
        self.is_through = True
        """True if no sample is pending, except for an exact one while things move."""

    def forget(self) -> None:
        """Forget the last sample, so that the next one finishes at once, e.g. for another scene."""
        self._sampled = self._requested = self._progress = None

    def look(
        self,
        renderer: Renderer,
        scene: Scene,
        place: Camera,
        present: SkyColor | None = None,
        trees: LiveTrees | None = None,
        *,
        resting: bool,
        at_once: bool = False,
    ) -> SkyColor | None:
        """Continue by one image, or to the end if `at_once`; return the sky color when a sample is complete.

        A first sample merges details by `trees`, or has fewer Gaussians; unless `resting`, no other one follows. A
        sample without any sky, as from inside of a house, leaves the `present` one, if that was found in the scene.
        """
        state = _visible_state(scene)
        is_new, stays = state != self._sampled, state == self._requested and renderer is self._renderer
        self._requested, self._renderer = state, renderer
        self.is_exact &= not is_new
        missed = self._skyless_at is not None and np.linalg.norm(place.position - self._skyless_at) < _ELSEWHERE_M
        self.is_through = not is_new and (self.is_exact or bool(missed) or not (resting or at_once))
        if self.is_through:
            self._progress = None
            return None
        count = sum(len(each.gaussians) for each in scene.members if each.visible)
        is_full = count <= _QUICK or at_once or (resting and not is_new)
        if self._progress is None or not stays or is_full != self._is_full:
            fewer = None if is_full else LodSubset(_QUICK / count)
            thinning = fewer if trees is None or fewer is None else LiveCut(_MERGED_PX, trees, fewer)
            self._progress, self._is_full = sample_sky(renderer, scene, place, thinning=thinning), is_full
        to_the_end = at_once or self._sampled is None
        if not (stays or to_the_end):
            return None  # during a drag each frame has another scene
        while True:
            try:
                next(self._progress)
            except StopIteration as end:
                sky: SkyColor = end.value
                break
            if not to_the_end:
                return None
        has_found = sky.found or not state  # a scene that is still loading shows nothing
        self._skyless_at = None if has_found or not self._is_full else place.position
        if not sky.found and present is not None and present.found:
            sky = present
        if not has_found and not sky.found and scene.name != self._skyless:
            self._skyless = scene.name
            logger.info("The scene shows no sky: drops take the color of an overcast one")
        self._sampled, self.is_exact, self._progress = state, self._is_full and has_found, None
        return sky


def _visible_state(scene: Scene) -> Hashable:
    """Everything in a scene that its sky color depends on; the selection does not."""
    parts = [(each.key, part) for each in scene.members if each.visible and (part := scene.part(each)) is not None]
    return tuple(
        (key, part.gaussians, IdentityKey(part.wet_sh), part.to_world.tobytes(), part.left_out, part.opacity,
         None if part.colors is None else part.colors.tobytes())
        for key, part in parts
    )  # fmt: skip


# Camera mosaic


class MosaicImages:
    """Images of the rig's cameras; updates one per frame, oldest first. Lives in the OpenGL context of the view.

    During playback they take a tenth of the time at most: after each image, `clock` has to advance by nine times as
    long as it took.
    """

    def __init__(self, context: moderngl.Context, clock: Callable[[], float] = time.perf_counter) -> None:
        self._context, self._clock = context, clock
        self._pauses_until = -math.inf
        self._screens: dict[str, Screen] = {}
        self._mirrors: dict[str, ViewReuse] = {}
        self._states: dict[str, Hashable] = {}
        self._pictures: dict[str, Texture] = {}
        self._turn: list[str] = []
        """Names of the cameras, the one drawn last at the end."""

    def draw(self, images: MosaicInput, view: LiveView) -> MosaicResult:
        """Draw one outdated camera. Once a frame, after the viewport."""
        cameras = {each.name: each for each in images.cameras}
        self._turn = [name for name in self._turn if name in cameras]
        self._turn += [name for name in cameras if name not in self._turn]
        for each in (self._screens, self._mirrors, self._states, self._pictures):
            for name in each.keys() - cameras.keys():
                del each[name]
        stale = [name for name in self._turn if self._states.get(name) != images.state_of(cameras[name])]
        if not stale:
            return MosaicResult(dict(self._pictures), is_behind=False)
        started = self._clock()
        if images.is_playing and started < self._pauses_until:
            return MosaicResult(dict(self._pictures), is_behind=True)
        name = stale[0]
        screen = self._screens.setdefault(name, Screen(self._context))
        reuse = self._mirrors.setdefault(name, ViewReuse(_MIRROR_EVERY))
        texture = view.draw_aside(images, cameras[name], screen, reuse)
        if texture is not None:
            self._pictures[name] = Texture(texture.glo, texture.width, texture.height)
            self._states[name] = images.state_of(cameras[name])
        self._turn = [each for each in self._turn if each != name] + [name]
        ended = self._clock()
        self._pauses_until = ended + (1 / _ASIDE_TIME - 1) * (ended - started)
        return MosaicResult(dict(self._pictures), is_behind=len(stale) > 1 or texture is None)

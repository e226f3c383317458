"""Live view: panes, camera mosaic and screenshots, uploads of scenes in slices, and sampling of the sky color."""

import logging
import time
from collections.abc import Generator, Hashable, Iterator
from pathlib import Path

import moderngl
import numpy as np

from ...compile_cache import has_kernels
from ...render.draw import LodSubset, RenderView, draw_view
from ...render.images import write_png
from ...render.opengl.context import check_context, is_software
from ...render.opengl.renderer import Screen, SplatRenderer
from ...render.renderer import Renderer
from ...render.sky_color import SkyColor, sample_sky
from ...scene.camera import Camera
from ...scene.gaussians import IdentityKey
from ...scene.scene import RigCamera, Scene
from ...simulation.sensors import camera_of_width, placed_camera
from ..editor import Editor, WindowBackend
from ..viewport.options import FULL_QUALITY, QualityLevel, SplitPane, Texture
from ..viewport.picking import mean_color_in_rectangle
from ..viewport_state import PendingScene
from .textures import CpuTexture

logger = logging.getLogger("gsrain")
_STAND_IN_GAUSSIANS = 1_000_000  # larger scenes wait for the CPU kernels: software OpenGL would take minutes
_LOADING_S = 2.0  # time to load cached kernels, also on a busy machine; after it, kernels are assumed to need compiling
_UPLOAD_S = 0.01  # time per frame for uploading slices of a scene
_ASIDE = 1 / 4  # share of the Gaussians in small images next to the viewport, during playback
_CHUNK_SIZE = 1 << 16  # number of new Gaussians that a frame uploads directly; for more, the last scene stays visible


class LiveView:
    """Draws the viewport's panes. Lives in the window's OpenGL context and on its thread.

    OpenGL draws on a GPU. If OpenGL is a software rasterizer, the CPU renderer draws the same image several times
    faster. OpenGL substitutes until the CPU kernels are compiled; if they are cached, the viewport waits for them
    instead, because compiling shaders takes longer. `backend` overrides the choice.
    """

    def __init__(self, context: moderngl.Context, session: Editor, backend: WindowBackend = "auto") -> None:
        self.session = session
        self._context = context
        self._opengl = SplatRenderer(context)
        on_cpu = is_software(context) if backend == "auto" else backend == "cpu"
        self._cpu = CpuTexture(context) if on_cpu else None
        self._waits_until = 0.0
        if self._cpu is not None and has_kernels():
            self._cpu.compile()
            self._waits_until = time.perf_counter() + _LOADING_S
        self._on_cpu = self._gpu_is_full = self._is_empty = False
        self._panes = (_PaneImage(context), _PaneImage(context))
        self._sky = SkyColorSampler()
        self._moment: RenderView | None = None
        self._is_moving = False
        self._asked_at = 0.0
        self._staged: PendingScene | None = None
        self._preparing: Iterator[None] = iter(())
        self._upload = SceneUpload(self._opengl)
        self._is_uploading = False  # a pane still shows an older scene
        self._upload_until = 0.0
        self._thinnings: dict[float, LodSubset] = {}
        self._thinned = session.scene

    def draw(self, width: int, height: int) -> list[moderngl.Texture]:
        """Draw the present frame for a viewport size in pixels and return a texture for each of the editor's panes.

        Each shows the whole image, first row on top. Returns the last textures if nothing has changed. If the scene
        exceeds GPU memory, the CPU renderer takes over.
        """
        try:
            return self._draw(width, height)
        except MemoryError as error:
            if self._on_cpu or self._gpu_is_full:
                raise
            self._gpu_is_full = True
            self._cpu = self._cpu or CpuTexture(self._context)
            self._cpu.compile()
            self._upload.give_up()
            self._opengl.arrays.release_everything()
            self.session.problem = f"{error}: the processor draws from now on"
            logger.warning("%s", self.session.problem)
            return self.last_textures

    def _draw(self, width: int, height: int) -> list[moderngl.Texture]:
        session = self.session
        if self._cpu is not None and self._cpu.has_failed:
            self._cpu, self._gpu_is_full = None, False
        self._on_cpu = self._cpu is not None and self._cpu.is_ready  # once a frame: it may change at any moment
        if session.view.harmonics != self._opengl.arrays.harmonics:
            self._opengl.arrays.keep_harmonics_as(session.view.harmonics)
            self._upload.give_up()
            self._staged = None  # its upload starts over
        self._is_uploading, self._upload_until = False, time.perf_counter() + _UPLOAD_S
        self._prepare_staged()
        contents = session.split_panes
        for pane in self._panes[: -len(contents)]:
            pane.state = pane.scene = None
        self._release_closed_scene()
        detail = self._choose_detail(session.shot(width, height))
        if session.screenshot is not None:
            detail = FULL_QUALITY
        scale = detail.scale / session.view.shrink
        drawn_height = max(1, round(height * scale))
        shot = session.shot(max(1, round(width * scale)), drawn_height, height / drawn_height)
        if self._can_draw:
            self._sample_sky(shot)
        # The last pane, on the right, is the document itself: statistics are those of its image.
        started, has_drawn, panes = time.perf_counter(), False, self._panes[-len(contents) :]
        for side, pane in zip(contents, panes, strict=True):
            has_drawn = self._draw_pane(side, pane, shot, detail)
        if self._cpu is not None and (has_drawn or not self._can_draw) and session.scene.gaussian_count:
            self._cpu.compile()  # after the first image, which compiling would delay
        session.is_compiling = not self._can_draw
        if has_drawn:
            self._publish_statistics(1000 * (time.perf_counter() - started), detail)
        path, session.screenshot = session.screenshot, None
        if path is not None:
            self._save_screenshot(path)
        return [pane.texture for pane in panes]

    @property
    def is_settled(self) -> bool:
        """True if the active back end is the final one."""
        return self._cpu is None or self._cpu.is_ready

    @property
    def is_catching_up(self) -> bool:
        """True if the next frames continue unfinished work although nothing moves."""
        samples = self.session.sky_is_stale and self.session.displayed_rain.can_rain and not self._sky.is_through
        return self._is_uploading or (samples and self._can_draw)

    @property
    def last_textures(self) -> list[moderngl.Texture]:
        """Last textures, one per pane."""
        return [pane.texture for pane in self._panes[-len(self.session.split_panes) :]]

    def draw_aside(self, scene: Scene, shot: RenderView, screen: Screen) -> moderngl.Texture | None:
        """Draw a small image next to the viewport after `draw`, with fewer Gaussians in playback, or None."""
        session = self.session
        if not self._can_draw or (not self._on_cpu and self._upload.missing(scene) > _CHUNK_SIZE):
            return None
        share = min(session.detail.gaussians, _ASIDE) if session.clock.playing else 1.0
        thinning = self._thinning(QualityLevel(share, 1.0))
        draw_view(self._renderer, scene, session.displayed_rain, session.sky, shot, thinning=thinning)
        return screen.show(self._picture(), session.view.background, 2.0**session.view.gain_ev)

    @property
    def _can_draw(self) -> bool:
        if self._cpu is None or self._on_cpu:
            return True
        return not (self._waits or self._gpu_is_full) and self.session.scene.gaussian_count <= _STAND_IN_GAUSSIANS

    @property
    def _waits(self) -> bool:
        """True if the CPU renderer will draw as soon as its kernels are loaded."""
        return self._cpu is not None and time.perf_counter() < self._waits_until

    @property
    def _renderer(self) -> Renderer:
        return self._cpu.renderer if self._cpu is not None and self._on_cpu else self._opengl

    def _picture(self) -> moderngl.Texture:
        """Texture of the renderer's last image."""
        return self._cpu.upload() if self._cpu is not None and self._on_cpu else self._opengl.picture

    def _release_closed_scene(self) -> None:
        """Free the resources of the previous scene, once, after it was closed."""
        is_empty = not self.session.scene.members and self.session.staged is None
        if is_empty and not self._is_empty:
            self._sky.forget()
            self._thinnings.clear()
            self._thinned = self.session.scene
            self._upload.give_up()
            self._opengl.arrays.release_everything()
        self._is_empty = is_empty

    def _choose_detail(self, now: RenderView) -> QualityLevel:
        """Quality level from the budget, which depends on camera motion."""
        before, at = self._moment, time.perf_counter()
        self._is_moving = before is not None and (
            now.camera.world_to_camera.tobytes() != before.camera.world_to_camera.tobytes()
            or now.camera.fx != before.camera.fx
        )
        resized = before is not None and now.camera.height != before.camera.height
        self._moment, real_s, self._asked_at = now, at - self._asked_at, at
        return self.session.budget.observe(moving=self._is_moving and not resized, real_s=real_s)

    def _sample_sky(self, shot: RenderView) -> None:
        """Continue to sample the sky color if it is out of date, and give drops a color that was picked."""
        session = self.session
        if session.sky_is_stale and session.displayed_rain.can_rain:
            resting = not (self._is_moving or session.clock.playing)
            whole = session.screenshot is not None
            sky = self._sky.look(self._renderer, session.scene, shot.camera, resting=resting, at_once=whole)
            if sky is not None:
                session.sky_seen = sky
            session.sky_is_stale = not self._sky.is_exact
        pick, session.sky_pick = session.sky_pick, None
        if pick is not None:
            background, wetness = session.view.background, session.rainfall.wetness_at(shot.time_s)
            color = mean_color_in_rectangle(self._renderer, session.scene, shot, pick, background, wetness)
            session.change_rain("Pick drop color", drop_color=color)

    def _draw_pane(self, side: SplitPane, pane: "_PaneImage", shot: RenderView, detail: QualityLevel) -> bool:
        """Draw a pane unless it is up to date; return whether it was drawn."""
        session, view = self.session, self.session.view
        side = side._replace(scene=self._drawable(side.scene, pane))
        state = (_fingerprint(session, side, shot), detail.gaussians, self._on_cpu)
        if state == pane.state or not self._can_draw:
            return False
        rainfall = side.rainfall if side.scene.members else None  # the rain has nothing to fall on yet
        selection, thinning = view.show_selection and session.screenshot is None, self._thinning(detail)
        draw_view(
            self._renderer, side.scene, rainfall, session.sky, shot, look=view.look, thinning=thinning,
            selection=selection,
        )  # fmt: skip
        pane.texture = pane.screen.show(self._picture(), view.background, 2.0**view.gain_ev)
        pane.state, pane.scene = state, side.scene
        return True

    def _drawable(self, scene: Scene, pane: "_PaneImage") -> Scene:
        """The scene; or the last one, while much of the new one has yet to be uploaded."""
        if self._on_cpu or not self._can_draw or pane.scene is None or self.session.screenshot is not None:
            return scene
        if self._upload.missing(scene) <= _CHUNK_SIZE or self._upload.missing(pane.scene):
            return scene
        if self._upload.go_on(scene, self._upload_until):
            return scene
        self._is_uploading = True
        return pane.scene

    def _thinning(self, detail: QualityLevel) -> LodSubset | None:
        if detail.gaussians == 1:
            return None
        if self._thinned is not self.session.scene:
            self._thinned = self.session.scene
            for thinning in self._thinnings.values():
                thinning.forget_all_but(member.gaussians for member in self._thinned.members)
        return self._thinnings.setdefault(detail.gaussians, LodSubset(detail.gaussians))

    def _publish_statistics(self, milliseconds: float, detail: QualityLevel) -> None:
        session, statistics = self.session, self._renderer.statistics
        session.budget.measured(detail, milliseconds)
        session.detail, session.backend = detail, self._renderer.name
        camera = None if self._moment is None else self._moment.camera
        session.statistics = {
            "frame ms": milliseconds,
            "megapixels": 0.0 if camera is None else 1e-6 * camera.width * camera.height,
            **{f"{stage} ms": value for stage, value in statistics.stages_ms.items()},
            "Gaussians": statistics.gaussians,
            "splats drawn": statistics.splats_drawn,
            "drops drawn": statistics.drops_drawn,
            "haze Gaussians": statistics.haze_drawn,
        }

    def _prepare_staged(self) -> None:
        """Continue to prepare a staged scene for its first frame; swap it in when done."""
        session = self.session
        if session.staged is not self._staged:
            self._upload.give_up()
            self._staged = session.staged
            self._preparing = self._preparations(self._staged.scene) if self._staged is not None else iter(())
        while self._staged is not None:
            if next(self._preparing, self) is self:
                session.swap_in()
                if session.staged is self._staged:  # a question to the user is open
                    break
                is_opened, self._staged = self._staged.is_opened, None
                if is_opened:
                    self._sky.forget()
                    self._opengl.arrays.release_all_but((each.gaussians, each.wet_sh) for each in session.scene.members)
            elif time.perf_counter() >= self._upload_until:
                break

    def _preparations(self, scene: Scene) -> Iterator[None]:
        for member in scene.members:
            for thinning in self._thinnings.values():
                thinning.growth(member.gaussians)
                yield
        too_large = self._cpu is not None and scene.gaussian_count > _STAND_IN_GAUSSIANS
        if not (self._on_cpu or self._waits or self._gpu_is_full or too_large):
            while not self._upload.go_on(scene, self._upload_until):
                yield

    def _save_screenshot(self, path: Path) -> None:
        pictures = [
            np.frombuffer(texture.read(), np.uint8).reshape(texture.height, texture.width, 4)[..., :3]
            for texture in self.last_textures
        ]
        check_context(self._context)
        pixels = pictures[-1].copy()
        if len(pictures) == 2:
            at = round(self.session.view.divider * pixels.shape[1])
            pixels[:, :at] = pictures[0][:, :at]
        try:
            write_png(path, pixels)
        except OSError as error:
            self.session.problem = f"{path}: the screenshot can't be saved: {error.strerror or error}"
            logger.error("%s", self.session.problem)
        else:
            logger.info("Saved %s", path)


class _PaneImage:
    """Texture of one pane, and the state it was drawn from."""

    def __init__(self, context: moderngl.Context) -> None:
        self.screen = Screen(context)
        self.texture = context.texture((1, 1), 4, np.zeros(4, np.uint8))
        self.state: Hashable = None
        self.scene: Scene | None = None


def _fingerprint(session: Editor, side: SplitPane, shot: RenderView) -> Hashable:
    """Everything that a pane's image depends on; scenes and rains are values and compare by identity."""
    camera, view = shot.camera, session.view
    raining = view.look == "splats" and side.rainfall.state_at(shot.time_s).intensity_mm_h > 0
    velocity = b"" if shot.velocity_m_s is None or not raining else shot.velocity_m_s.tobytes()
    return (
        side.scene.appearance,
        side.rainfall if raining else None,
        session.sky if raining else None,
        shot.time_s if raining or side.scene.actors else 0.0,
        (camera.world_to_camera.tobytes(), camera.width, camera.height, camera.fx),
        velocity,
        (view.background, view.gain_ev, view.look, view.harmonics, view.show_selection),
        side.rainfall.wetness_at(shot.time_s) if side.scene.has_wet_colors else 0.0,
    )


# Uploads of Gaussians to the GPU in slices


class SceneUpload:
    """Uploads one scene at a time; earlier scenes stay on the GPU as long as there is room."""

    def __init__(self, renderer: SplatRenderer) -> None:
        self._renderer = renderer
        self._scene: Scene | None = None
        self._slices: Iterator[float] = iter(())

    def missing(self, scene: Scene) -> int:
        """Number of Gaussians a frame would have to upload to draw a scene."""
        arrays = self._renderer.arrays
        return sum(arrays.missing(each.gaussians, each.wet_sh) for each in scene.members if each.visible)

    def go_on(self, scene: Scene, until_s: float) -> bool:
        """Upload missing slices of a scene until a time of `time.perf_counter`; return whether all are uploaded."""
        if scene is not self._scene:
            parts = [(each.gaussians, each.wet_sh) for each in scene.members if each.visible]
            self._scene = scene
            self._slices = (
                slice_
                for gaussians, wet_sh in parts
                for slice_ in self._renderer.arrays.upload(gaussians, wet_sh=wet_sh)
            )
        while next(self._slices, None) is not None:
            if time.perf_counter() >= until_s:
                return False
        self._scene = None
        return True

    def give_up(self) -> None:
        """Release the slices uploaded for a scene that will not be shown."""
        self._scene, self._slices = None, iter(())
        self._renderer.arrays.release_awaited()


# Sky color, sampled after each change of the scene, one image a frame, so that no frame stalls

_QUICK = 60_000  # number of Gaussians that a first sample draws; a second, full one follows when nothing moves


class SkyColorSampler:
    """Sky color of the last sample; the first sample finishes immediately, later ones over several frames."""

    def __init__(self) -> None:
        self._sampled: Hashable = None
        """Scene state of the last sample; None before the first."""
        self.is_exact = False
        """True if the last sample included every Gaussian of the present scene."""
        self._requested: Hashable = None
        self._renderer: Renderer | None = None
        self._progress: Generator[None, None, SkyColor] | None = None
        self._is_full = False
        """True if the sample in progress draws all Gaussians."""
        self.is_through = True
        """True if no sample is pending, except for an exact one while things move."""

    def forget(self) -> None:
        """Forget the last sample, so that the next one finishes at once, e.g. for another scene."""
        self._sampled = self._requested = self._progress = None

    def look(
        self, renderer: Renderer, scene: Scene, place: Camera, *, resting: bool, at_once: bool = False
    ) -> SkyColor | None:
        """Continue by one image, or to the end if `at_once`; return the sky color when a sample is complete."""
        state = _visible_state(scene)
        is_new, stays = state != self._sampled, state == self._requested and renderer is self._renderer
        self._requested, self._renderer = state, renderer
        self.is_exact &= not is_new
        self.is_through = not is_new and (self.is_exact or not (resting or at_once))
        if self.is_through:
            self._progress = None
            return None
        count = sum(len(each.gaussians) for each in scene.members if each.visible)
        is_full = count <= _QUICK or at_once or (resting and not is_new)
        if self._progress is None or not stays or is_full != self._is_full:
            thinning = None if is_full else LodSubset(_QUICK / count)
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
        if state and not sky.found:  # a scene that is still loading shows nothing
            logger.info("The scene shows no sky: drops take the color of an overcast one")
        self._sampled, self.is_exact, self._progress = state, self._is_full, None
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
    """Images of the rig's cameras; updates one per frame, oldest first. Lives in the window's OpenGL context."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._screens: dict[str, Screen] = {}
        self._states: dict[str, Hashable] = {}
        self._turn: list[str] = []
        """Names of the cameras, the one drawn last at the end."""

    def update(self, session: Editor, view: LiveView) -> None:
        """Draw one outdated camera if the mosaic is visible. Once a frame, after the viewport."""
        mosaic = session.drives.mosaic
        wanted, mosaic.is_requested, mosaic.is_behind = mosaic.is_requested, False, False
        scene = session.drives.rig_scene(session.scene)
        if not wanted or scene.ego is None:
            return
        cameras = {each.name: each for each in mosaic.cameras(scene)}
        self._turn = [name for name in self._turn if name in cameras]
        self._turn += [name for name in cameras if name not in self._turn]
        for each in (self._screens, self._states, mosaic.pictures):
            for name in each.keys() - cameras.keys():
                del each[name]
        stale = [name for name in self._turn if self._states.get(name) != _state(session, scene, cameras[name])]
        if not stale:
            return
        name = stale[0]
        picture = self._draw(session, view, scene, cameras[name])
        if picture is not None:
            mosaic.pictures[name] = picture
            self._states[name] = _state(session, scene, cameras[name])
        self._turn = [each for each in self._turn if each != name] + [name]
        mosaic.is_behind = len(stale) > 1 or picture is None

    def _draw(self, session: Editor, view: LiveView, scene: Scene, mounted: RigCamera) -> Texture | None:
        time_s = session.clock.time_s
        pose = scene.ego_to_world(time_s)
        if pose is None:
            return None
        before, after = scene.ego_to_world(time_s - _STEP_S), scene.ego_to_world(time_s + _STEP_S)
        velocity = None if before is None or after is None else (after[:3, 3] - before[:3, 3]) / (2 * _STEP_S)
        small = camera_of_width(mounted, session.drives.mosaic.width_px)
        shot = RenderView(placed_camera(small, pose), time_s, velocity, mounted.fx)
        screen = self._screens.setdefault(mounted.name, Screen(self._context))
        texture = view.draw_aside(scene, shot, screen)
        return None if texture is None else Texture(texture.glo, texture.width, texture.height)


_STEP_S = 0.05  # half the time over which the ego vehicle's velocity is averaged


def _state(session: Editor, scene: Scene, camera: RigCamera) -> Hashable:
    return (
        scene.appearance, session.displayed_rain, session.sky, session.clock.time_s, session.drives.mosaic.width_px,
        camera, session.clock.playing, session.view.gain_ev,
    )  # fmt: skip

"""Live view: draws panes and the camera mosaic frame by frame, uploads staged scenes, and saves screenshots."""

import logging
import time
from collections.abc import Hashable, Iterator
from typing import NamedTuple

import moderngl
import numpy as np

from ...compile_cache import has_kernels
from ...render.draw import LodSubset, RenderView, draw_view
from ...render.images import write_png
from ...render.opengl.context import check_context, is_software
from ...render.opengl.renderer import Screen, SplatRenderer
from ...render.renderer import Renderer
from ...scene.scene import RigCamera, Scene
from ...simulation.sensors import camera_of_width, placed_camera
from ..editor import Editor, WindowBackend
from ..viewport.options import FULL_QUALITY, QualityLevel, SplitPane, Texture
from ..viewport.picking import SkyColorPick, mean_color_in_rectangle
from ..viewport_state import PendingScene
from .textures import CpuTexture
from .uploads import SceneUpload, SkyColorSampler

logger = logging.getLogger("gsrain")
_STAND_IN_GAUSSIANS = 1_000_000
"""Larger scenes wait for the CPU kernels: software OpenGL would take minutes and twice the memory."""

_LOADING_S = 2.0  # time to load cached kernels, also on a busy machine; after it, kernels are assumed to need compiling
_UPLOAD_S = 0.01  # time per frame for uploading slices of a scene
_ASIDE = 1 / 4  # share of the Gaussians in small images next to the viewport, during playback
_CHUNK_SIZE = 1 << 16
"""Number of new Gaussians that a frame uploads directly; for more, the last scene stays visible during the upload."""


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
        self._sides = (_PaneImage(context), _PaneImage(context))
        self._sky = SkyColorSampler()
        self._moment: RenderView | None = None
        self._is_moving = False
        self._asked_at = 0.0
        self._staged: PendingScene | None = None
        self._preparing: Iterator[None] = iter(())
        self._upload = SceneUpload(self._opengl)
        self._is_uploading = False
        """True if a pane still shows an older scene."""
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
            self._leave_gpu(error)
            return self.last_textures

    def _draw(self, width: int, height: int) -> list[moderngl.Texture]:
        session = self.session
        if self._cpu is not None and self._cpu.has_failed:
            self._cpu, self._gpu_is_full = None, False
        self._on_cpu = self._cpu is not None and self._cpu.is_ready  # once a frame: it may change at any moment
        if session.view.harmonics != self._opengl.arrays.harmonics:
            self._opengl.arrays.keep_harmonics_as(session.view.harmonics)
            self._upload.give_up()
            self._staged = None  # its upload starts again
        self._is_uploading, self._upload_until = False, time.perf_counter() + _UPLOAD_S
        self._prepare_staged()
        sides = session.split_panes
        for shown in self._sides[: -len(sides)]:
            shown.forget()
        self._let_go_of_closed_scene()
        detail = self._choose_detail(session.shot(width, height))
        if session.screenshot is not None:
            detail = FULL_QUALITY
        shot = self._shot(width, height, detail)
        raining = session.displayed_rain.can_rain
        if session.sky_is_stale and raining and self._can_draw:
            self._look_at_sky(shot)
        if session.sky_pick is not None and self._can_draw:
            self._pick_sky(shot, session.sky_pick)
        # The last pane, on the right, is the document itself: statistics are those of its image.
        started, has_drawn = time.perf_counter(), False
        for side, shown in zip(sides, self._sides[-len(sides) :], strict=True):
            has_drawn = self._show(side, shown, shot, detail)
        if self._cpu is not None and (has_drawn or not self._can_draw) and session.scene.gaussian_count:
            self._cpu.compile()  # after the first image, which compiling would delay
        session.is_compiling = not self._can_draw
        if has_drawn:
            self._tell(1000 * (time.perf_counter() - started), detail)
        textures = [shown.texture for shown in self._sides[-len(sides) :]]
        self._save_screenshot(textures)
        return textures

    @property
    def is_settled(self) -> bool:
        """True if the active back end is the final one."""
        return self._cpu is None or self._cpu.is_ready

    @property
    def is_catching_up(self) -> bool:
        """True if the next frames continue unfinished work although nothing moves."""
        session = self.session
        looks = session.sky_is_stale and session.displayed_rain.can_rain and self._can_draw and not self._sky.is_through
        return self._is_uploading or looks

    @property
    def last_textures(self) -> list[moderngl.Texture]:
        """Last textures, one per pane."""
        return [shown.texture for shown in self._sides[-len(self.session.split_panes) :]]

    def draw_aside(self, scene: Scene, shot: RenderView, screen: Screen) -> moderngl.Texture | None:
        """Draw a small image next to the viewport, in its rain, after `draw`; None while nothing can be drawn.

        During playback it uses a quarter of the Gaussians, or fewer if the viewport uses fewer.
        """
        session = self.session
        if not self._can_draw or (not self._on_cpu and self._upload.missing(scene) > _CHUNK_SIZE):
            return None
        share = min(session.detail.gaussians, _ASIDE) if session.clock.playing else 1.0
        thinning = self._thinning(QualityLevel(share, 1.0))
        draw_view(self._renderer, scene, session.displayed_rain, session.sky, shot, thinning=thinning)
        picture = self._cpu.upload() if self._cpu is not None and self._on_cpu else self._opengl.picture
        return screen.show(picture, session.view.background, 2.0**session.view.gain_ev)

    @property
    def _can_draw(self) -> bool:
        is_final = self._cpu is None or self._on_cpu
        stands_in = not (self._waits or self._gpu_is_full)
        return is_final or (stands_in and self.session.scene.gaussian_count <= _STAND_IN_GAUSSIANS)

    @property
    def _waits(self) -> bool:
        """True if the CPU renderer will draw as soon as its kernels are loaded."""
        return self._cpu is not None and time.perf_counter() < self._waits_until

    @property
    def _renderer(self) -> Renderer:
        return self._cpu.renderer if self._cpu is not None and self._on_cpu else self._opengl

    def _let_go_of_closed_scene(self) -> None:
        """Free the resources of the previous scene, once, after it was closed."""
        session = self.session
        is_empty = not session.scene.members and session.staged is None
        if is_empty and not self._is_empty:
            self._sky.forget()
            self._thinnings.clear()
            self._thinned = session.scene
            self._upload.give_up()
            self._opengl.arrays.release_everything()
        self._is_empty = is_empty

    def _leave_gpu(self, error: MemoryError) -> None:
        """Switch to the CPU renderer and free the scene's GPU memory."""
        self._gpu_is_full = True
        self._cpu = self._cpu or CpuTexture(self._context)
        self._cpu.compile()
        self._upload.give_up()
        self._opengl.arrays.release_everything()
        self.session.problem = f"{error}: the processor draws from now on"
        logger.warning("%s", self.session.problem)

    def _choose_detail(self, now: RenderView) -> QualityLevel:
        """Quality level from the budget, which depends on camera motion."""
        session, before, at = self.session, self._moment, time.perf_counter()
        self._is_moving = before is not None and (
            now.camera.world_to_camera.tobytes() != before.camera.world_to_camera.tobytes()
            or now.camera.fx != before.camera.fx
        )
        resized = before is not None and now.camera.height != before.camera.height
        self._moment, real_s, self._asked_at = now, at - self._asked_at, at
        return session.budget.observe(moving=self._is_moving and not resized, real_s=real_s)

    def _shot(self, width: int, height: int, detail: QualityLevel) -> RenderView:
        scale = detail.scale / self.session.view.shrink
        drawn_height = max(1, round(height * scale))
        return self.session.shot(max(1, round(width * scale)), drawn_height, height / drawn_height)

    def _look_at_sky(self, shot: RenderView) -> None:
        session = self.session
        resting = not (self._is_moving or session.clock.playing)
        at_once = session.screenshot is not None
        sky = self._sky.look(self._renderer, session.scene, shot.camera, resting=resting, at_once=at_once)
        if sky is not None:
            session.sky_seen = sky
        session.sky_is_stale = not self._sky.is_exact

    def _pick_sky(self, shot: RenderView, pick: SkyColorPick) -> None:
        session = self.session
        session.sky_pick = None
        background, wetness = session.view.background, session.rainfall.wetness_at(shot.time_s)
        color = mean_color_in_rectangle(self._renderer, session.scene, shot, pick, background, wetness)
        session.change_rain("Pick drop colour", drop_color=color)

    def _show(self, side: SplitPane, shown: "_PaneImage", shot: RenderView, detail: QualityLevel) -> bool:
        """Draw a pane unless it is up to date; return whether it was drawn."""
        session = self.session
        side = side._replace(scene=self._drawable(side.scene, shown))
        state = (_fingerprint(session, side, shot), detail.gaussians, self._on_cpu)
        if state == shown.state or not self._can_draw:
            return False
        renderer, view = self._renderer, session.view
        draw_view(
            renderer,
            side.scene,
            side.rainfall if side.scene.members else None,  # the rain has nothing to fall on yet
            session.sky,
            shot,
            look=view.look,
            thinning=self._thinning(detail),
            selection=view.show_selection and session.screenshot is None,
        )
        picture = self._cpu.upload() if self._cpu is not None and self._on_cpu else self._opengl.picture
        shown.texture = shown.screen.show(picture, view.background, 2.0**view.gain_ev)
        shown.state, shown.scene = state, side.scene
        return True

    def _drawable(self, scene: Scene, shown: "_PaneImage") -> Scene:
        """The scene; or the one shown last, while much of the new one has yet to be uploaded."""
        if self._on_cpu or not self._can_draw or shown.scene is None or self.session.screenshot is not None:
            return scene
        if self._upload.missing(scene) <= _CHUNK_SIZE or self._upload.missing(shown.scene):
            return scene
        if self._upload.go_on(scene, self._upload_until):
            return scene
        self._is_uploading = True
        return shown.scene

    def _thinning(self, detail: QualityLevel) -> LodSubset | None:
        if detail.gaussians == 1:
            return None
        if self._thinned is not self.session.scene:
            self._thinned = self.session.scene
            for thinning in self._thinnings.values():
                thinning.forget_all_but(member.gaussians for member in self._thinned.members)
        return self._thinnings.setdefault(detail.gaussians, LodSubset(detail.gaussians))

    def _tell(self, milliseconds: float, detail: QualityLevel) -> None:
        session, statistics = self.session, self._renderer.statistics
        session.budget.measured(detail, milliseconds)
        session.detail = detail
        session.backend = self._renderer.name
        session.statistics = {
            "frame ms": milliseconds,
            "megapixels": self._megapixels,
            **{f"{stage} ms": value for stage, value in statistics.stages_ms.items()},
            "Gaussians": statistics.gaussians,
            "splats drawn": statistics.splats_drawn,
            "drops drawn": statistics.drops_drawn,
            "haze Gaussians": statistics.haze_drawn,
        }

    @property
    def _megapixels(self) -> float:
        return 0.0 if self._moment is None else 1e-6 * self._moment.camera.width * self._moment.camera.height

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

    def _save_screenshot(self, textures: list[moderngl.Texture]) -> None:
        path, self.session.screenshot = self.session.screenshot, None
        if path is None:
            return
        pictures = [
            np.frombuffer(texture.read(), np.uint8).reshape(texture.height, texture.width, 4)[..., :3]
            for texture in textures
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

    def forget(self) -> None:
        """Release the scene of a hidden pane."""
        self.state = self.scene = None


class _PaneInputs(NamedTuple):
    """Everything that an image depends on; scenes and rains are values and compare by identity."""

    scene: Hashable
    rainfall: Hashable
    sky: Hashable
    time_s: float
    camera: Hashable
    velocity: bytes
    view: Hashable
    wetness: float


def _fingerprint(session: Editor, side: SplitPane, shot: RenderView) -> _PaneInputs:
    camera, view = shot.camera, session.view
    raining = view.look == "splats" and side.rainfall.state_at(shot.time_s).intensity_mm_h > 0
    velocity = b"" if shot.velocity_m_s is None or not raining else shot.velocity_m_s.tobytes()
    return _PaneInputs(
        side.scene.appearance,
        side.rainfall if raining else None,
        session.sky if raining else None,
        shot.time_s if raining or side.scene.actors else 0.0,
        (camera.world_to_camera.tobytes(), camera.width, camera.height, camera.fx),
        velocity,
        (view.background, view.gain_ev, view.look, view.harmonics, view.show_selection),
        side.rainfall.wetness_at(shot.time_s) if side.scene.has_wet_colors else 0.0,
    )


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
        self._keep_only(cameras)
        mosaic.pictures = {name: each for name, each in mosaic.pictures.items() if name in cameras}
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

    def _keep_only(self, cameras: dict[str, RigCamera]) -> None:
        self._turn = [name for name in self._turn if name in cameras]
        self._turn += [name for name in cameras if name not in self._turn]
        self._screens = {name: screen for name, screen in self._screens.items() if name in cameras}
        self._states = {name: state for name, state in self._states.items() if name in cameras}

    def _draw(self, session: Editor, view: LiveView, scene: Scene, mounted: RigCamera) -> Texture | None:
        time_s = session.clock.time_s
        pose = scene.ego_to_world(time_s)
        if pose is None:
            return None
        small = camera_of_width(mounted, session.drives.mosaic.width_px)
        shot = RenderView(placed_camera(small, pose), time_s, _velocity(scene, time_s), mounted.fx)
        screen = self._screens.setdefault(mounted.name, Screen(self._context))
        texture = view.draw_aside(scene, shot, screen)
        return None if texture is None else Texture(texture.glo, texture.width, texture.height)


_STEP_S = 0.05


def _velocity(scene: Scene, time_s: float) -> np.ndarray | None:
    """Velocity of the ego vehicle in the world, m/s, over the tenth of a second around a time."""
    before, after = scene.ego_to_world(time_s - _STEP_S), scene.ego_to_world(time_s + _STEP_S)
    return None if before is None or after is None else (after[:3, 3] - before[:3, 3]) / (2 * _STEP_S)


def _state(session: Editor, scene: Scene, camera: RigCamera) -> Hashable:
    return (
        scene.appearance,
        session.displayed_rain,
        session.sky,
        session.clock.time_s,
        session.drives.mosaic.width_px,
        camera,
        session.clock.playing,
        session.view.gain_ev,
    )

"""The editor without a window: its parts, opening and closing, and the frames that a live view draws of it."""

import time
from collections.abc import Callable, Hashable
from pathlib import Path

import platformdirs

from ..compile_cache import kernel_names
from ..malloc_tuning import MemoryTrimmer
from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes, keyframes_of, rain_of
from ..rain.settings import RainSettings, load_preset
from ..scene.gaussians import IdentityKey, forget_scenes
from ..scene.scene import Scene
from .autosave import restore_view
from .background import Background
from .camera_path import CameraPathEditor
from .capture_view import CaptureController
from .clock import PlaybackClock
from .document import Document, DocumentState, rain_around
from .drawing.frame import DrawResult, MosaicInput, MosaicResult, RenderInput, SplitPane
from .drive import RolloutPlayer
from .edits.members import replace_scene
from .files import Files, LoadedDocument
from .finetune import FinetuneController
from .floaters import FloaterFinder
from .jobs.folder import new_file
from .jobs.job import JobRunner
from .lamps import LampFinder
from .live_rain import LiveRain
from .make_rainy import WetLookController
from .matching import MatchingController
from .preferences import PreferencesStore
from .rain import CalibrationTools
from .rain_tracks import RainTracks
from .recorder import RenderQueue
from .scene_edits import SceneEdits
from .scene_setup import SceneSetup
from .selection.commands import SelectionTool
from .status import StatusBus, logger
from .timeline import Playback
from .training import TrainingController
from .viewport_state import PendingScene, ViewportState
from .views import NamedViews

_SLOW_MS = 1000.0  # drawing time of a full picture from which backdrops are not drawn again and again


class Editor:
    """One open scene and the parts that edit, display, save and record it. Main thread only.

    A panel or a command takes the parts that it needs as parameters of their names.
    """

    def __init__(self, scene: Scene | None = None, rain: RainSettings | None = None) -> None:
        """Start with a scene, or with an empty one; without `rain` it is dry."""
        self.background = background = Background()
        self._freed_memory = MemoryTrimmer(background.submit)
        self._is_closed = False
        self.should_quit = False
        """True if the program is to end now: the user has quit and decided about unsaved changes."""
        self.asked: Callable[[RainSettings, RainKeyframes], tuple[RainSettings, RainKeyframes]] | None = None
        """Changes the rain and the keyframes of the next scene that is opened, as its user has asked for."""
        clock, scene = PlaybackClock(), scene or Scene("no scene")
        state = DocumentState(scene, rain or rain_around(scene, load_preset("clear")))
        self.status = StatusBus()
        self.preferences = PreferencesStore(background, self.status)
        self.document = Document(state, clock, self.status)
        self.playback = Playback(self.document, clock)
        self.viewport = ViewportState(self.document, self.playback, background)
        self.selection = SelectionTool(self.document, self.playback)
        self.camera_path = CameraPathEditor(self.document, self.viewport, self.playback, self.status)
        self.views = NamedViews(self.document, self.viewport, self.playback, self.status)
        self.rain_tracks = RainTracks(self.document, self.playback)
        self.captures = CaptureController(self.viewport, self.status, background)
        self.matching = MatchingController(self.viewport, self.captures, background)
        self.jobs = JobRunner(background, self.status.report, lambda: self.viewport.staged is None)
        self.calibration = CalibrationTools(self.document, self.jobs, self.status)
        self.files = Files(
            self.viewport, self.jobs, self.captures, self.preferences, self.status, background, self._enter
        )
        self.rollouts = RolloutPlayer(self.viewport, self.jobs, self.files, self.status, background)
        self.files.loose_results = lambda: self.rollouts.unsaved_titles
        self.live_rain = LiveRain(self.document, self.viewport, self.rollouts, background)
        self.training = TrainingController(self.viewport, self.captures, self.jobs, self.files)
        self.scene_setup = SceneSetup(self.document, self.viewport)
        self.floaters = FloaterFinder(self.document, self.jobs)
        self.lamps = LampFinder(self.document, self.jobs)
        self.scene_edits = SceneEdits(self.document, self.jobs)
        self.wet_look = WetLookController(
            self.viewport, self.live_rain, self.captures, self.jobs, self.files, self.status
        )
        self.finetune = FinetuneController(self.jobs, self.status)
        self.render_queue = RenderQueue(
            self.viewport, self.live_rain, self.jobs, self.files, self.preferences, self.status
        )
        self._reset_view()

    # Opening and closing

    def _enter(self, opened: LoadedDocument) -> None:
        """Switch to an opened document."""
        self.jobs.leave_scene()
        self.rollouts.drop_all()
        scene = opened.scene
        saved, keyframes = rain_of(scene), keyframes_of(scene) or NO_KEYFRAMES
        rain, asked, self.asked = saved or self.document.rain, self.asked, None
        if asked is not None:
            rain, keyframes = asked(rain, keyframes)
        state = DocumentState(scene, rain if saved and not asked else rain_around(scene, rain), keyframes)
        self.document.open(state)
        self.files.enter(opened, state)
        self._reset_view()
        self.scene_setup.enter(scene, is_foreign=opened.home is None and opened.recovered is None)
        forget_scenes()
        self._freed_memory.note_work()
        if scene.view is not None:
            restore_view(self.viewport, scene.view)

    def _reset_view(self) -> None:
        """Reset camera and timeline for another scene."""
        self.playback.reset()
        self.viewport.reset()
        self.selection.fit(self.viewport.navigation.distance_m)
        self.live_rain.look_for_sky()
        self.wet_look.previewed = None

    def request_quit(self) -> None:
        """End the program; asks first if jobs run or changes are unsaved."""

        def leave() -> None:
            self.files.give_up()
            self.should_quit = True

        self.files.confirm_unsaved_then("quit", leave, ends_program=True)

    def close(self) -> None:
        """Stop everything that runs; further calls do nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        self.jobs.close()
        self.files.close()
        self.render_queue.poll()
        self.preferences.close()
        self.background.close()
        self.status.close()

    # Background work

    @property
    def busy(self) -> str | None:
        """Description of the read or write in progress, or None."""
        staged = self.viewport.staged
        if self.files.busy is not None:
            return self.files.busy
        if staged is not None and staged.is_opened:
            return f"Uploading {staged.label}"
        if self.live_rain.is_searching_roofs:
            return "Finding roofs"
        if not self.viewport.is_compiling:
            return None
        return self.preparing if self.viewport.is_preparing else "Loading the renderer"

    @property
    def preparing(self) -> str:
        """Description of the preparation of the renderer, with its progress."""
        done = self.viewport.kernels
        so_far = "" if done is None else f": {done} of {len(kernel_names())} kernels"
        return f"Preparing the renderer, at the first start of a version only{so_far}"

    @property
    def is_working(self) -> bool:
        """True if background work needs frames to be processed."""
        return bool(self.jobs.pending) or self.is_bringing_in

    @property
    def is_bringing_in(self) -> bool:
        """True if something is being prepared for the viewport, which each frame continues."""
        parts = self.captures.is_working or self.matching.is_working or self.rollouts.is_working
        waits = self.viewport.staged is not None or self.files.deferred.is_waiting
        return parts or waits or self.busy is not None

    @property
    def awaits_first_picture(self) -> bool:
        """True while the first scene is opened, and until what draws it is ready.

        Time stands: pictures of what stands in for the renderer would take the processor from it.
        """
        opens_first = self.files.busy is not None and not self.document.scene.gaussian_count
        return opens_first or self.viewport.is_compiling or self.viewport.is_preparing

    def tick(self, real_s: float) -> None:
        """Advance time and process finished background work. Once a frame."""
        viewport = self.viewport
        self.playback.advance(real_s if self.has_time and not self.awaits_first_picture else 0.0)
        viewport.motion.observe(viewport.navigation, time.perf_counter())
        viewport.drawn_preview, viewport.preview = viewport.preview, None
        viewport.following.ride(self.rollouts.displayed_scene, self.playback.clock.time_s, viewport.navigation)
        for part in (
            self.background, self.files.recovery, self.render_queue, self.preferences, self.live_rain, self.captures,
            self.matching, self.rollouts, self.jobs, self.wet_look,
        ):  # fmt: skip
            part.poll()
        if viewport.staged is None and not self.rollouts.is_working:  # otherwise a result is still being swapped in
            self.files.deferred.poll()
        if self.is_working:
            self._freed_memory.note_work()
        self._freed_memory.poll()

    # Frames

    @property
    def split_panes(self) -> tuple[SplitPane, ...]:
        """Panes of the viewport: one, or two from left to right."""
        scene, history, split = self.rollouts.displayed_scene, self.document.history, self.viewport.options.split
        present = SplitPane("", scene, self.live_rain.displayed)
        if split == "clear | rainy":
            return SplitPane("clear", scene, self.live_rain.without_rain), present._replace(label="rainy")
        if split == "before | after":
            before = history.previous
            rainfall = self.live_rain.of(before.rain, before.keyframes)
            left = SplitPane(f"before: {history.undo_label or 'nothing'}", before.scene, rainfall)
            return left, present._replace(label="after")
        return (present,)

    @property
    def is_animated(self) -> bool:
        """True if the picture changes while time plays: rain, road users, or a camera that rides."""
        if self.viewport.options.follow_path or self.playback.rollout_span_s is not None:
            return True
        falls = self.viewport.options.look == "splats" and not self.viewport.is_orthographic
        return any(pane.scene.actors or (falls and pane.rainfall.can_rain) for pane in self.split_panes)

    @property
    def _content(self) -> Hashable:
        """Identity of what the picture shows, but for camera and time."""
        options = self.viewport.options
        panes = tuple((IdentityKey(each.scene), each.rainfall.rain, each.rainfall.weather) for each in self.split_panes)
        return panes, options.look, options.show_selection

    @property
    def _can_stand_still(self) -> bool:
        """True if pictures can be drawn over a backdrop of what stands still while rain falls.

        Only the processor draws over one, and only rain without lamps. Where keyframes change the rain, backdrops are
        drawn anew now and then, unless that takes long.
        """
        options, time_s = self.viewport.options, self.playback.clock.time_s
        can = self.viewport.backend == "cpu" and options.look == "splats" and not options.follow_path
        for pane in self.split_panes:
            rainfall = pane.rainfall
            can = can and not (rainfall.rain.is_paper or rainfall.lamps_of(pane.scene, time_s))
            can = can and not (rainfall.weather.keys and self._full_picture_ms > _SLOW_MS)
        return can

    @property
    def _full_picture_ms(self) -> float:
        """Drawing time of a full picture of the viewport; 0 if it is unknown."""
        of_megapixel_ms, view = self.viewport.full_ms_per_megapixel, self.viewport.picture_view
        if of_megapixel_ms is None or view is None:
            return 0.0
        return of_megapixel_ms * 1e-6 * view.camera.width * view.camera.height

    @property
    def has_time(self) -> bool:
        """True if anything happens in time: in the picture, on the ego vehicle's or the user's path, or in the rain."""
        scene, keyframes = self.document.scene, self.document.keyframes.keys
        return self.is_animated or scene.ego is not None or scene.path is not None or len(keyframes) > 1

    def render_input(self, width: int, height: int, ahead_s: float = 0.0) -> RenderInput:
        """The next frame for a viewport of a size in pixels, as it is expected to be in `ahead_s`.

        A screenshot and a picked color are those of the present.
        """
        viewport, live_rain, options = self.viewport, self.live_rain, self.viewport.options
        if viewport.screenshot is not None or viewport.sky_pick is not None:
            ahead_s = 0.0
        is_animated = self.playback.clock.playing and self.is_animated
        view, quality = viewport.scaled_shot(
            width,
            height,
            self._content,
            is_animated=is_animated,
            stands=is_animated and self._can_stand_still,
            ahead_s=ahead_s,
        )
        pick, rain = viewport.sky_pick, live_rain.simulation
        return RenderInput(
            panes=self.split_panes,
            view=view,
            canvas_view=viewport.shot(width, height, ahead_s=ahead_s),
            quality=quality,
            is_moving=viewport.is_moving,
            is_playing=self.playback.clock.playing,
            scene=self.document.scene,
            pending=viewport.staged,
            sky=live_rain.sky_color,
            samples_sky=live_rain.needs_sky,
            overcast=live_rain.overcast_now,
            picked=None if pick is None else (pick, rain.soaked_share_at(view.time_s), rain.overcast_at(view.time_s)),
            mode=options.look,
            background=options.background,
            gain_ev=options.gain_ev,
            harmonics=options.harmonics,
            selection=options.show_selection,
            divider=options.divider,
            screenshot=viewport.screenshot,
            thumbnail=viewport.thumbnail_requested,
        )

    def apply(self, result: DrawResult) -> None:
        """Take what the drawing of a frame has found; the editor may have changed since the frame began."""
        viewport, frame = self.viewport, result.frame
        assert frame is not None
        viewport.picture_view = frame.canvas_view
        viewport.is_compiling, viewport.is_catching_up = result.is_compiling, result.is_catching_up
        viewport.is_preparing, viewport.kernels = result.is_preparing, result.kernels
        viewport.budget.has_cuts = result.has_cuts
        viewport.budget.is_warped = result.can_be_warped
        for problem in result.problems:
            self.status.report(problem)
        if result.drawn is not None:
            viewport.budget.measured(result.drawn.quality, result.drawn.frame_ms)
            viewport.detail = result.drawn.quality
            size_px = frame.view.camera.width, frame.view.camera.height
            viewport.rate.note_drawing(time.perf_counter(), size_px, is_exact=viewport.detail.is_exact)
            is_first = result.drawn.backend != viewport.backend  # with the loading of its kernels or shaders
            viewport.backend, viewport.backend_reason = result.drawn.backend, result.drawn.backend_reason
            viewport.statistics = dict(result.drawn.statistics)
            if result.drawn.quality.is_exact and result.is_settled and not is_first:
                viewport.full_ms_per_megapixel = result.drawn.frame_ms / viewport.statistics["megapixels"]
        scene = self.document.scene
        is_same = frame.scene is scene or frame.scene.geometry_key == scene.geometry_key
        if result.sky is not None and is_same:
            self.live_rain.sky_color = result.sky
        if result.sky_is_exact and is_same:
            self.live_rain.sky_is_stale = False
        if result.has_screenshot and viewport.screenshot == frame.screenshot:
            viewport.screenshot = None
        if result.thumbnail is not None and viewport.thumbnail_requested:
            viewport.thumbnail_requested = False
            self.views.take_picture(result.thumbnail)
        if result.picked_color is not None and frame.picked is not None and viewport.sky_pick is frame.picked[0]:
            viewport.sky_pick = None
            self.document.change_rain("Pick drop color", drop_color=result.picked_color)
        if result.is_pending_ready and viewport.staged is not None and viewport.staged is frame.pending:
            self._swap_in(viewport.staged)

    def mosaic_input(self) -> MosaicInput | None:
        """Images of the camera rig for the next frame; None if they are not visible."""
        mosaic, time_s = self.rollouts.mosaic, self.playback.clock.time_s
        is_requested, mosaic.is_requested, mosaic.is_behind = mosaic.is_requested, False, False
        scene = self.rollouts.rig_scene(self.document.scene)
        if not is_requested or scene.ego_to_world(time_s) is None:
            return None
        return MosaicInput(
            cameras=mosaic.cameras(scene),
            width_px=mosaic.width_px,
            scene=scene,
            time_s=time_s,
            is_playing=self.playback.clock.playing,
            rainfall=self.live_rain.displayed,
            sky=self.live_rain.sky,
            background=self.viewport.options.background,
            gain_ev=self.viewport.options.gain_ev,
            quality=self.viewport.detail,
        )

    def apply_mosaic(self, result: MosaicResult) -> None:
        self.rollouts.mosaic.pictures, self.rollouts.mosaic.is_behind = result

    def take_screenshot(self, folder: Path | None = None) -> None:
        """Save the next image under the present date and time, by default in the user's pictures folder."""
        self.viewport.screenshot = new_file(folder or Path(platformdirs.user_pictures_dir()), "gsrain", ".png")

    def _swap_in(self, staged: PendingScene) -> None:
        """Display the staged scene, whose Gaussians are ready for the next frame.

        A scene that replaces the document stays staged while a question is open, unless the document is empty or closes
        as soon as jobs have ended.
        """
        has_question = self.status.question is not None and not self.files.deferred.is_waiting
        if staged.is_opened and has_question and self.document.scene.members:
            return
        self.viewport.staged = None
        if staged.is_opened:
            self._enter(self.files.arrive(staged.scene))
            logger.info("Opened %s: %s Gaussians", staged.label, f"{staged.scene.gaussian_count:,}")
            return
        continues = self.document.history.continues(staged.gesture)
        if staged.goes_on and not continues:
            return  # the user has continued with something else
        origin = staged.gesture or staged.label
        is_new = self.document.edit(
            staged.label, staged.change, staged.scene, gesture=staged.gesture, recipe=staged.recipe,
            origin=origin if staged.change is replace_scene else None,
        )  # fmt: skip
        if staged.change is replace_scene and not continues:
            self._reset_view()
        elif is_new and staged.change is not replace_scene:
            logger.info("Wet colors are ready: the intensity, or Wetness in the Rain panel, blends them in")

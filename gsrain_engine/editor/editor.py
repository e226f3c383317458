"""The editor without a window: panels read its state and call its methods, the live view draws it."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import platformdirs

from ..malloc_tuning import MemoryTrimmer
from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes, keyframes_of, rain_of
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..scene.gaussians import forget_scenes
from ..scene.progress import Progress
from ..scene.scene import Scene
from .autosave import restore_view
from .document import Document, History
from .drive import RolloutPlayer
from .edits.floaters import FloaterRules, FloaterSearch, select_floaters
from .edits.gaussians import selected_count
from .files import LoadedDocument, SceneFiles, new_screenshot
from .finetune import FinetuneController
from .jobs.job import Job, no_result
from .make_rainy import WetLookController
from .matching import MatchingController
from .notifications import Answer, LogLines, Question, do_nothing
from .rain import CalibrationTools, KeyframePanelState, ShelterMapBuilder
from .recorder import RenderQueue
from .selection.commands import SelectionOptions
from .services import EditorServices
from .viewport.options import FULL_QUALITY, AdaptiveQuality, QualityLevel, SplitPane
from .viewport.picking import SkyColorPick
from .viewport_state import insert_pending_scene

logger = logging.getLogger("gsrain")
WindowBackend = Literal["auto", "opengl", "cpu"]
FLOATERS_TITLE = "Find floaters"


class Editor(EditorServices):
    """One open scene and all its services. Main thread only."""

    def __init__(self, scene: Scene | None = None, rain: RainSettings | None = None) -> None:
        """Start with a scene, or with an empty one."""
        super().__init__(scene or Scene("no scene"), rain, ThreadPoolExecutor(1, thread_name_prefix="files"))
        self.log = LogLines()
        logger.setLevel(logging.INFO)
        logger.addHandler(self.log)
        self.budget = AdaptiveQuality()
        self.is_compiling = False
        """True if the viewport can't be drawn before kernels are compiled or loaded."""
        self.backend = ""
        self.detail: QualityLevel = FULL_QUALITY
        """Quality of the present viewport image."""
        self.screenshot: Path | None = None
        """Path at which the live view saves its next image."""
        self.sky_pick: SkyColorPick | None = None
        """Region of the next image whose color is to become the drop color."""
        self.shower = KeyframePanelState()
        self.floater_count: int | None = None
        """Result of the last search for floaters; None if it has not finished."""
        self.lab = CalibrationTools()
        self.selecting = SelectionOptions()
        self.matching = MatchingController()
        self._is_closed = False
        self.is_leaving = False
        """True if the program is to end now: the user has quit and decided about unsaved changes."""
        self._roofs = ShelterMapBuilder(self._files)
        self._freed_memory = MemoryTrimmer(self._files)
        self._other_rainfall = self.rainfall
        self.files = SceneFiles(self, self.enter, self._files)
        self.recorder = RenderQueue(self, self.files)
        self.drives = RolloutPlayer(self.files, self.chase, self._files)
        self.files.loose_results = lambda: [each.title for each in self.drives.opened if each.path is None]
        self.rainy, self.studio = WetLookController(self.files), FinetuneController()
        self.enter_scene()

    # Files

    def open(self, path: str) -> None:
        """Read a scene in the background and switch to it; a later call supersedes an earlier one.

        Asks first if there are unsaved changes. Errors are logged and set as `problem`, and the present scene stays.
        """
        self.files.open(path)

    @property
    def has_changes(self) -> bool:
        return self.files.has_changes

    def enter(self, opened: LoadedDocument) -> None:
        """Switch to an opened document."""
        self.jobs.leave_scene()
        self.drives.close_all(self)
        scene = opened.scene
        rain, weather = rain_of(scene) or self.rain, keyframes_of(scene) or NO_KEYFRAMES
        self.history = History(Document(scene, rain, weather))
        self.files.enter(opened, self.history.present)
        self._follow_document()
        self.enter_scene()
        forget_scenes()
        self._freed_memory.note_work()
        if scene.view is not None:
            restore_view(self, scene.view)

    def enter_scene(self) -> None:
        """Reset the view and the timeline for another scene."""
        super().enter_scene()
        self.rainy.previewed = None

    def request_quit(self) -> None:
        """End the program; asks first if jobs run or changes are unsaved."""

        def leave() -> None:
            self.files.give_up()
            self.is_leaving = True

        self.files.confirm_unsaved_then("quit", leave, ends_program=True)

    # Background work

    @property
    def busy(self) -> str | None:
        """Description of the read or write in progress, or None."""
        if self.files.busy is not None:
            return self.files.busy
        if self.staged is not None and self.staged.is_opened:
            return f"Uploading {self.staged.label}"
        if self.rain.roofs and not self._roofs.knows(self.scene):
            return "Finding roofs"
        return "Preparing the picture; once after an update this takes up to a minute" if self.is_compiling else None

    @property
    def pending_files(self) -> list[Future[Any]]:
        """Reading, writing and finding roofs in progress, to wait for where there are no frames."""
        return [*self.files.pending, *self._roofs.pending]

    @property
    def is_working(self) -> bool:
        """True if background work needs frames to be processed."""
        return bool(self.jobs.running) or self.is_bringing_in

    @property
    def is_bringing_in(self) -> bool:
        """True if something is being prepared for the viewport, which each frame continues."""
        is_any = self.captures.is_working or self.matching.is_working or self.drives.is_working
        is_any = is_any or self.staged is not None or self._awaited is not None
        return is_any or self.busy is not None or self.lab.busy is not None

    @property
    def is_opening(self) -> bool:
        """True if another scene is about to replace this one."""
        return self.files.is_opening or super().is_opening

    def find_floaters(self, rules: FloaterRules) -> Job[Any]:
        """Start to search for floaters in a thread, and select those found as one undo step."""
        search, self.floater_count = FloaterSearch(self.scene, rules), None

        def take(_: None, __: bool) -> str:
            marked = select_floaters(self.scene, search.found)
            count = self.floater_count = selected_count(marked)
            if not count:
                return "No Gaussian looks like a floater"
            self.set_scene(FLOATERS_TITLE, marked)
            verb = "looks like a floater and is" if count == 1 else "look like floaters and are"
            return f"{count:,} Gaussian{'s'[: count != 1]} {verb} selected"

        progress = Progress(0.0, "Looking for floaters")
        return self.jobs.start(
            Job("floaters", FLOATERS_TITLE, search.run, no_result, in_thread=True, progress=progress), take
        )

    def swap_in(self) -> None:
        """Show the staged scene, whose Gaussians are ready for the next frame.

        A scene that replaces the document stays staged while a question is open, unless the document is empty or closes
        as soon as jobs have ended.
        """
        staged = self.staged
        is_asked = bool(self.scene.members) and self.questions.present is not None and self._awaited is None
        if staged is None or (staged.is_opened and is_asked):
            return
        self.staged = None
        if staged.is_opened:
            self.enter(self.files.arrive(staged.scene))
            logger.info("Opened %s: %s Gaussians", staged.label, f"{staged.scene.gaussian_count:,}")
        else:
            insert_pending_scene(self, staged)

    def update(self, real_s: float) -> None:
        """Advance time and process finished background work. Once a frame."""
        self.clock.advance(real_s, self.span_s)
        self._shown_preview, self.preview = self.preview, None
        self.following.ride(self.displayed_scene, self.clock.time_s, self.navigation)
        self.files.poll()
        self._preferences.poll()
        if self.rain.roofs:
            self._roofs.look_at(self.scene)
        self.lab.poll()
        self.captures.poll()
        if self.captures.refused is not None:
            self._ask_about_outside(*self.captures.refused)
            self.captures.refused = None
        self.matching.poll(self)
        self.drives.poll(self)
        self.jobs.poll()
        self.rainy.poll(self)
        if self.staged is None and not self.drives.is_working:  # otherwise a result is still being swapped in
            self._go_on_when_idle()
        if self.is_working:
            self._freed_memory.note_work()
        self._freed_memory.poll()

    # Viewport

    @property
    def displayed_scene(self) -> Scene:
        """Scene of the viewport, including a drag preview and the road users of the playing roll-out."""
        return self.drives.scene_in_place_of(super().displayed_scene)

    @property
    def displayed_rain(self) -> RainSimulation:
        """Rain of the viewport: the document's, or that of the playing roll-out.

        It is without roofs until they are found, because finding them takes seconds.
        """
        knows_roofs = self._roofs.knows(self.scene)
        if (driven := self.drives.rainfall(roofs=knows_roofs)) is not None:
            return driven
        if not self.rain.roofs or (knows_roofs and self._shown_preview is None):
            return self.rainfall
        return replace(self.rainfall, rain=msgspec.structs.replace(self.rain, roofs=False))

    @property
    def split_panes(self) -> list[SplitPane]:
        """Panes of the viewport: one, or two from left to right."""
        shown, rainfall = self.displayed_scene, self.displayed_rain
        here = SplitPane("", shown, rainfall)
        if self.view.split == "clear | rainy":
            clear = rainfall.rain.without_rain
            return [SplitPane("clear", shown, self._rainfall_of(clear, NO_KEYFRAMES)), here._replace(label="rainy")]
        if self.view.split == "before | after":
            before = self.history.previous
            rainfall = self._rainfall_of(before.rain, before.weather)
            left = SplitPane(f"before: {self.history.undo_label or 'nothing'}", before.scene, rainfall)
            return [left, here._replace(label="after")]
        return [here]

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of playback: as set by the user, else those of the camera path or the traffic."""
        return self.clock.span_s or self.drives.span_s() or super().span_s

    def take_screenshot(self, folder: Path | None = None) -> None:
        """Save the next image under the present date and time, by default in the user's pictures folder."""
        self.screenshot = new_screenshot(folder or Path(platformdirs.user_pictures_dir()))

    def close(self) -> None:
        """Stop everything that runs; further calls do nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        self.jobs.close()
        self.files.close()
        self._preferences.close()
        self._files.shutdown()
        self.lab.close()
        self.captures.close()
        self.matching.close()
        logger.removeHandler(self.log)

    def _rainfall_of(self, rain: RainSettings, weather: RainKeyframes) -> RainSimulation:
        if rain == self.rain and weather is self.weather:
            return self.rainfall
        if rain != self._other_rainfall.rain or weather is not self._other_rainfall.weather:
            self._other_rainfall = RainSimulation.start(rain, weather=weather)
        return self._other_rainfall

    def _ask_about_outside(self, path: Path, why: str) -> None:
        """Ask before files outside of a capture's folder are read."""
        text = f"{why.partition('; --allow')[0]}. Read files outside of its folder?"
        yes = Answer("Read them", lambda: self.captures.open(path, allow_outside=True), "Open it with those files.")
        self.questions.ask(Question("Files outside of the capture", text, (yes, Answer("Cancel", do_nothing))))

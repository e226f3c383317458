"""A session in the window: live view, panels and menus. Importing this loads the engine."""

import logging
import time
from functools import partial

import moderngl
from imgui_bundle import hello_imgui, imgui

from gsrain_engine.editor.drawing.live_view import LiveView, MosaicImages
from gsrain_engine.editor.drawing.textures import CachedTexture, CaptureTextures, JobPreviews
from gsrain_engine.editor.editor import Editor, WindowBackend
from gsrain_engine.editor.timeline import FrameClock
from gsrain_engine.render.opengl.context import DeviceLostError

from .dialogs import CommandPalette, about_page, draw_questions, keyboard_page
from .panels.registry import all_panels
from .shell import act_on_keys, draw_menus, status_bar
from .viewport.panel import viewport_panel
from .widgets.fields import answer_dialogs

logger = logging.getLogger("gsrain")
_SPACES = {
    "left": "LeftSpace", "left bottom": "LeftBottomSpace", "right": "RightSpace", "right bottom": "RightBottomSpace",
    "bottom": "BottomSpace",
}  # fmt: skip
_FOR_THREADS_S = 0.001  # sleep per frame while threads work: without it they rarely get the interpreter
_IDLE_FPS = 0.3  # A frame costs 80 ms in software rendering; events wake up the window immediately
_WATCHING_FPS = 10.0  # frame rate for progress bars while workers run without user input
_WAITING_FPS = 30.0  # maximum frame rate while a job runs or a bar is animated: the work needs the CPU more


class Workspace:
    """Window content after loading."""

    def __init__(self, session: Editor, context: moderngl.Context, backend: WindowBackend) -> None:
        self.session = session
        self.view = LiveView(context, session, backend)
        self._previews = JobPreviews(context)
        self._rainy = CachedTexture(context)
        self._captures = CaptureTextures(context)
        self._mosaic = MosaicImages(context)
        self._palette = CommandPalette()
        self._pace = FrameClock()
        self._capture = session.captures.capture
        self._last_problem = ""

    def dockable_windows(self) -> list[hello_imgui.DockableWindow]:
        windows, panels = list[hello_imgui.DockableWindow](), all_panels()
        for panel in panels:
            window = hello_imgui.DockableWindow(
                panel.window_name, _SPACES[panel.side], partial(panel.draw, self.session)
            )
            is_first_there = panel.side not in [each.side for each in panels[: panels.index(panel)]]
            window.focus_window_at_next_frame = is_first_there
            window.can_be_closed = False  # a close button on each tab takes too much width; View > Panels hides them
            windows.append(window)
        return windows

    @property
    def title(self) -> str:
        """Title of the window: the scene, with a star if it has unsaved changes."""
        return f"GSRAIN: {self.session.scene.name}{' *' if self.session.has_changes else ''}"

    def update(self) -> None:
        """Advance time. Call it once per frame, before drawing."""
        session = self.session
        session.update(self._pace.step(imgui.get_io().delta_time))
        if session.is_working:
            time.sleep(_FOR_THREADS_S)
        self._previews.update(session)
        previewed = session.rainy.previewed
        session.rainy.texture = self._rainy.show(None if previewed is None else previewed.pixels)
        self._captures.update(session)
        idling = hello_imgui.get_runner_params().fps_idling
        # Poll workers at intervals: frames would take CPU time from them.
        idling.fps_idle = _WATCHING_FPS if session.jobs.running else _IDLE_FPS
        resting = not (session.clock.playing or session.is_bringing_in or session.budget.is_settling)
        resting = resting and not session.drives.mosaic.is_behind
        idling.enable_idling = resting and self.view.is_settled and not self.view.is_catching_up
        is_alone = self.view.is_settled and session.busy is None and not session.jobs.running
        idling.fps_max = 0.0 if is_alone else _WAITING_FPS
        if session.is_leaving:
            hello_imgui.get_runner_params().app_shall_exit = True

    def draw_menus(self) -> None:
        draw_menus(self.session)

    def draw_status(self) -> None:
        status_bar(self.session)

    def draw_viewport(self) -> None:
        if not self.session.view.dialog and self.session.questions.present is None:
            act_on_keys(self.session)
        answer_dialogs(self.session)
        capture = self.session.captures.capture
        if capture is not self._capture:
            self._capture = capture
            if capture is not None:  # the view shows nothing of a capture without poses
                imgui.set_window_focus("Capture")
        viewport_panel(self.session, self._textures)
        self._palette.draw(self.session)
        keyboard_page(self.session)
        about_page(self.session)
        draw_questions(self.session)

    def _textures(self, width: int, height: int) -> list[int]:
        try:
            textures = self.view.draw(width, height)
            self._captures.draw_points(self.session, self.session.shot(width, height).camera)
            self._mosaic.update(self.session, self.view)
        except DeviceLostError:  # the window closes before its next frame
            textures = self.view.last_textures
        except Exception as problem:  # any error of a driver or a scene: report it once, keep image and window
            if str(problem) != self._last_problem:
                self._last_problem = str(problem)
                self.session.problem = str(problem)
                logger.error("%s", problem, exc_info=not isinstance(problem, MemoryError))
            textures = self.view.last_textures
        return [texture.glo for texture in textures]

"""A session in the window: live view, panels and menus. Importing this loads the engine."""

import logging
import threading
import time

import moderngl
from imgui_bundle import hello_imgui, imgui

from gsrain_engine.editor.drawing.live_view import LiveView, MosaicImages
from gsrain_engine.editor.drawing.textures import CachedTexture, CaptureTextures, JobPreviews
from gsrain_engine.editor.editor import Editor, WindowBackend
from gsrain_engine.editor.jobs.job import remove_abandoned_job_folders
from gsrain_engine.editor.timeline import FrameClock
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.opengl.context import DeviceLostError

from .dialogs import CommandPalette, about_page, draw_questions, keyboard_page
from .panels.registry import all_panels
from .restart import restart_state
from .shell import act_on_keys, draw_menus, status_bar
from .style import apply_style
from .viewport.panel import viewport_panel
from .widgets.fields import answer_dialogs

logger = logging.getLogger("gsrain")
_RESTARTED = "The graphics driver has restarted, and so has this window; jobs have ended."
_WITH_CHANGES = " What was changed is here, still to be saved; it can't be undone any more."

_SPACES = {
    "left": "LeftSpace",
    "left bottom": "LeftBottomSpace",
    "right": "RightSpace",
    "right bottom": "RightBottomSpace",
    "bottom": "BottomSpace",
}

_FOR_THREADS_S = 0.001  # sleep per frame while threads work: without it they rarely get the interpreter
_IDLE_FPS = 0.3  # A frame costs 80 ms in software rendering; events wake up the window immediately
_WATCHING_FPS = 10.0  # frame rate for progress bars while workers run without user input
_WAITING_FPS = 30.0  # frame rate for an animated bar: the awaited work needs the CPU more


def begin_session(scene: str | None, rain: RainSettings | None, wet: bool = False) -> Editor:
    """Begin a session that opens a scene (None is the built-in street) in the background, and makes it rainy if `wet`.

    After a lost graphics context it continues with the state of the previous window.
    """
    session, left = Editor(rain=rain), restart_state()
    if left is not None and left.kept is not None:
        session.files.go_on_at(left.kept)
    else:
        session.open((left and left.scene) or scene or "street")
        if wet:
            session.rainy.make_soon()
    if left is not None:
        session.problem = _RESTARTED + (_WITH_CHANGES if left.kept is not None else "")
    session.files.offer_recovery()
    threading.Thread(target=remove_abandoned_job_folders, name="tidy up", daemon=True).start()
    return session


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
        self._style = session.preferences

    def dockable_windows(self) -> list[hello_imgui.DockableWindow]:
        windows: list[hello_imgui.DockableWindow] = []
        panels = all_panels()
        for panel in panels:
            window = hello_imgui.DockableWindow(
                panel.window_name, _SPACES[panel.side], lambda panel=panel: panel.draw(self.session)
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
        if self.session.preferences != self._style:
            self._style = self.session.preferences
            apply_style(self._style)
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
        idling.fps_idle = _WATCHING_FPS if session.running_jobs else _IDLE_FPS
        resting = not (session.clock.playing or session.is_bringing_in or session.budget.is_settling)
        resting = resting and not session.drives.mosaic.is_behind
        idling.enable_idling = resting and self.view.is_settled and not self.view.is_catching_up
        idling.fps_max = 0.0 if self.view.is_settled and session.busy is None else _WAITING_FPS
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
        self._show_new_capture()
        viewport_panel(self.session, self._textures)
        self._palette.draw(self.session)
        keyboard_page(self.session)
        about_page(self.session)
        draw_questions(self.session)

    def _show_new_capture(self) -> None:
        """Bring the Capture panel to the front after opening one: the view shows nothing of a capture without poses."""
        present = self.session.captures.capture
        if present is not self._capture:
            self._capture = present
            if present is not None:
                imgui.set_window_focus("Capture")

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

"""The window: hello_imgui owns it; this wires the session, the live view and the panels together."""

import logging

# imgui_bundle brings its own GLFW library and has to come before the glfw package.
from imgui_bundle import hello_imgui, imgui, immapp

import glfw  # isort: skip
import moderngl
from imgui_bundle import glfw_utils

from gsrain_engine.rain.rain import Rain
from gsrain_engine.render.context import REQUIRED_VERSION
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.live_view import LiveView
from gsrain_engine.session.session import Session
from ui.menus import Menus
from ui.panels import PANELS
from ui.shortcuts import chord, handle_shortcuts
from ui.status_bar import status_bar
from ui.style import apply_style
from ui.viewport_panel import viewport_panel

logger = logging.getLogger("gsrain")

VIEWPORT = "View"
_SIZE = (1440, 900)
_LONGEST_STEP_S = 0.25
"""After a stall time goes on by no more than this, so that nothing leaps."""


def run_window(scene: Scene, rain: Rain | None = None) -> None:
    """Open the window on a scene and return when it is closed."""
    window = Window(Session(scene, rain))
    immapp.run(window.parameters(), immapp.AddOnsParams(with_implot=False))


class Window:
    """A session in a window."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._menus = Menus(session)
        self.view: LiveView | None = None
        self._last_problem = ""

    def parameters(self) -> hello_imgui.RunnerParams:
        """What hello_imgui needs to run the window."""
        parameters = hello_imgui.RunnerParams()
        parameters.app_window_params.window_title = f"GSRAIN: {self.session.scene.name}"
        parameters.app_window_params.window_geometry.size = _SIZE
        parameters.imgui_window_params.default_imgui_window_type = (
            hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        )
        parameters.imgui_window_params.show_menu_bar = True
        parameters.imgui_window_params.show_status_bar = True
        parameters.imgui_window_params.show_status_fps = False
        parameters.ini_folder_type = hello_imgui.IniFolderType.app_user_config_folder
        parameters.ini_filename = "gsrain/window.ini"
        parameters.docking_params.docking_splits = _splits()
        parameters.docking_params.dockable_windows = self._dockable_windows()
        callbacks = parameters.callbacks
        callbacks.post_init = self._start
        callbacks.setup_imgui_style = apply_style
        callbacks.pre_new_frame = self._update
        callbacks.show_menus = self._menus.draw
        callbacks.show_status = lambda: status_bar(self.session)
        callbacks.before_exit = self.session.close
        parameters.fps_idling.enable_idling = False
        return parameters

    def _start(self) -> None:
        """Share the window's OpenGL context and take in dropped files."""
        self.view = LiveView(moderngl.create_context(require=REQUIRED_VERSION), self.session)
        glfw.set_drop_callback(glfw_utils.glfw_window_hello_imgui(), lambda _, paths: self.drop(paths))

    def drop(self, paths: list[str]) -> None:
        """Open a file or folder that was dropped on the window; of several, the first."""
        if paths:
            self.session.open(paths[0])

    def _update(self) -> None:
        """Let time go by. Once a frame, before anything is drawn."""
        session = self.session
        session.update(min(imgui.get_io().delta_time, _LONGEST_STEP_S))
        idling = hello_imgui.get_runner_params().fps_idling
        idling.enable_idling = not (session.clock.playing or session.is_working)
        hello_imgui.get_runner_params().app_window_params.window_title = f"GSRAIN: {session.scene.name}"

    def _dockable_windows(self) -> list[hello_imgui.DockableWindow]:
        windows = [_dockable(VIEWPORT, "MainDockSpace", self._draw_viewport)]
        spaces = {"right": "RightSpace", "right bottom": "RightBottomSpace"}
        for panel in PANELS:
            windows.append(_dockable(panel.title, spaces[panel.side], lambda panel=panel: panel.draw(self.session)))
        return windows

    def _draw_viewport(self) -> None:
        handle_shortcuts(self.session)
        if imgui.is_key_chord_pressed(chord(imgui.Key.mod_ctrl, imgui.Key.o)):
            self._menus.ask_what_to_open()
        if imgui.is_key_chord_pressed(chord(imgui.Key.mod_ctrl, imgui.Key.s)):
            self._menus.ask_where_to_save()
        self._menus.answer()
        viewport_panel(self.session, self._texture)

    def _texture(self, width: int, height: int) -> int:
        assert self.view is not None
        try:
            return self.view.draw(width, height).glo
        except MemoryError as problem:  # a scene too large for the driver: say so once, and keep the last picture
            if str(problem) != self._last_problem:
                self._last_problem = str(problem)
                logger.error("%s", problem)
            return self.view.last_texture


def _dockable(title: str, space: str, draw: object) -> hello_imgui.DockableWindow:
    window = hello_imgui.DockableWindow(title, space, draw)
    window.can_be_closed = title != VIEWPORT
    return window


def _splits() -> list[hello_imgui.DockingSplit]:
    right = hello_imgui.DockingSplit("MainDockSpace", "RightSpace", imgui.Dir.right, 0.28)
    below = hello_imgui.DockingSplit("RightSpace", "RightBottomSpace", imgui.Dir.down, 0.45)
    return [right, below]

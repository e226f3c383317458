"""The window, run by hello_imgui: it opens immediately and loads the program in the background."""

import logging
import signal
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

# imgui_bundle brings its own GLFW library and has to be imported before the glfw package.
from imgui_bundle import ImVec2, hello_imgui, imgui, immapp, implot

import glfw  # isort: skip
import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from importlib.resources import files
from typing import Any, NamedTuple, NoReturn

import moderngl
import msgspec
import numpy as np
import psutil
from imgui_bundle import glfw_utils
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.editor.preferences import Preferences, WindowPlace, config_folder, load_preferences, state_folder
from gsrain_engine.malloc_tuning import use_one_arena
from gsrain_engine.render.opengl.context import (
    WINDOW_VERSION,
    DeviceLostError,
    NoOpenGLError,
    check_can_draw_scenes,
    check_context,
    context_monitor,
    monitor_context,
    open_newest,
    version_name,
)
from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.safe_io.text_files import escape_invisible
from gsrain_engine.simulation.rollout_io import ROLLOUT_SUFFIXES

from .dock_shares import DockShares
from .input_queue import InputQueue
from .widgets.popups import install_tooltips
from .widgets.text import escape_all_text
from .widgets.type_ahead import install_type_ahead
from .window_place import fitted, monitors, open_at, place_of

if TYPE_CHECKING:
    from gsrain_engine.editor.drawing.live_view import WindowBackend
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.rain.settings import RainSettings

    from .workspace import Workspace

logger = logging.getLogger("gsrain")
# Sent to programs when the machine shuts down or the user logs out
_ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
_PLACE_EVERY_S = 0.5  # the place of the window is noted so often: a maximized one does not tell where it was before
_DRIVER_RESTARTS_S = 5.0  # maximum time for a driver to recover before a window that lost its context restarts


def begin_editor(
    scene: str | None,
    preset: "RainSettings | None",
    intensity_mm_h: float | None = None,
    wet: bool | None = None,
    *,
    follow_path: bool = False,
) -> "Editor":
    """Create an editor that opens a scene (None is the built-in street) in the background.

    A preset takes the place of the rain that the scene was saved with, and an intensity that of either. `wet` makes wet
    colors if the scene has none; False shows it as lit in any rain. `follow_path` looks through the camera that moves
    along the scene's path.

    After a lost graphics context it continues with the state of the previous window. Loads the engine.
    """
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.editor.jobs.folder import remove_abandoned_job_folders
    from gsrain_engine.rain.keyframes import NO_KEYFRAMES, RainKeyframes
    from gsrain_engine.rain.wetness import with_wet_choice

    def asked(rain: "RainSettings", keyframes: RainKeyframes) -> "tuple[RainSettings, RainKeyframes]":
        if preset is not None:
            rain, keyframes = preset, NO_KEYFRAMES
        if intensity_mm_h is not None:
            rain = msgspec.structs.replace(rain, intensity_mm_h=intensity_mm_h)
            keyframes = keyframes.without("intensity_mm_h")
        if wet is False:
            rain, keyframes = with_wet_choice(rain, wet), keyframes.without("wetness")
        return rain, keyframes

    editor, restarts = Editor(rain=preset), _TIMES in os.environ
    autosave, left = os.environ.pop(_AUTOSAVE, ""), os.environ.pop(_SCENE, "")
    if restarts and autosave:
        editor.files.go_on_at(Path(autosave))
    else:
        editor.asked = asked
        editor.files.open((restarts and left) or scene or "street")
        editor.viewport.options.follow_path = follow_path
        if wet:
            editor.wet_look.make_soon()
    if restarts:
        editor.status.report(_RESTARTED + (_WITH_CHANGES if autosave else ""))
    editor.files.recovery.look()
    threading.Thread(target=remove_abandoned_job_folders, name="tidy up", daemon=True).start()
    return editor


def run_window(
    begin: "Callable[[], Editor]",
    backend: "WindowBackend" = "auto",
    on_frame: "Callable[[Workspace], None] | None" = None,
    *,
    restarts: bool = True,
) -> None:
    """Open the window and return when it is closed; `begin` creates the editor, in a separate thread.

    A window that loses its graphics context keeps unsaved changes and, with `restarts`, restarts in a new process.
    `on_frame` is called once per frame, as soon as the editor exists.
    Raises `OSError` if the display can't be opened, its driver fails, or the window can't restart.
    """
    began = time.monotonic()
    window = MainWindow(begin, backend, on_frame)
    for ending in _ENDINGS:
        signal.signal(ending, lambda number, _: window.end(number))
    parameters = window.parameters()
    with own_layout() as layout:
        parameters.ini_disable = layout is None
        parameters.ini_folder_type = hello_imgui.IniFolderType.absolute_path
        parameters.ini_filename = str(layout or "")
        try:
            immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
        except Exception as failure:  # raised in a frame
            window.fail(failure)
        finally:
            window.close()  # workers end, whatever has ended the window
    if window.failure is None:
        return
    if window.left.autosave is not None:
        logger.error("What was changed is kept for the next window.")
    if restarts and isinstance(window.failure, DeviceLostError):
        restart_program(window.left, time.monotonic() - began)
    raise window.failure


class MainWindow:
    """Empty window that becomes a workspace."""

    def __init__(
        self,
        begin: "Callable[[], Editor]",
        backend: "WindowBackend" = "auto",
        on_frame: "Callable[[Workspace], None] | None" = None,
    ) -> None:
        use_one_arena()
        self._begin = begin
        self._on_frame = on_frame
        self._backend: WindowBackend = backend
        self._context: moderngl.Context | None = None
        self._pictures: SharedContext | None = None
        self._editor: Editor | None = None
        self._loader = threading.Thread(target=self._load, name="load the program", daemon=True)
        self.workspace: Workspace | None = None
        self._title = ""
        self._ended_by: int | None = None
        self._style: Preferences | None = None
        self._content_scale = 1.0
        self._input: InputQueue | None = None
        self._docks = DockShares()
        self._place: WindowPlace | None = None
        self._place_noted_s = 0.0
        self.failure: Exception | None = None
        """Error that prevented the program from loading or continuing, and closes the window."""

    def parameters(self) -> hello_imgui.RunnerParams:
        escape_all_text()
        install_tooltips()
        install_type_ahead()
        parameters = hello_imgui.RunnerParams()
        parameters.app_window_params.window_title = "GSRAIN"
        parameters.app_window_params.window_geometry.size = (1440, 900)
        if (stored := load_preferences()[0].window) is not None:
            self._place = fitted(stored, monitors())
            open_at(self._place, parameters)
        content = parameters.imgui_window_params
        content.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        content.show_menu_bar = content.show_status_bar = True
        content.show_menu_app = content.show_menu_view = content.show_status_fps = False
        # The dock space would fill itself with the color that the window is cleared to (`apply_style`).
        parameters.docking_params.main_dock_space_node_flags &= ~imgui.DockNodeFlags_.passthru_central_node
        parameters.docking_params.docking_splits = [
            hello_imgui.DockingSplit("MainDockSpace", "RightSpace", imgui.Dir.right, 0.29),
            hello_imgui.DockingSplit("RightSpace", "RightBottomSpace", imgui.Dir.down, 0.3),
            hello_imgui.DockingSplit("MainDockSpace", "BottomSpace", imgui.Dir.down, 0.24),
            hello_imgui.DockingSplit("MainDockSpace", "LeftSpace", imgui.Dir.left, 0.275),
            hello_imgui.DockingSplit("LeftSpace", "LeftBottomSpace", imgui.Dir.down, 0.5),
        ]
        viewport = hello_imgui.DockableWindow("View", "MainDockSpace", self._guarded(self._draw_viewport))
        viewport.can_be_closed = viewport.include_in_view_menu = False
        # Overlays never make the viewport scroll; a scroll bar that comes and goes would change its size.
        viewport.imgui_window_flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
        leave_out_background(viewport)
        parameters.docking_params.dockable_windows = [viewport]
        callbacks = parameters.callbacks
        callbacks.post_init = self._start
        callbacks.setup_imgui_style = lambda: apply_style(load_preferences()[0])
        callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
        callbacks.pre_new_frame = self._guarded(self._update)
        callbacks.show_menus = self._guarded(lambda: self.workspace.draw_menus() if self.workspace else None)
        callbacks.show_status = self._guarded(lambda: self.workspace.draw_status() if self.workspace else None)
        callbacks.post_new_frame = self._continue_frame
        callbacks.after_swap = self._guarded(self._rest)
        callbacks.before_exit = self._end
        parameters.renderer_backend_options.open_gl_options = _context_options(window_version())
        parameters.fps_idling.enable_idling = False
        parameters.fps_idling.fps_idle = 0.3  # 80 ms a frame in software rendering; events wake it up
        parameters.fps_idling.fps_max = 30.0
        return parameters

    def drop(self, paths: list[str]) -> None:
        """Open the roll-outs dropped on the window; else the first file or folder, or the folder of the first image."""
        if not paths or self.workspace is None:
            return
        from gsrain_engine.datasets.io.images import is_image  # not before the window is there

        first = Path(paths[0])
        rollouts = [Path(each) for each in paths if Path(each).suffix.lower() in ROLLOUT_SUFFIXES]
        for path in rollouts:
            self.workspace.editor.rollouts.open(path)
        if not rollouts:
            self.workspace.editor.files.open(str(first.parent if is_image(first) else first))

    def ask_to_close(self) -> None:
        """Let the editor decide about closing, since there may be unsaved changes."""
        if self.workspace is not None:
            glfw.set_window_should_close(glfw_utils.glfw_window_hello_imgui(), False)
            self.workspace.editor.files.recovery.keep()  # a desktop that logs out doesn't wait for an answer
            self.workspace.editor.request_quit()

    def end(self, by: int) -> None:
        """Close before the next frame without asking, after a signal; unsaved changes are stored for recovery."""
        self._ended_by = by

    def fail(self, failure: Exception) -> None:
        """Close the window because of an error, and store unsaved changes immediately."""
        driver_failed = isinstance(failure, moderngl.Error)
        self.failure = OSError(f"the graphics driver has failed: {failure}") if driver_failed else failure
        if self._editor is not None:
            self._editor.files.recovery.keep()

    @property
    def left(self) -> "RestartState":
        files = self._editor.files if self._editor is not None else None
        return RestartState(files.recovery.autosaved_path, files.source) if files is not None else RestartState()

    def close(self) -> None:
        """Stop all background work. Further calls do nothing."""
        if self._loader.is_alive():
            self._loader.join()
        if self.workspace is not None:
            self.workspace.close()
        if self._editor is not None:
            self._editor.close()

    def _start(self) -> None:
        """Set the icon, create the contexts of OpenGL and plots, accept dropped files, start loading."""
        window = glfw_utils.glfw_window_hello_imgui()
        set_window_icon(window)
        self._content_scale = _content_scale()
        implot.create_context()
        self._context = _present_context()
        if self._backend.startswith("opengl"):
            try:
                check_can_draw_scenes(self._context)
            except NoOpenGLError as failure:
                self.failure = failure  # hello_imgui ends cleanly in a frame
                return
        self._pictures = SharedContext(window)
        glfw.set_drop_callback(window, lambda _, paths: self.drop(paths))
        glfw.set_window_close_callback(window, lambda _: self.ask_to_close())
        self._input = InputQueue(window)
        if self._place is not None and self._place.is_maximized:
            glfw.maximize_window(window)
        self._loader.start()

    def _load(self) -> None:
        try:
            from . import workspace  # noqa: F401  loads the engine, which takes a while

            self._editor = self._begin()
        except Exception as failure:  # any error ends the program with a message, instead of silently ending the thread
            self.failure = failure

    def _update(self) -> None:
        assert self._context is not None
        try:
            check_context(self._context)
            if self._ended_by is not None:
                raise InterruptedError(f"the window was ended from outside ({signal.Signals(self._ended_by).name})")
            self.advance(self._context)
        except Exception as failure:  # a lost context takes precedence over other errors
            watcher = context_monitor(self._context)
            self.fail(DeviceLostError() if watcher is not None and watcher.is_lost() else failure)
            if watcher is not None:
                watcher.wait_for_driver(_DRIVER_RESTARTS_S)
        if self.failure is not None:
            if self.workspace is not None:
                self.workspace.close()
            self.workspace = None
            hello_imgui.get_runner_params().app_shall_exit = True
        if self._input is not None and self._input.begin_frame():
            hello_imgui.get_runner_params().fps_idling.enable_idling = False

    def _continue_frame(self) -> None:
        self._docks.update()
        if time.monotonic() - self._place_noted_s > _PLACE_EVERY_S:
            self._remember_place()
        if self._input is not None:
            self._input.continue_frame()

    def _remember_place(self) -> None:
        self._place = place_of(glfw_utils.glfw_window_hello_imgui(), self._place)
        self._place_noted_s = time.monotonic()

    def _rest(self) -> None:
        if self.workspace is not None:
            self.workspace.rest()
        if self._input is not None and self._input.end_frame():
            hello_imgui.get_runner_params().fps_idling.enable_idling = False

    def advance(self, context: moderngl.Context) -> None:
        if self.workspace is not None:
            preferences, scale = self.workspace.editor.preferences.value, _content_scale()
            if scale != self._content_scale:  # the window has come to a monitor with another scale
                imgui.get_style().font_scale_dpi *= scale / self._content_scale
                self._content_scale, self._style = scale, None
            if preferences != self._style:
                self._style = preferences
                apply_style(preferences, imgui.get_style().font_scale_dpi)
            self.workspace.update()
            if self._on_frame is not None:
                self._on_frame(self.workspace)
            if self.workspace.title != self._title:
                self._title = self.workspace.title
                glfw.set_window_title(glfw_utils.glfw_window_hello_imgui(), escape_invisible(self._title))
        elif self._editor is not None and not self._loader.is_alive():
            from .workspace import Workspace

            assert self._pictures is not None
            self.workspace = Workspace(self._editor, context, self._pictures, self._backend)
            self._style = self._editor.preferences.value
            for panel in self.workspace.dockable_windows():
                panel.gui_function = self._guarded(panel.gui_function)
                leave_out_background(panel)
                hello_imgui.add_dockable_window(panel)

    def _guarded(self, draw: Callable[[], None]) -> Callable[[], None]:
        """Return a callback that, before an error ends the window and its contexts, ends the drawing in them."""

        def guarded() -> None:
            try:
                draw()
            except BaseException:
                if self.workspace is not None:
                    self.workspace.close()
                raise

        return guarded

    def _draw_viewport(self) -> None:
        if self.workspace is not None:
            self.workspace.draw_viewport()
            return
        imgui.set_cursor_pos(ImVec2(20, 40))
        imgui.text("Starting GSRAIN")
        imgui.set_cursor_pos_x(20)
        imgui.progress_bar(-imgui.get_time(), ImVec2(280, 0), "loading")

    def _end(self) -> None:
        self._remember_place()
        if self._editor is not None and self._place != self._editor.preferences.value.window:
            self._editor.preferences.set(window=self._place)
        if self.workspace is not None:
            self.workspace.folded.unfold()  # layouts are saved with all docks
        self.close()
        if self._pictures is not None:
            self._pictures.release()
        implot.destroy_context()


def _content_scale() -> float:
    """Scale of the monitor that the window is on, such as 2.0, as far as the system does not enlarge the window."""
    window: Any = glfw_utils.glfw_window_hello_imgui()
    sizes = glfw.get_framebuffer_size(window)[0], glfw.get_window_size(window)[0]
    return interface_scale(glfw.get_window_content_scale(window)[0], *sizes)


def interface_scale(monitor_scale: float, framebuffer_px: int, window_px: int) -> float:
    """Return the scale of text and widgets: where a window has several pixels per unit, as on macOS, they have, too."""
    pixel_ratio = framebuffer_px / window_px if framebuffer_px and window_px else 1.0
    return round(monitor_scale / pixel_ratio, 2) or 1.0


def leave_out_background(window: hello_imgui.DockableWindow) -> None:
    """Let a window leave out its background while it is docked: the same color is behind it.

    A software rasterizer needs half of its time for backgrounds.
    """
    name, draw, flags = window.label, window.gui_function, window.imgui_window_flags

    def draw_window() -> None:
        windows = hello_imgui.get_runner_params().docking_params.dockable_windows
        if (own := next((each for each in windows if each.label == name), None)) is not None:  # not in its first frame
            own.imgui_window_flags = flags | imgui.WindowFlags_.no_background if imgui.is_window_docked() else flags
        draw()

    window.gui_function = draw_window


# OpenGL contexts of the interface and of the pictures


_SHARED_ATTRIBUTES = (
    glfw.CONTEXT_CREATION_API, glfw.CONTEXT_ROBUSTNESS, glfw.CONTEXT_VERSION_MAJOR, glfw.CONTEXT_VERSION_MINOR,
    glfw.OPENGL_PROFILE, glfw.OPENGL_FORWARD_COMPAT,
)  # fmt: skip


def window_version() -> int:
    """Return the newest OpenGL that a window here can have, such as 450, and let the next window report lost contexts.

    Raises `OSError` if the display can't be opened, or its driver has none of `VERSIONS`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)  # of refused versions
        if not glfw.init():
            raise OSError("the display can't be opened (DISPLAY or WAYLAND_DISPLAY names one that is not there)")
        # Hints are for all windows that are created after them. Drivers without support ignore this one.
        glfw.window_hint(glfw.CONTEXT_ROBUSTNESS, glfw.LOSE_CONTEXT_ON_RESET)
        version = open_newest(_actual_version)
        glfw.window_hint(glfw.VISIBLE, True)
    return version


def _context_options(version: int) -> hello_imgui.OpenGlOptions:
    return hello_imgui.OpenGlOptions(
        major_version=version // 100,
        minor_version=version // 10 % 10,
        glsl_version=str(WINDOW_VERSION),
        use_core_profile=True,
        use_forward_compat=True,  # macOS has no others
        anti_aliasing_samples=0,  # ImGui antialiases its own edges: it would only slow down software rendering
    )


def _actual_version(version: int) -> int:
    """Return the version that an invisible window gets if it asks for one; raises `OSError` if it gets none."""
    for hint, value in (
        (glfw.VISIBLE, False),
        (glfw.CONTEXT_VERSION_MAJOR, version // 100),
        (glfw.CONTEXT_VERSION_MINOR, version // 10 % 10),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE),
        (glfw.OPENGL_FORWARD_COMPAT, True),
    ):
        glfw.window_hint(hint, value)
    window: Any = glfw.create_window(16, 16, "GSRAIN", None, None)
    if not window:
        raise OSError(f"the graphics driver has no {version_name(version)}, which the window needs")
    major, minor = (
        glfw.get_window_attrib(window, each) for each in (glfw.CONTEXT_VERSION_MAJOR, glfw.CONTEXT_VERSION_MINOR)
    )
    glfw.destroy_window(window)
    return 100 * major + 10 * minor


def _present_context() -> moderngl.Context:
    """Return the context that is current on this thread, with a monitor of its loss."""
    context = moderngl.create_context(context=_Loader(), require=WINDOW_VERSION)  # pyright: ignore[reportArgumentType]
    monitor_context(context, glfw.get_proc_address)
    return context


class _Loader:
    """Context loader for moderngl of GLFW's current context, of whichever kind it is: EGL, GLX or WGL."""

    def load_opengl_function(self, name: str) -> int:
        return glfw.get_proc_address(name) or 0

    def __enter__(self) -> None:
        """Do nothing: the context stays current on its thread."""

    def __exit__(self, *_: object) -> None:
        """Do nothing."""

    def release(self) -> None:
        """Do nothing: the context ends with its window."""


class SharedContext:
    """OpenGL context of an invisible window, which shares textures with the visible one. Created on the main thread."""

    def __init__(self, window: Any) -> None:
        """Raises `OSError` if the driver opens no second context."""
        glfw.window_hint(glfw.VISIBLE, False)
        for hint in _SHARED_ATTRIBUTES:
            glfw.window_hint(hint, glfw.get_window_attrib(window, hint))
        self._window: Any = glfw.create_window(16, 16, "GSRAIN", None, window)
        glfw.default_window_hints()
        if not self._window:
            raise OSError("the graphics driver opens no second OpenGL context, which the viewport needs")
        self._finish: Callable[[], None] = lambda: None

    def enter(self) -> moderngl.Context:
        """Make it current on the calling thread."""
        glfw.make_context_current(self._window)
        context = _present_context()
        # Called through ctypes, unlike moderngl's, it lets other threads run.
        self._finish = ctypes.CFUNCTYPE(None)(glfw.get_proc_address("glFinish"))
        return context

    def finish(self) -> None:
        """Wait until everything is drawn; other Python threads go on meanwhile."""
        self._finish()

    def leave(self) -> None:
        """Release it from the calling thread."""
        glfw.make_context_current(None)

    def release(self) -> None:
        """Destroy it, on the main thread, after the thread that used it has left it."""
        glfw.destroy_window(self._window)


# Window icon

SIZES_PX = (16, 24, 32, 48, 64, 256)
_OF_WINDOWS_PX = 64  # larger ones are for menus, and would slow down the start


def set_window_icon(window: Any) -> None:
    """Set the window's icon. Wayland windows have none of their own: the desktop entry names it there."""
    if glfw.get_platform() in (glfw.PLATFORM_X11, glfw.PLATFORM_WIN32):
        icons = [(size, size, read_icon(size).tolist()) for size in SIZES_PX if size <= _OF_WINDOWS_PX]
        glfw.set_window_icon(window, len(icons), icons)  # lists: for Pillow's images glfw calls a deprecated function


def read_icon(size_px: int) -> UInt8[np.ndarray, "h w 4"]:
    """Return the icon in one of `SIZES_PX`, as straight RGBA."""
    with (files("app") / "icons" / f"{size_px}.png").open("rb") as file:
        return np.asarray(Image.open(file).convert("RGBA"))


# Window layout


@contextmanager
def own_layout() -> Generator[Path | None]:
    """Yield a layout file for the open window; afterwards it becomes the default of the next window.

    Each window writes its own copy, so that several windows never write to the same file. Yields None if the disk
    accepts no file; only the layout is lost then.
    """
    shared, folder = config_folder() / "window.ini", state_folder() / "layouts"
    own = folder / f"{os.getpid()}.ini"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        own.touch()  # the window itself would fail over a folder that can't be created
        own.unlink()
    except OSError:
        yield None
        return
    with suppress(OSError):
        for file in folder.glob("*.ini"):
            if file.stem.isdigit() and not psutil.pid_exists(int(file.stem)):
                file.unlink(missing_ok=True)
        shutil.copyfile(shared, own)
    yield own
    with suppress(OSError):
        shared.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(shared) as partial:
            shutil.copyfile(own, partial)
        own.unlink(missing_ok=True)


# Restart after a lost graphics context, with recovered changes

_RESTARTED = "The graphics driver has restarted, and so has this window; jobs have ended."
_WITH_CHANGES = " What was changed is here, still to be saved; it can't be undone any more."
_AUTOSAVE, _SCENE, _TIMES = "GSRAIN_KEPT", "GSRAIN_SCENE", "GSRAIN_RESTARTS"
_MAX_IN_A_ROW = 3
_A_WHILE_S = 300.0  # uptime after which a window's driver counts as working


class RestartState(NamedTuple):
    """State left by the previous window."""

    autosave: Path | None = None
    """Path of its unsaved changes."""
    scene: str | None = None
    """Scene that was open."""


def restart_program(left: RestartState, lived_s: float) -> NoReturn:
    """Replace this process after `lived_s` seconds; raises `OSError` after several restarts in a row."""
    times = 1 + (int(os.environ.get(_TIMES, "0")) if lived_s < _A_WHILE_S else 0)
    if times > _MAX_IN_A_ROW:
        raise OSError(f"the graphics card was lost {times} times in a row: its driver does not come back")
    os.environ |= {_TIMES: str(times), _AUTOSAVE: str(left.autosave or ""), _SCENE: left.scene or ""}
    command = [sys.executable, *sys.orig_argv[1:]]
    logger.error("The graphics card was lost; the window begins again.")
    sys.stderr.flush()
    if os.name == "nt":  # on Windows, execv would return control to the parent, which waits for this process
        sys.exit(subprocess.call(command))
    os.execv(command[0], command)


# Style: dark and light theme

_THEMES = {"dark": hello_imgui.ImGuiTheme_.darcula_darker, "light": hello_imgui.ImGuiTheme_.light_rounded}
_DEFAULT_STYLE = imgui.Style()
_STYLE_SIZES = tuple(
    name
    for name in dir(_DEFAULT_STYLE)
    if not name.startswith(("_", "font")) and isinstance(getattr(_DEFAULT_STYLE, name), float | ImVec2)
)
_FAINT_GRAYS = {"dark": 0.62, "light": 0.34}  # of faint words, which the themes would make too faint to be read
_DARKER = 0.85
_MIN_TAB_PX = 30.0  # tabs shrink to this width in a narrow window before they scroll


def apply_style(preferences: Preferences, scale: float = 1.0) -> None:
    """Set colors and sizes; `scale` is that of the screen, by which hello_imgui multiplies sizes only at the start."""
    style = imgui.get_style()
    for name in _STYLE_SIZES:  # themes leave most of them, and what is scaled already would be scaled once more
        setattr(style, name, getattr(_DEFAULT_STYLE, name))
    for_screen = style.font_scale_dpi
    hello_imgui.apply_theme(_THEMES[preferences.theme])
    style.frame_rounding = style.grab_rounding = 3.0
    style.frame_border_size = 1.0  # the light theme has none: unchecked boxes would be white on white
    style.window_rounding = 0.0
    style.popup_rounding = 4.0
    style.window_menu_button_position = imgui.Dir.none
    style.tab_min_width_shrink = _MIN_TAB_PX
    style.docking_node_has_close_button = False
    style.item_spacing = ImVec2(8, 5)
    style.frame_padding = ImVec2(6, 4)
    style.item_inner_spacing = ImVec2(4, 4)
    style.scale_all_sizes(preferences.ui_scale * scale)
    style.font_scale_main = preferences.font_scale
    style.font_scale_dpi = for_screen
    if preferences.theme == "dark":  # white on the theme's own could hardly be read
        for part in (imgui.Col_.frame_bg_hovered, imgui.Col_.header_hovered):
            color = style.color_(part)
            style.set_color_(part, (*(_DARKER * each for each in (color.x, color.y, color.z)), color.w))
    gray = _FAINT_GRAYS[preferences.theme]
    style.set_color_(imgui.Col_.text_disabled, (gray, gray, gray, 1.0))
    style.set_color_(imgui.Col_.modal_window_dim_bg, (0.0, 0.0, 0.0, 0.45))  # the dark theme would brighten it
    hello_imgui.get_runner_params().imgui_window_params.background_color = style.color_(imgui.Col_.window_bg)
    color = style.color_(imgui.Col_.popup_bg)
    style.set_color_(imgui.Col_.popup_bg, (color.x, color.y, color.z, 0.98))

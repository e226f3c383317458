"""An editor in the window: live view, panels and menus. Importing this loads the engine."""

import time
from collections.abc import Callable

import moderngl
from imgui_bundle import hello_imgui, imgui

from gsrain_engine.editor.clock import FrameClock
from gsrain_engine.editor.drawing.live_view import WindowBackend
from gsrain_engine.editor.drawing.picture_thread import PictureContext, PictureThread
from gsrain_engine.editor.drawing.textures import CachedTexture, CaptureTextures, JobPreviews, ViewPictures
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.guide import VIEW_PAGE
from gsrain_engine.editor.jobs.make_rainy import PREVIEW_PICTURES
from gsrain_engine.render.opengl.context import DeviceLostError, is_software
from gsrain_engine.render.opengl.warp import PictureWarp, can_warp

from .dialogs import CommandPalette, about_page, draw_questions, keyboard_page, news_page, save_view_page, series_page
from .folding import FoldedPanels, panel_windows, show_panel
from .guide import draw_guide, draw_guide_mark
from .panels.registry import Panel, all_panels
from .parts import bind_parts
from .shell import act_on_keys, draw_menus, status_bar
from .tools import TOOLS
from .viewport.panel import viewport_panel
from .widgets.file_dialogs import draw_file_dialogs, is_file_dialog_open

_SPACES = {
    "left": "LeftSpace", "left bottom": "LeftBottomSpace", "right": "RightSpace", "right bottom": "RightBottomSpace",
    "bottom": "BottomSpace",
}  # fmt: skip
_FOR_THREADS_S = 0.001  # sleep per frame while threads work: without it they rarely get the interpreter
_IDLE_FPS = 0.3  # A frame costs 80 ms in software rendering; events wake up the window immediately
_WAITING_FPS = 3.0  # while what the first picture needs is read and compiled, which needs the processor
_WATCHING_FPS = 10.0  # frame rate for progress bars while workers run without user input
_SOFTWARE_FPS = 36.0  # maximum frame rate of a software rasterizer: picture and jobs need the cores, too
_WARPED_FPS = 18.0  # the same while pictures are warped
_MAX_FRAME_S = 0.1  # a longer frame is a stall
_ACTIVE_S, _ACTIVE_FRAMES = 3.0, 6  # after an event, before a window at rest sleeps
_ACTIVE_WHILE_REFINING_S = 0.3  # the same while the processor draws the picture of a view at rest


class Workspace:
    """Window content after loading."""

    def __init__(
        self, editor: Editor, context: moderngl.Context, pictures: PictureContext, backend: WindowBackend
    ) -> None:
        """`context` is that of the window; the viewport is drawn in that of `pictures`."""
        self.editor, self.context = editor, context
        self.pictures = PictureThread(pictures, backend, hello_imgui.request_refresh)
        self._is_software = is_software(context)
        self.max_fps = _SOFTWARE_FPS if self._is_software else 0.0
        """Maximum frame rate of the interface; 0 is that of the display."""
        self.tools = tuple(bind_parts(each, editor)() for each in TOOLS)
        self._previews = JobPreviews(context)
        self._wet_preview = {name: CachedTexture(context) for name in PREVIEW_PICTURES}
        self._captures = CaptureTextures(context)
        self._view_pictures = ViewPictures(context)
        self._frame_preview = CachedTexture(context)
        self._palette = CommandPalette()
        self.folded = FoldedPanels()
        self._pace = FrameClock()
        self._capture = editor.captures.capture
        self._warps = PictureWarp(context), PictureWarp(context)
        self._last_problem = ""
        self._began_s = self._took_s = self._frame_s = 0.0
        self._own_fps = 0.0
        """Frame rate that `rest` keeps; 0 where hello_imgui keeps one."""
        self._view_size = 16, 16
        self._drawn, self._front = set[str](), ("",)
        self._first_front, self._settled_front = set[str](), tuple[str, ...]()

    def dockable_windows(self) -> list[hello_imgui.DockableWindow]:
        windows, panels = list[hello_imgui.DockableWindow](), all_panels()
        before = self.editor.preferences.value
        for panel in panels:
            draw = self._noting_visible(panel, bind_parts(panel.draw, self.editor))
            window = hello_imgui.DockableWindow(panel.title, _SPACES[panel.side], draw)
            is_first_there = panel.side not in [each.side for each in panels[: panels.index(panel)]]
            window.focus_window_at_next_frame = panel.title in before.front_panels or (
                is_first_there and not before.front_panels
            )
            if window.focus_window_at_next_frame:
                self._first_front.add(panel.title)
            window.is_visible = panel.title not in before.hidden_panels
            window.can_be_closed = False  # a close button on each tab takes too much width; View > Panels hides them
            windows.append(window)
        return windows

    def _noting_visible(self, panel: Panel, draw: Callable[[], object]) -> Callable[[], None]:
        """Return a panel's drawing that notes that the panel is in front, or has the focus, and wraps its text."""

        def draw_and_note() -> None:
            self._drawn.add(panel.title)
            if imgui.is_window_focused(imgui.FocusedFlags_.root_and_child_windows):
                self.editor.viewport.options.guide_of_focus = panel.page
            draw_guide_mark(self.editor.viewport, panel.title, panel.page)
            imgui.push_text_wrap_pos(0.0)  # no words are cut at the panel's edge
            draw()
            imgui.pop_text_wrap_pos()

        return draw_and_note

    def _remember_panels(self) -> None:
        """Put the panels that are in front, and those that are hidden, into the preferences when they change."""
        front, self._drawn = tuple(sorted(self._drawn)), set()
        is_stable, self._front = front == self._front, front
        self._settled_front = front if is_stable else self._settled_front
        gone = [each for each in panel_windows() if not each.is_visible and each.label not in self.folded.hidden]
        hidden = tuple(sorted(each.label for each in gone))
        preferences = self.editor.preferences
        before = preferences.value.front_panels, preferences.value.hidden_panels
        if is_stable and front and (front, hidden) != before:
            preferences.set(front_panels=front, hidden_panels=hidden)

    @property
    def title(self) -> str:
        """Title of the window: the scene, with a star if it has unsaved changes."""
        return f"GSRAIN: {self.editor.files.title}{' *' if self.editor.files.has_changes else ''}"

    def update(self) -> None:
        """Advance time. Call it once per frame, before drawing."""
        editor, viewport, wet_look = self.editor, self.editor.viewport, self.editor.wet_look
        now = time.perf_counter()
        self._frame_s, self._began_s = min(now - self._began_s, _MAX_FRAME_S), now
        front = self._settled_front or self._first_front
        self.folded.update({each.title for each in all_panels() if each.title in front})
        self._take_picture()
        self._remember_panels()
        editor.tick(self._pace.step(imgui.get_io().delta_time))
        if editor.is_working:
            time.sleep(_FOR_THREADS_S)
        viewport.job_previews = self._previews.update(editor.jobs.running)
        pictures = {} if wet_look.previewed is None else wet_look.previewed.images.pictures
        shown = {name: each.show(pictures.get(name)) for name, each in self._wet_preview.items()}
        wet_look.textures = {name: texture for name, texture in shown.items() if texture is not None}
        editor.render_queue.preview_texture = self._frame_preview.show(editor.render_queue.preview)
        self._captures.update(editor.captures, editor.matching)
        editor.views.textures = self._view_pictures.update(editor.views.views)
        idling = hello_imgui.get_runner_params().fps_idling
        # Poll workers at intervals: frames would take CPU time from them.
        awaits = editor.awaits_first_picture
        waits = awaits and viewport.staged is None and not viewport.is_catching_up
        plays = editor.playback.clock.playing and editor.has_time and not awaits
        resting = not (editor.is_bringing_in or viewport.budget.is_settling or plays)
        resting = resting and not (editor.rollouts.mosaic.is_behind or is_file_dialog_open())
        by_processor = viewport.budget.is_warped
        refines = resting and by_processor and not (viewport.is_moving or self.pictures.is_current)
        watches = bool(editor.jobs.running) or refines
        idling.fps_idle = _WATCHING_FPS if watches else _WAITING_FPS if waits else _IDLE_FPS
        active_s = _ACTIVE_WHILE_REFINING_S if refines else _ACTIVE_S
        idling.time_active_after_last_event = max(active_s, _ACTIVE_FRAMES * self._took_s)
        idling.enable_idling = waits or refines or (resting and self.pictures.is_current)
        warps = by_processor and (plays or viewport.is_moving)
        fps = min(self.max_fps, _WARPED_FPS) if warps else self.max_fps
        self._own_fps, idling.fps_max = (fps, 0.0) if plays or warps else (0.0, fps)
        if editor.should_quit:
            hello_imgui.get_runner_params().app_shall_exit = True

    def rest(self) -> None:
        """Wait after a frame until the next is due while things move, and begin a picture as soon as the last is done.

        At other times hello_imgui waits, which would let the thread of the pictures wait for the next frame, too.
        """
        self._took_s = time.perf_counter() - self._began_s
        if not self._own_fps:
            return
        due_s = self._began_s + 1 / self._own_fps
        if self.pictures.wait(max(due_s - time.perf_counter(), 0.0)):
            self._take_picture()
            self._begin_picture()
        time.sleep(max(due_s - time.perf_counter(), 0.0))

    def draw_menus(self) -> None:
        draw_menus(self.editor)

    def draw_status(self) -> None:
        status_bar(self.editor)

    def draw_viewport(self) -> None:
        editor = self.editor
        if imgui.is_window_focused(imgui.FocusedFlags_.root_and_child_windows):
            editor.viewport.options.guide_of_focus = VIEW_PAGE
        if not editor.viewport.options.dialog and editor.status.question is None and not is_file_dialog_open():
            act_on_keys(editor)
        draw_file_dialogs(editor.status, editor.files.recent, use_desktop=editor.preferences.value.desktop_dialogs)
        capture = editor.captures.capture
        if capture is not self._capture:
            self._capture = capture
            if capture is not None:  # the view shows nothing of a capture without poses
                show_panel("Capture")
        width, height = viewport_panel(editor, self.tools, self.pictures.last, self._warped(), self.folded)
        self._captures.draw_points(
            editor.captures, editor.document.scene, editor.viewport.canvas_view(width, height).camera
        )
        self._view_size = width, height
        if not self.pictures.is_drawing:
            self._begin_picture()
        else:
            viewport = editor.viewport
            self.pictures.reconsider(viewport.shot(width, height), editor.split_panes, viewport.options.look)
        self._palette.draw(editor)
        keyboard_page(editor.viewport)
        about_page(editor.viewport)
        news_page(editor.viewport)
        save_view_page(editor.viewport, editor.views)
        series_page(editor)
        draw_guide(editor.viewport)
        draw_questions(editor.viewport, editor.files, editor.status)

    def _warped(self) -> list[moderngl.Texture]:
        """Textures of the last picture, warped to when this frame is on the screen if something has moved since."""
        last, viewport = self.pictures.last, self.editor.viewport
        textures, view = list(last.textures), viewport.shot(*self._view_size, ahead_s=self._frame_s)
        before = viewport.picture_view
        for side, relief in enumerate(last.reliefs):
            if relief is not None and can_warp(relief, view.camera, view.time_s):
                textures[side] = self._warps[side].show(textures[side], relief, view.camera, view.time_s)
                viewport.picture_view = view
        if viewport.picture_view is not before:
            viewport.rate.note_displayed(time.perf_counter())
        return textures

    def close(self) -> None:
        """Wait for the picture that is being drawn, and stop its thread. Further calls do nothing."""
        self.pictures.close()

    def _begin_picture(self) -> None:
        frame = self.editor.render_input(*self._view_size, self.pictures.ahead_s)
        self.pictures.begin(frame, self.editor.mosaic_input())

    def _take_picture(self) -> None:
        try:
            picture = self.pictures.take()
        except DeviceLostError:  # the window closes before its next frame
            return
        except Exception as problem:  # any error of a driver or a scene: report it once, keep image and window
            if str(problem) != self._last_problem:
                self._last_problem = str(problem)
                self.editor.status.report(problem)
            return
        if picture is not None:
            self.editor.apply(picture.result)
            if picture.mosaic is not None:
                self.editor.apply_mosaic(picture.mosaic)

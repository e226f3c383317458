"""The viewport's pictures, drawn on a thread of their own, so that the interface never waits for one."""

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import NamedTuple, Protocol, runtime_checkable

import moderngl
import numpy as np

from ...choices import RenderMode
from ...render.view import RenderView
from ...threads import lower_thread_priority
from .frame import DrawResult, MosaicInput, MosaicResult, RenderInput, SplitPane
from .live_view import LiveView, MosaicImages, WindowBackend

_SHORT_S, _LONG_S = 0.04, 0.4
"""Drawing times up to which a camera is not seen to move on, and beyond which nobody knows where it will be."""


@runtime_checkable
class PictureContext(Protocol):
    """OpenGL context that shares its textures with that of the window."""

    def enter(self) -> moderngl.Context:
        """Make the context current on the calling thread."""
        ...

    def finish(self) -> None:
        """Wait until everything is drawn; other Python threads go on meanwhile."""
        ...

    def leave(self) -> None:
        """Release the context from the calling thread."""
        ...


class PictureAbandonedError(Exception):
    """Raised in the drawing of a picture that no longer matters."""


class Picture(NamedTuple):
    """Images of the viewport, and those of the camera rig if they were requested."""

    result: DrawResult
    mosaic: MosaicResult | None


class PictureThread:
    """Draws one picture at a time: once a frame, `take` a finished one, and `begin` the next from the present state.

    The editor's values are immutable, so the frames that the interface draws meanwhile change nothing in the picture.
    Each image has two textures, which take turns: those of the last picture stay as they are while the next is drawn.
    """

    def __init__(
        self, context: PictureContext, backend: WindowBackend, on_drawn: Callable[[], object] = lambda: None
    ) -> None:
        """`on_drawn` is called on any thread whenever `take` has something new: a window at rest sleeps otherwise."""
        self._context, self._on_drawn = context, on_drawn
        self._backend: WindowBackend = backend
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pictures", initializer=lower_thread_priority)
        self._opening: Future[tuple[LiveView, MosaicImages]] = self._thread.submit(self._open)
        self._drawing: Future[Picture | None] | None = None
        self._frame: RenderInput | None = None
        self._is_abandoned = threading.Event()
        self._last = DrawResult()
        self._began_s = self._took_s = 0.0
        self._may_abandon = True
        self._is_closed = False

    @property
    def is_drawing(self) -> bool:
        return self._drawing is not None

    @property
    def is_settled(self) -> bool:
        """True if no other back end takes over from that of the last picture."""
        return self._last.is_settled

    @property
    def is_current(self) -> bool:
        """True if nothing is being drawn, and nothing had changed when the last picture was begun."""
        is_busy = self._drawing is not None and not self._drawing.done()
        return not (is_busy or self._last.drawn or self._last.is_catching_up) and self.is_settled

    @property
    def ahead_s(self) -> float:
        """Time after which a picture that is begun now will have been shown for half of its time.

        It is 0 where pictures take little time, or can't be warped when the camera does not go on as expected.
        """
        takes_long = self._took_s > _SHORT_S and self._last.can_be_warped
        return 1.5 * min(self._took_s, _LONG_S) if takes_long else 0.0

    @property
    def last(self) -> DrawResult:
        """Result of the last picture that was taken."""
        return self._last

    def take(self) -> Picture | None:
        """Return the picture that was finished since the last call, if any. Raises what its drawing has raised."""
        if self._drawing is None or not self._drawing.done():
            return None
        drawn, self._drawing = self._drawing, None
        picture = drawn.result()
        if picture is None:
            return None
        self._last, self._may_abandon = picture.result, True
        if picture.result.drawn is not None:
            self._took_s = time.perf_counter() - self._began_s
        return picture

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until `take` has an answer, or for a time; return whether it has one."""
        if self._drawing is not None:
            wait([self._drawing], timeout_s)
        return self._drawing is not None and self._drawing.done()

    def begin(self, frame: RenderInput, mosaic: MosaicInput | None) -> None:
        """Begin to draw a picture, after the last one was taken."""
        assert self._drawing is None, "one picture at a time"
        self._frame, self._began_s = frame, time.perf_counter()
        self._is_abandoned.clear()
        self._drawing = self._thread.submit(self._draw, frame, mosaic)
        self._drawing.add_done_callback(self._announce)

    def reconsider(self, view: RenderView, panes: Sequence[SplitPane], mode: RenderMode) -> None:
        """Give up the picture that is being drawn if the present one has another view, scene, rain or mode.

        Only one of full quality or with a backdrop is, which takes long, and never two in a row: pictures go on.
        """
        frame = self._frame
        if frame is None or not (self._may_abandon and frame.screenshot is None):
            return
        if not (frame.quality.is_exact or frame.quality.has_backdrop):
            return
        poses = frame.canvas_view.camera.world_to_camera, view.camera.world_to_camera
        contents = [[(id(each.scene), id(each.rainfall)) for each in some] for some in (frame.panes, panes)]
        if not (np.array_equal(*poses) and contents[0] == contents[1] and frame.mode == mode):
            self._may_abandon = False
            self._is_abandoned.set()

    def close(self) -> None:
        """Wait for the picture that is being drawn, and end the thread. Further calls do nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._thread.submit(self._context.leave)
            self._thread.shutdown()

    def _announce(self, drawing: Future[Picture | None]) -> None:
        """Call `on_drawn` unless a picture is like the last one."""
        picture = drawing.result() if drawing.exception() is None else None
        if picture is None or picture.result.has_news or picture.result.textures != self._last.textures:
            self._on_drawn()

    # On the thread

    def _open(self) -> tuple[LiveView, MosaicImages]:
        context = self._context.enter()
        return LiveView(context, self._backend, self._context.finish, self._check), MosaicImages(context)

    def _check(self) -> None:
        if self._is_abandoned.is_set():
            raise PictureAbandonedError

    def _draw(self, frame: RenderInput, mosaic: MosaicInput | None) -> Picture | None:
        view, images = self._opening.result()
        try:
            result = view.draw(frame)
        except PictureAbandonedError:
            return None
        self._is_abandoned.clear()  # the rest takes little time
        aside = None if mosaic is None else images.draw(mosaic, view)
        if aside is not None:
            self._context.finish()
        return Picture(result, aside)

"""The window of `gsrain.Viewer`: `python -P -m app.viewer_window BACKEND` takes requests on its standard input."""

import os
import signal
import sys
import threading
from collections import deque
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, cast

from gsrain.viewer_messages import (
    Close,
    GetState,
    Reply,
    Request,
    Screenshot,
    SetCamera,
    SetRain,
    SetScene,
    receive,
    send,
)
from gsrain_engine.scene.files import sentence_of

from .options import has_display

if TYPE_CHECKING:
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.scene.scene import Scene
    from ui.workspace import Workspace

_STEP = "python"
"""Gesture of all that the program sets: one step of the history until a person does something else."""


def main() -> None:
    """Open the window, and leave with an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the program, which then closes this
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what libraries print is no reply
    sys.exit(ViewerWindow(requests, replies).run(cast(Literal["auto", "opengl", "cpu"], sys.argv[1])))


class ViewerWindow:
    """A window that does what a program asks for, request by request, in their order."""

    def __init__(self, requests: BinaryIO, replies: BinaryIO) -> None:
        self._requests, self._replies = requests, replies
        self._waiting: deque[Request] = deque()
        self._has_news = threading.Condition()
        self._is_alone = False
        """Whether the program is gone."""
        self._has_frames = False
        self._reading: Future[Scene] | None = None
        self._screenshot: Path | None = None

    def run(self, backend: Literal["auto", "opengl", "cpu"]) -> int:
        """Run the window until it is closed; returns the exit code, and has told the program what went wrong."""
        threading.Thread(target=self._listen, name="requests", daemon=True).start()
        try:
            if not has_display():
                raise OSError("no display: the viewer window can't open here; gr.render needs none")
            from ui.window import run_window  # the GUI libraries load only where there is a display

            run_window(self._begin, backend, self._on_frame, restarts=False)
        except Exception as error:  # whatever it is, the program gets one sentence
            said = sentence_of(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"
            self._reply(Reply(number=0, error=f"the viewer window has ended: {' '.join(said.split())}"))
            return 1
        return 0

    def _listen(self) -> None:
        """Take in requests, in a thread of its own; a window at rest wakes up for each."""
        while True:
            request = cast(Request | None, receive(self._requests, Request))
            with self._has_news:
                if request is None:
                    self._is_alone = True
                else:
                    self._waiting.append(request)
                self._has_news.notify()
            if self._has_frames:
                from imgui_bundle import hello_imgui

                hello_imgui.request_refresh()
            if request is None:
                return

    def _begin(self) -> "Editor":
        """Make the session of the first scene."""
        from gsrain_engine.editor.editor import Editor
        from gsrain_engine.scene.formats.scene_files import read_scene

        with self._has_news:
            self._has_news.wait_for(lambda: self._waiting or self._is_alone)
            if self._is_alone:
                raise OSError("the program that has opened it is gone")
            first = self._waiting.popleft()
        assert isinstance(first, SetScene)
        session = Editor(read_scene(Path(first.folder)))
        self._reply(Reply(number=first.number))
        return session

    def _on_frame(self, workspace: "Workspace") -> None:
        """Do what was asked for, as far as that goes in this frame."""
        self._has_frames = True
        session = workspace.session
        while self._waiting and self._do(self._waiting[0], workspace):
            self._waiting.popleft()
        if self._is_alone and not self._waiting:
            _leave(session)
        if self._waiting or self._is_alone:
            from imgui_bundle import hello_imgui

            hello_imgui.get_runner_params().fps_idling.enable_idling = False  # the next frame goes on with it

    def _do(self, request: Request, workspace: "Workspace") -> bool:
        """Go on with a request; returns whether it is done."""
        session, had_changes = workspace.session, workspace.session.has_changes
        reply = Reply(number=request.number)
        match request:
            case SetScene():
                if self._reading is None:
                    self._reading = _in_thread(Path(request.folder))
                if not self._reading.done():
                    return False
                reading, self._reading = self._reading, None
                if (error := reading.exception()) is not None:
                    reply = Reply(number=request.number, error=f"the scene can't be shown: {error}")
                else:
                    session.set_scene("Scene of a program", reading.result(), _STEP)
            case SetRain():
                session.set_rain("Rain of a program", request.rain, _STEP)
            case SetCamera():
                _look_from(session, request)
            case Screenshot():
                if self._screenshot is None:
                    if _is_busy(workspace):
                        return False
                    self._screenshot = session.screenshot = Path(request.path)
                    session.problem = None
                    return False
                if session.screenshot is not None:  # the view saves its next picture
                    return False
                self._screenshot = None
                reply = Reply(number=request.number, error=session.problem or "")
            case GetState():
                camera = session.shot(*session.rainy.viewport_px).camera
                values = camera.to_json() | {"exposure_s": camera.exposure_s}
                reply = Reply(number=request.number, rain=session.rain, camera=values)
            case Close():
                _leave(session)
        if session.has_changes and not had_changes:
            session.files.give_up()  # the program has them; a person is asked about changes of their own
        self._reply(reply)
        return True

    def _reply(self, reply: Reply) -> None:
        try:
            send(self._replies, reply)
        except OSError:
            self._is_alone = True


def _look_from(session: "Editor", request: SetCamera) -> None:
    from gsrain_engine.scene.camera import Camera

    session.stop_riding()
    session.following.follow("")
    session.navigation.stop()
    session.navigation.look_like(Camera.from_json(request.camera))


def _leave(session: "Editor") -> None:
    """End without a question."""
    session.files.give_up()
    session.is_leaving = True


def _is_busy(workspace: "Workspace") -> bool:
    """Whether the viewport does not show yet what it is to show."""
    session, view = workspace.session, workspace.view
    return session.is_bringing_in or session.is_compiling or not view.is_settled or view.is_catching_up


def _in_thread(folder: Path) -> "Future[Scene]":
    """Read a scene while frames go on."""
    from gsrain_engine.scene.formats.scene_files import read_scene

    reading: Future[Scene] = Future()

    def read() -> None:
        try:
            reading.set_result(read_scene(folder))
        except Exception as error:  # it is told to the program
            reading.set_exception(error)

    threading.Thread(target=read, name="read a scene", daemon=True).start()
    return reading


if __name__ == "__main__":
    main()

"""Window process of `gsrain.Viewer`: `python -P -m app.viewer_window BACKEND` reads requests from standard input."""

import os
import signal
import sys
import threading
from collections import deque
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, cast

from gsrain.viewer_messages import (
    REQUESTS,
    ApplyEdit,
    Close,
    GetScene,
    GetState,
    GoToStep,
    Reply,
    Request,
    Screenshot,
    SetCamera,
    SetRain,
    SetScene,
    receive,
    send,
)
from gsrain_engine.safe_io.errors import sentence_of

from .options import window_problem

if TYPE_CHECKING:
    from gsrain_engine.editor.document import DocumentState
    from gsrain_engine.editor.editor import Editor
    from gsrain_engine.scene.scene import Scene
    from ui.workspace import Workspace

_STEP = "python"  # undo gesture of all changes by the program: one undo step until the user edits something


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the program, which then closes this
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # keep library output out of the replies
    sys.exit(
        ViewerWindow(requests, replies).run(
            cast(Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"], sys.argv[1])
        )
    )


class ViewerWindow:
    """Window that handles requests of a program in order."""

    def __init__(self, requests: BinaryIO, replies: BinaryIO) -> None:
        self._requests, self._replies = requests, replies
        self._pending: deque[Request] = deque()
        self._changed = threading.Condition()
        self._program_exited = False
        self._is_drawing = False
        self._reading: Future[Scene] | None = None
        self._given: Scene | None = None
        """The scene that was set last, as the window has it."""
        self._saving: Future[Path] | None = None
        self._edited: tuple[DocumentState, Future[Scene]] | None = None
        """Edit in the background, and the document that it edits."""
        self._screenshot: Path | None = None

    def run(self, backend: Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"]) -> int:
        """Run the window until it is closed; returns the exit code after reporting any error to the program."""
        threading.Thread(target=self._listen, name="requests", daemon=True).start()
        try:
            if problem := window_problem():
                raise OSError(f"{problem}: the viewer window can't open here; gr.render and gr.BrowserViewer need none")
            from ui.window import run_window  # loads the GUI libraries only with a display

            run_window(self._begin, backend, self._on_frame, restarts=False)
        except Exception as error:  # the program gets one sentence for any error
            text = sentence_of(error) if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {error}"
            self._reply(Reply(number=0, error=f"the viewer window has ended: {' '.join(text.split())}"))
            return 1
        return 0

    def _listen(self) -> None:
        """Receive requests in a separate thread, waking up an idle window."""
        while True:
            request = cast(Request | None, receive(self._requests, REQUESTS))
            with self._changed:
                if request is None:
                    self._program_exited = True
                else:
                    self._pending.append(request)
                self._changed.notify()
            if self._is_drawing:
                from imgui_bundle import hello_imgui

                hello_imgui.request_refresh()
            if request is None:
                return

    def _begin(self) -> "Editor":
        from gsrain_engine.editor.editor import Editor
        from gsrain_engine.scene.formats.scene_files import read_scene

        with self._changed:
            self._changed.wait_for(lambda: self._pending or self._program_exited)
            if self._program_exited:
                raise OSError("the program that has opened it is gone")
            first = self._pending.popleft()
        assert isinstance(first, SetScene)
        self._given = read_scene(Path(first.folder))
        editor = Editor(self._given)
        self._reply(Reply(number=first.number))
        return editor

    def _on_frame(self, workspace: "Workspace") -> None:
        """Handle requests as far as possible in this frame."""
        self._is_drawing = True
        while self._pending and self._do(self._pending[0], workspace):
            self._pending.popleft()
        if self._program_exited and not self._pending:
            _leave(workspace.editor)
        if self._pending or self._program_exited:
            from imgui_bundle import hello_imgui

            hello_imgui.get_runner_params().fps_idling.enable_idling = False  # the next frame continues

    def _do(self, request: Request, workspace: "Workspace") -> bool:
        """Continue with a request; returns True if it is done."""
        editor, had_changes = workspace.editor, workspace.editor.files.has_changes
        document, viewport = editor.document, editor.viewport
        reply = Reply(number=request.number)
        match request:
            case SetScene():
                if self._reading is None:
                    from gsrain_engine.scene.formats.scene_files import read_scene

                    self._reading = editor.background.submit(read_scene, Path(request.folder), lane="opening")
                if not self._reading.done():
                    return False
                reading, self._reading = self._reading, None
                if (error := reading.exception()) is not None:
                    reply = Reply(number=request.number, error=f"the scene can't be shown: {error}")
                else:
                    self._given = reading.result()
                    document.set_contents("Scene of a program", self._given, document.rain, _STEP)
            case SetRain():
                document.set_contents("Rain of a program", document.scene, request.rain, _STEP)
            case SetCamera():
                from gsrain_engine.scene.camera import Camera

                viewport.look_from(Camera.from_json(request.camera))
            case Screenshot():
                if self._screenshot is None:
                    is_busy = editor.is_bringing_in or viewport.is_compiling or viewport.is_catching_up
                    if is_busy or not workspace.pictures.is_settled:  # the image is not the current one yet
                        return False
                    self._screenshot = viewport.screenshot = Path(request.path)
                    editor.status.dismiss()
                    return False
                if viewport.screenshot is not None:  # the view saves its next image
                    return False
                self._screenshot = None
                reply = Reply(number=request.number, error=editor.status.problem or "")
            case GetState():
                camera = viewport.shot(*editor.wet_look.viewport_px).camera
                values = camera.to_json() | {"exposure_s": camera.exposure_s}
                labels = document.history.labels[: document.history.cursor + 1]
                reply = Reply(number=request.number, rain=document.rain, camera=values, steps=labels)
            case ApplyEdit():
                try:
                    if not self._make(request, editor):
                        return False
                except ValueError as error:
                    reply = Reply(number=request.number, error=str(error))
            case GoToStep():
                document.go_to_step(document.history.cursor + request.by)
            case GetScene():
                if document.scene is not self._given:
                    if self._saving is None:
                        from gsrain_engine.editor.autosave import saved_scene
                        from gsrain_engine.editor.jobs.folder import write_copy
                        from gsrain_engine.scene.formats.scene_folder import FileCache

                        scene = saved_scene(viewport)
                        self._saving = editor.background.submit(write_copy, scene, Path(request.folder), FileCache())
                    if not self._saving.done():
                        return False
                    saving, self._saving = self._saving, None
                    if (error := saving.exception()) is not None:
                        reply = Reply(number=request.number, error=f"the scene can't be written: {error}")
                    else:
                        reply = Reply(number=request.number, folder=str(saving.result()))
            case Close():
                _leave(editor)
        if editor.files.has_changes and not had_changes:
            editor.files.give_up()  # the program has sent them; users are asked only about their own changes
        self._reply(reply)
        return True

    def _make(self, request: ApplyEdit, editor: "Editor") -> bool:
        """Continue with an edit, whose scene is computed in the background; returns True if it is done."""
        from gsrain_engine.editor.document import Recipe
        from gsrain_engine.editor.edits.members import replace_scene
        from gsrain_engine.editor.steps import EditStep

        document = editor.document
        step = EditStep(request.name, request.arguments).step(document.state)
        document.end_gesture()
        if step.of != "scene" or step.arguments:  # of rain, selection or path: at once
            document.perform(step)
            return True
        if self._edited is None or self._edited[0] is not document.state:  # else a person has edited it meanwhile
            apply, state = step.applied_to, document.state
            self._edited = state, editor.background.submit(lambda: apply(state).scene, lane="opening")
        if not self._edited[1].done():
            return False
        (_, computing), self._edited = self._edited, None
        assert step.change is not None
        document.edit(step.label, replace_scene, computing.result(), recipe=Recipe(step.change, step.options))
        return True

    def _reply(self, reply: Reply) -> None:
        try:
            send(self._replies, reply)
        except OSError:
            self._program_exited = True


def _leave(editor: "Editor") -> None:
    editor.files.give_up()
    editor.should_quit = True


if __name__ == "__main__":
    main()

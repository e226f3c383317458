"""The window from Python: opened in a process of its own, and steered by setting properties."""

import atexit
import logging
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NoReplyError
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any, BinaryIO, Literal, cast

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.editor.jobs.folder import temporary_folder, write_copy
from gsrain_engine.editor.steps import EditStep
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.formats.scene_folder import FileCache
from gsrain_engine.scene.scene import Scene

from .arguments import checked
from .viewer_messages import (
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

logger = logging.getLogger("gsrain")
REPLY_S = 300.0
"""Default time for a reply in seconds: the first image can take minutes if kernels have to be compiled."""
_END_S = 10.0  # time for the window to exit by itself, before its process is terminated


class ViewerError(ConnectionError):
    """The window can't be opened, is closed, or does not reply: one sentence."""


class Viewer:
    """A window that shows a scene: `v = gr.Viewer(scene, rain)` returns while it opens.

    Setting `scene`, `rain` or `camera` changes what it shows, in the order in which they are set; reading them returns
    what the window shows now, with what was changed there by hand. `edit` and `select` are the window's own commands,
    steps that a person sees in its history and can undo. It closes with the program that has opened it: `v.wait()`
    waits until a person closes it.
    """

    @checked
    def __init__(
        self,
        scene: Scene,
        rain: RainSettings | None = None,
        *,
        camera: Camera | None = None,
        backend: Literal["auto", "opengl", "opengl-tiles", "opengl-quads", "cpu"] = "auto",
        timeout: float = REPLY_S,
    ) -> None:
        """Start the window's process.

        Args:
            scene: The scene to show.
            rain: The rain; None is none.
            camera: Where to look from; None is the scene's home camera.
            backend: What draws in the window.
            timeout: Longest time in seconds to wait for a reply of the window.

        Raises:
            OSError: When the process can't be started.
        """
        self._timeout = timeout
        self._scene = scene
        self._number = 0
        self._lock = threading.Lock()
        self._replies: dict[int, Future[Reply]] = {}
        self._trouble = ""
        self._ended = threading.Event()
        self._outbox: SimpleQueue[Callable[[BinaryIO, Path], None] | None] = SimpleQueue()
        # Our packages come first, and Python skips the working folder.
        ours = str(Path(__file__).resolve().parents[1])
        path = os.pathsep.join(filter(None, [ours, os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "app.viewer_window", backend],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": path, "PYTHONSAFEPATH": "1"},
        )
        self._threads = [
            threading.Thread(target=work, name=f"viewer {name}", daemon=True)
            for name, work in (("requests", self._write), ("replies", self._read))
        ]
        for thread in self._threads:
            thread.start()
        atexit.register(self.close)
        self.scene = scene
        if rain is not None:
            self.rain = rain
        if camera is not None:
            self.camera = camera

    @property
    def scene(self) -> Scene:
        """The scene that the window shows: the one that was set last, or as it was edited in the window since.

        The camera stays where it is when another one is set.
        """
        with temporary_folder() as folder:
            reply = self._ask(GetScene(number=self._next_number(), folder=str(folder)))
            if reply.folder is not None:
                return read_scene(Path(reply.folder))
        return self._scene

    @scene.setter
    @checked
    def scene(self, scene: Scene) -> None:
        self._check_open()
        self._scene = scene
        number = self._next_number()

        def write(pipe: BinaryIO, folder: Path) -> None:
            place = folder / str(number)
            place.mkdir()
            send(pipe, SetScene(number=number, folder=str(write_copy(scene, place, FileCache()))))

        # The window has read the scene when it replies.
        def remove(_: BinaryIO, folder: Path) -> None:
            shutil.rmtree(folder / str(number), ignore_errors=True)

        self._expect(number).add_done_callback(lambda _: self._outbox.put(remove))
        self._outbox.put(write)

    @property
    def rain(self) -> RainSettings:
        """The rain that the window shows."""
        rain = self._ask(GetState(number=self._next_number())).rain
        assert rain is not None
        return rain

    @rain.setter
    @checked
    def rain(self, rain: RainSettings | None) -> None:
        self._request(SetRain(number=self._next_number(), rain=rain or RainSettings()))

    @property
    def camera(self) -> Camera:
        """The camera of the window in the world (meters, z up), in the size of its viewport in pixels.

        The window's camera has no roll: that of a camera which is set is lost.
        """
        values = self._ask(GetState(number=self._next_number())).camera
        assert values is not None
        return Camera.from_json(values)

    @camera.setter
    @checked
    def camera(self, camera: Camera) -> None:
        values = camera.to_json() | {"exposure_s": camera.exposure_s}
        self._request(SetCamera(number=self._next_number(), camera=values))

    @checked
    def screenshot(self, path: Path | str) -> Path:
        """Save what the viewport shows as PNG, once all that was set before is in the picture; returns the path.

        Missing folders are made. Raises `ViewerError` where the window can't save it, is closed, or does not reply.
        """
        place = Path(path).absolute()
        self._ask(Screenshot(number=self._next_number(), path=str(place)))
        return Path(path)

    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """Return what the viewport shows (sRGB, first row on top), once all that was set before is in it.

        Raises `ViewerError` as `screenshot` does.
        """
        with temporary_folder() as folder:
            file = self.screenshot(folder / "picture.png")
            with Image.open(file) as image:
                return np.asarray(image.convert("RGB"))

    @checked
    def edit(self, name: str, /, **arguments: Any) -> None:
        """Edit the window's scene as `gr.edit` does, as a step of its history, and wait until it is made.

        Args:
            name: An edit; `gsrain edit --list` lists them with their parameters.
            arguments: Its parameters: as in the list, or objects of the engine, such as arrays.

        Raises `ViewerError` for an unknown edit or parameter, and when the edit refuses, such as for a locked layer.
        """
        step = EditStep.with_values(name, arguments)
        self._ask(ApplyEdit(number=self._next_number(), name=step.name, arguments=dict(step.arguments)))

    @checked
    def select(self, what: str, /, **arguments: Any) -> None:
        """Select Gaussians in the window: `v.select("all")`, `v.select("near", distance_m=0.5)`.

        Args:
            what: An edit without its beginning `select-`; all of them are in `gsrain edit --list`.
            arguments: Its parameters, and `mode`: "set", "add", "remove" or "intersect".

        Raises `ViewerError` as `edit` does. `scene` has the selection in the `marks` of its layers and actors.
        """
        self.edit(f"select-{what}", **arguments)

    def undo(self) -> None:
        """Undo the last step of the window's history, a person's or the program's; without one, do nothing."""
        self._ask(GoToStep(number=self._next_number(), by=-1))

    def redo(self) -> None:
        """Redo the step that was undone last; without one, do nothing."""
        self._ask(GoToStep(number=self._next_number(), by=1))

    @property
    def steps(self) -> list[str]:
        """Labels of the window's history up to the present step; the first is the opened scene."""
        steps = self._ask(GetState(number=self._next_number())).steps
        assert steps is not None
        return steps

    @property
    def is_open(self) -> bool:
        """True while the window's process runs."""
        return not self._ended.is_set()

    @checked
    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the window is closed, at most `timeout` seconds; returns whether it is.

        Raises `ViewerError` where the window has ended with an error.
        """
        is_closed = self._ended.wait(timeout)
        if is_closed and self._trouble:
            raise ViewerError(self._trouble)
        return is_closed

    def close(self) -> None:
        """Close the window without a question; calling it again does nothing."""
        if not self._ended.is_set():
            self._send(Close(number=self._next_number()))
            if not self._ended.wait(_END_S):
                self._process.terminate()
                if not self._ended.wait(_END_S):
                    self._process.kill()
        self._outbox.put(None)
        atexit.unregister(self.close)
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(_END_S)

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<gsrain.Viewer of {self._scene.name!r}, {'open' if self.is_open else 'closed'}>"

    # Requests

    def _next_number(self) -> int:
        with self._lock:
            self._number += 1
            return self._number

    def _request(self, request: Request) -> None:
        self._check_open()
        self._send(request)

    def _ask(self, request: Request) -> Reply:
        self._check_open()
        expected = self._expect(request.number)
        self._send(request)
        try:
            reply = expected.result(self._timeout)
        except NoReplyError:
            raise ViewerError(f"the viewer window has not replied for {self._timeout:g} s") from None
        if reply.error:
            raise ViewerError(reply.error)
        return reply

    def _expect(self, number: int) -> "Future[Reply]":
        with self._lock:
            return self._replies.setdefault(number, Future())

    def _send(self, request: Request) -> None:
        self._outbox.put(lambda pipe, _: send(pipe, request))

    def _check_open(self) -> None:
        if self._trouble:
            raise ViewerError(self._trouble)
        if self._ended.is_set():
            raise ViewerError("the viewer window is closed: open another gr.Viewer")

    # In threads

    def _write(self) -> None:
        """Run the queued requests in order; the folder of scenes is removed at the end."""
        pipe = cast(BinaryIO, self._process.stdin)
        with temporary_folder() as folder:
            while (work := self._outbox.get()) is not None:
                try:
                    work(pipe, folder)
                except (BrokenPipeError, ValueError) as error:
                    if isinstance(error, ValueError) and not pipe.closed:
                        self._note(f"the scene can't be shown: {error}")
                except OSError as error:
                    self._note(f"the scene can't be written for the viewer window: {error}")
        with suppress(OSError):  # it could not receive the last message
            pipe.close()

    def _read(self) -> None:
        """Receive replies until the window has exited."""
        pipe = cast(BinaryIO, self._process.stdout)
        with pipe:
            while (reply := cast(Reply | None, receive(pipe, Reply))) is not None:
                if reply.number == 0:
                    self._note(reply.error)
                    continue
                with self._lock:
                    expected = self._replies.pop(reply.number, None)
                if expected is not None:
                    expected.set_result(reply)
                elif reply.error:
                    logger.error("%s", reply.error)
        code = self._process.wait()
        if code != 0 and not self._trouble:
            death = f"signal {-code}" if code < 0 else f"exit code {code}"
            self._note(f"the viewer window has died ({death}): open another gr.Viewer")
        self._ended.set()
        self._outbox.put(None)
        with self._lock:
            open_replies = list(self._replies.items())
            self._replies.clear()
        for number, expected in open_replies:
            expected.set_result(Reply(number=number, error=self._trouble or "the viewer window was closed"))

    def _note(self, trouble: str) -> None:
        self._trouble = self._trouble or trouble

"""The window in a browser, for machines without a display: pictures of this machine's renderer, shown by viser."""

import atexit
import math
import secrets
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any
from urllib.parse import quote

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.backends import open_renderer
from gsrain_engine.choices import Backend
from gsrain_engine.editor.drawing.remote_view import OutdatedPictureError, RemotePictures, RemoteViewer
from gsrain_engine.editor.viewport.camera import default_path, find_scene_core, front_camera, home_camera
from gsrain_engine.editor.viewport.options import SETTLED_S, QualityLevel
from gsrain_engine.optional_packages import require_package
from gsrain_engine.rain.properties import rain_class
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX
from gsrain_engine.render.view import RenderView
from gsrain_engine.safe_io.errors import sentence_of
from gsrain_engine.safe_io.limits import checked_token
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.geometry import matrices_from_quaternions
from gsrain_engine.scene.scene import Scene

from .arguments import checked
from .browser_panel import RainPanel
from .browser_server import HOST, open_page_server
from .viewer import Viewer, ViewerError

DEFAULT_PORT = 8080
_MAX_PX = 1920  # longer side of a picture; larger canvases show it enlarged
_JPEG_QUALITY = 85  # of pictures while something changes; pictures at rest are PNG, so that no streak is lost
_SHORTEST_S = 10.0  # of the time that plays and repeats
_PIVOT_M = 3.0  # distance ahead of the point that a drag turns around, in streets
_FARTHEST_M = 1e6  # of a browser's camera from the origin


@dataclass(eq=False)
class _Browser:
    """One connected browser."""

    client: Any
    viewer: RemoteViewer
    readings: Any
    ride: Any
    served_s: float = -math.inf


class BrowserViewer:
    """A window in the browser: `v = gr.BrowserViewer(scene, rain)` serves a page at `v.url`; a notebook shows it.

    Each browser has a camera of its own; rain, time and scene are the same for all. Setting `scene` or `rain` changes
    what they show; reading `rain` returns what a person has set there. A picture at rest has the same pixels as
    `gr.render` with the browser's camera; while something changes, pictures are smaller.

    The page is for this machine alone, and for those who have its address, which contains a token. From another
    machine: `ssh -L 8080:localhost:8080 THIS_MACHINE`.
    """

    @checked
    def __init__(
        self,
        scene: Scene,
        rain: RainSettings | None = None,
        *,
        camera: Camera | None = None,
        backend: Backend = "auto",
        port: int = DEFAULT_PORT,
        browsers: int = 16,
        token: str | None = None,
    ) -> None:
        """Start to serve.

        Args:
            scene: The scene to show.
            rain: The rain; None is none.
            camera: Where each browser looks from at first; None is the scene's home camera.
            backend: What draws.
            port: Port of the page; 0 is any free one.
            browsers: Largest number of browsers at a time.
            token: Word in the page's address; None is a random one.

        Raises:
            ImportError: Without viser, with how to install it.
            ValueError: For a token that addresses can't hold.
            OSError: When the port is taken.
            ViewerError: When the back end can't be opened.
        """
        self._token = secrets.token_urlsafe(16) if token is None else checked_token(token)
        require_package("viser", "a page for browsers")
        self._changed = threading.Condition()
        self._scene, self._rain = scene, rain or RainSettings()
        self._backend: Backend = backend
        self._path = default_path(scene, *DEFAULT_SIZE_PX)
        self._home = camera or home_camera(scene, *DEFAULT_SIZE_PX)
        self._length_s = max(self._path.duration_s, _SHORTEST_S)
        self._time_s = 0.0
        self._playing_since: float | None = None
        self._browsers: dict[int, _Browser] = {}
        self._limit, self._trouble = browsers, ""
        self._pictures, self._is_ending = 0, False
        self._ended, opened = threading.Event(), threading.Event()
        _check_free(port)
        self._thread = threading.Thread(target=self._work, args=(opened,), name="browser pictures", daemon=True)
        self._thread.start()
        opened.wait()
        if self._trouble:
            raise ViewerError(self._trouble)
        with _silence():  # viser prints a table
            self._server: Any = open_page_server(port, self._token, browsers, self._control)
        self._set_up()
        atexit.register(self.close)

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://localhost:{self._server.get_port()}/{quote(self._token, safe='')}"

    @property
    def scene(self) -> Scene:
        """The scene that was set last."""
        return self._scene

    @scene.setter
    @checked
    def scene(self, scene: Scene) -> None:
        self._check_open()
        path = default_path(scene, *DEFAULT_SIZE_PX)
        with self._changed:
            self._scene, self._path, self._length_s = scene, path, max(path.duration_s, _SHORTEST_S)
            self._time.max = self._length_s
            self._changed.notify()

    @property
    def rain(self) -> RainSettings:
        """The rain that browsers show."""
        return self._rain

    @rain.setter
    @checked
    def rain(self, rain: RainSettings | None) -> None:
        self._check_open()
        shown = rain or RainSettings()
        self._panel.display(shown)
        self._set_rain(shown)

    @property
    def browsers(self) -> int:
        """Number of browsers that show the page now."""
        return len(self._browsers)

    @property
    def pictures(self) -> int:
        """Number of pictures that were sent."""
        return self._pictures

    @property
    def is_open(self) -> bool:
        """True while the page is served."""
        return not self._ended.is_set()

    @checked
    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the window is closed, at most `timeout` seconds; returns whether it is. Ctrl-C interrupts it.

        Raises `ViewerError` where drawing has failed.
        """
        until = math.inf if timeout is None else time.monotonic() + timeout
        while not (is_closed := self._ended.wait(max(0.0, min(1.0, until - time.monotonic())))):
            if time.monotonic() >= until:  # in steps, as Ctrl-C does not end a longer one on Windows
                break
        if self._trouble:
            raise ViewerError(self._trouble)
        return is_closed

    def close(self) -> None:
        """Stop serving; calling it again does nothing."""
        with self._changed:
            self._is_ending = True
            self._changed.notify()
        if self._thread is not threading.current_thread():
            self._thread.join()
        if not self._ended.is_set():
            with _silence():
                self._server.stop()
            with self._changed:
                self._browsers.clear()  # viser reports those that leave later, if it does
            self._ended.set()
        atexit.unregister(self.close)

    def __enter__(self) -> "BrowserViewer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = f"at {self.url}" if self.is_open else "closed"
        return f"<gsrain.BrowserViewer of {self._scene.name!r}, {state}>"

    def _repr_html_(self) -> str:
        if not self.is_open:
            return repr(self).replace("<", "&lt;")
        return f'<iframe src="{self.url}" width="100%" height="640" style="border: 0"></iframe>'

    def _check_open(self) -> None:
        if self._trouble:
            raise ViewerError(self._trouble)
        if not self.is_open:
            raise ViewerError("the window in the browser is closed: open another gr.BrowserViewer")

    # The page

    def _control(self, uuid: str) -> Any:
        """Viser's control of a uuid, of all browsers or of one; None if there is none. Called on viser's thread."""
        server: Any = getattr(self, "_server", None)
        for owner in [server, *[each.client for each in [*self._browsers.values()]]] if server is not None else ():
            control = owner.gui._gui_input_handle_from_uuid.get(uuid)
            if control is not None:
                return control
        return None

    def _set_up(self) -> None:
        server, gui, eye = self._server, self._server.gui, self._home.position
        # Sharing would send the page through a server of viser's makers.
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        server.scene.set_up_direction("+z")
        ahead = self._home.world_to_camera[2, :3]
        pivot_m = _PIVOT_M
        if front_camera(self._scene) is None:  # an object to orbit, not a street to look around in
            pivot_m = max(float(ahead @ (find_scene_core(self._scene).middle - eye)), 0.1)
        server.initial_camera.position = tuple(eye)
        server.initial_camera.look_at = tuple(eye + ahead * pivot_m)
        server.initial_camera.fov = math.radians(self._home.vertical_fov_deg)
        play = gui.add_checkbox("Play", False, order=3, hint="Let time pass: rain falls, and road users move.")
        self._time = gui.add_slider(
            "Time (s)", 0.0, self._length_s, 0.01, 0.0, order=4, hint="Moment of scene and rain."
        )

        def play_or_pause(event: Any) -> None:
            self._play(event.target.value)

        def go(event: Any) -> None:
            if event.client is not None:
                self._go_to(event.target.value)

        play.on_update(play_or_pause)
        self._time.on_update(go)
        with gui.add_folder("Rain", order=5):
            self._panel = RainPanel(gui, self._rain, self._set_rain)
        server.on_client_connect(self._connect)
        server.on_client_disconnect(self._disconnect)

    def _connect(self, client: Any) -> None:
        with self._changed:
            if self._is_ending:
                return
            if len(self._browsers) >= self._limit:
                client.add_notification(
                    "Too many browsers", f"{self._limit} show this page already: close one, and load it again.",
                    color="red", auto_close_seconds=None,
                )  # fmt: skip
                return
            readings = client.gui.add_markdown("", order=1)
            hint = "Look through the camera that moves along the path."
            ride = client.gui.add_checkbox("Ride along the path", False, order=2, hint=hint)
            browser = _Browser(client, RemoteViewer(RenderView(self._home)), readings, ride)
            self._browsers[client.client_id] = browser
            self._changed.notify()

        def wake(_: Any) -> None:
            with self._changed:
                self._changed.notify()

        def ridden(_: Any) -> None:
            if not ride.value:
                self._leave_path(browser)
            wake(_)

        client.camera.on_update(wake)
        ride.on_update(ridden)

    def _disconnect(self, client: Any) -> None:
        with self._changed:
            self._browsers.pop(client.client_id, None)

    def _set_rain(self, rain: RainSettings) -> None:
        with self._changed:
            self._rain = rain
            self._changed.notify()

    def _play(self, is_on: bool) -> None:
        with self._changed:
            self._time_s = self._now_s()
            self._playing_since = time.monotonic() if is_on else None
            self._changed.notify()

    def _go_to(self, time_s: float) -> None:
        with self._changed:
            self._time_s = min(max(time_s, 0.0), self._length_s)
            self._playing_since = None if self._playing_since is None else time.monotonic()
            self._changed.notify()

    def _now_s(self) -> float:
        """Present time of scene and rain; it begins again at the end of the path."""
        if self._playing_since is None:
            return self._time_s
        return (self._time_s + time.monotonic() - self._playing_since) % self._length_s

    def _leave_path(self, browser: _Browser) -> None:
        """Put a browser's own camera where its ride has ended."""
        camera, own = browser.viewer.view.camera, browser.client.camera
        with browser.client.atomic():
            own.position = camera.position
            own.look_at = camera.position + camera.world_to_camera[2, :3] * _PIVOT_M

    # Pictures, on a thread of their own, which owns the renderer

    def _work(self, opened: threading.Event) -> None:
        try:
            with open_renderer(self._backend) as renderer:
                pictures = RemotePictures(renderer, self._scene, self._rain, self._home)
                opened.set()
                while (due := self._next()) is not None:
                    self._draw(pictures, *due, renderer.name)
        except Exception as error:
            self._trouble = (
                f"the window in the browser has ended: {type(error).__name__}: {' '.join(str(error).split())}"
            )
            if opened.is_set():
                self._server.stop()
            self._ended.set()
            opened.set()

    def _next(self) -> "tuple[_Browser, QualityLevel, Scene, RainSettings] | None":
        """Wait for the next picture that is due, of the browser that has waited longest; None at the end."""
        with self._changed:
            while not self._is_ending:
                now_s, version = time.monotonic(), (id(self._scene), self._rain)
                for browser in sorted(self._browsers.values(), key=lambda each: each.served_s):
                    try:
                        browser.viewer.view = self._view_of(browser)
                    except (ValueError, ArithmeticError, LookupError) as error:  # the others go on
                        self._end(browser, error)
                        continue
                    quality = browser.viewer.due(version, now_s)
                    if quality is not None:
                        browser.served_s = now_s
                        return browser, quality, self._scene, self._rain
                settles = any(each.viewer.budget.is_settling for each in self._browsers.values())
                self._changed.wait(SETTLED_S if settles else None)
        return None

    def _end(self, browser: _Browser, error: Exception) -> None:
        """Show a browser nothing more, since its numbers make no view."""
        self._browsers.pop(browser.client.client_id, None)
        browser.client.add_notification("No picture", sentence_of(error), color="red", auto_close_seconds=None)

    def _view_of(self, browser: _Browser) -> RenderView:
        """Present view of a browser: from its own camera, or along the path."""
        own, time_s = browser.client.camera, self._now_s()
        width, height = _picture_size(own.image_width, own.image_height)
        if browser.ride.value:
            is_still = not self._path.is_timed and self._playing_since is None
            velocity = None if is_still else self._path.velocity(time_s)
            return RenderView(self._path.camera(time_s, width, height), time_s, velocity)
        camera = _camera_of(own, width, height, self._home.exposure_s)
        return RenderView(browser.viewer.view.camera if camera is None else camera, time_s)

    def _draw(
        self, pictures: RemotePictures, browser: _Browser, quality: QualityLevel, scene: Scene, rain: RainSettings,
        backend: str,
    ) -> None:  # fmt: skip
        def checkpoint() -> None:
            """Give up an exact picture, which takes long, if its browser looks elsewhere, has gone, or all ends."""
            version = self._scene, self._rain, self._browsers.get(browser.client.client_id)
            is_same = version[0] is scene and version[1] == rain and version[2] is browser
            was = replace(browser.viewer)
            was.view = self._view_of(browser)
            if self._is_ending or not is_same or was.fingerprint != browser.viewer.fingerprint:
                raise OutdatedPictureError

        started = time.perf_counter()
        try:
            pictures.change(scene, rain)
            picture = pictures.picture(
                browser.viewer, quality, browser.client.client_id,
                checkpoint if quality.is_exact else lambda: None,
            )  # fmt: skip
        except OutdatedPictureError:
            return
        except (ValueError, ArithmeticError, LookupError, OSError, MemoryError) as error:
            browser.client.add_notification("No picture", sentence_of(error), color="red")
            browser.viewer.finished(quality, 0.0)
            return
        frame_ms = 1000 * (time.perf_counter() - started)
        browser.viewer.finished(quality, frame_ms)
        self._send(browser, picture, quality, f"{frame_ms:.0f} ms by {backend}")

    def _send(self, browser: _Browser, picture: UInt8[np.ndarray, "h w 3"], quality: QualityLevel, took: str) -> None:
        height, width = picture.shape[:2]
        if browser.client.client_id not in self._browsers:
            return
        mm_h = self._rain.intensity_mm_h
        rain = f"{mm_h:g} mm/h, {rain_class(mm_h)}" if mm_h > 0 else "no rain"
        with browser.client.atomic():
            if quality.is_exact:
                browser.client.scene.set_background_image(picture, format="png")
            else:
                browser.client.scene.set_background_image(picture, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            browser.readings.content = f"{rain}  \n{width} x {height}, {took}  \n{str(quality) or 'full quality'}"
        if self._playing_since is not None:
            self._time.value = round(browser.viewer.view.time_s, 2)
        self._pictures += 1


@checked
def show(
    scene: Scene,
    rain: RainSettings | None = None,
    *,
    camera: Camera | None = None,
    server: bool = False,
    block: bool = True,
    **options: Any,
) -> "Viewer | BrowserViewer | None":
    """Show a scene in a window, and wait until a person closes it, or presses Ctrl-C; see `Viewer` for the arguments.

    With `server=True` the window is a page for browsers, for machines without a display; see `BrowserViewer`. With
    `block=False` it does not wait, and returns the `Viewer` or `BrowserViewer`, by which the program goes on with it.

    Raises `ViewerError` where the window can't be opened or ends with an error.
    """
    if not block:
        open_window: Any = BrowserViewer if server else Viewer
        return open_window(scene, rain, camera=camera, **options)
    if server:
        with BrowserViewer(scene, rain, camera=camera, **options) as page:
            print(f"{page.url}: open it in a browser on this machine; Ctrl-C ends")
            with suppress(KeyboardInterrupt):
                page.wait()
        return None
    with Viewer(scene, rain, camera=camera, **options) as viewer:
        viewer.wait()
    return None


@contextmanager
def _silence() -> Generator[None]:
    """Let rich, by which viser reports its start and end to terminals and notebooks, print nothing."""
    console: Any = import_module("rich").get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _picture_size(width: int, height: int) -> tuple[int, int]:
    """Size of a canvas in pixels, reduced to at most `_MAX_PX`."""
    scale = min(1.0, _MAX_PX / max(width, height, 1))
    return max(1, round(scale * width)), max(1, round(scale * height))


def _camera_of(own: Any, width: int, height: int, exposure_s: float) -> Camera | None:
    """Camera of a browser, with OpenCV axes as ours; None where its numbers are none of a camera."""
    wxyz, position = np.asarray(own.wxyz, np.float64), np.asarray(own.position, np.float64)
    is_sound = np.isfinite([*wxyz, *position]).all() and np.linalg.norm(wxyz) > 0.5 and 0.01 < own.fov < 3.1
    if not is_sound or np.abs(position).max() > _FARTHEST_M:
        return None
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = matrices_from_quaternions(wxyz / np.linalg.norm(wxyz)).T
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ position
    return replace(Camera.from_fov(width, height, math.degrees(own.fov), world_to_camera), exposure_s=exposure_s)


def _check_free(port: int) -> None:
    """Raise `OSError` if a port is taken: viser would take another one."""
    if not 0 <= port <= 65535:
        raise ValueError(f"port {port}: must be within 0..65535")
    with socket.socket() as attempt:
        attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind((HOST, port))
        except OSError as error:
            raise OSError(f"port {port} can't be opened: {error.strerror}; choose another one, or 0") from None

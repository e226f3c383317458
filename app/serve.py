"""`gsrain serve`: scenes in rain for simulators, as a gRPC service, and for browsers, as a page."""

import ipaddress
import logging
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from gsrain_engine.choices import Backend
from gsrain_engine.optional_packages import require_package

from .console import counted, print
from .options import BACKEND, JsonFile, Orientation, Wet, check_within, option, takes_set
from .outputs import check_writable, write_numbers
from .render import RainOptions

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


TOKEN, LOOPBACK, ALPASIM_PORT = "GSRAIN_TOKEN", "127.0.0.1", 50051
CANVAS_PROGRAM = "CARLA_CANVAS_PARENT_PID"


@takes_set
def serve(
    *scenes: Annotated[str, Parameter(help="Scene files or folders; default: the built-in street.")],
    protocol: Annotated[
        Literal["alpasim", "carla-canvas", "browser"],
        option(
            "alpasim: the sensor simulator of NVIDIA's AlpaSim (SensorsimService). carla-canvas: a renderer of CARLA's "
            "cameras and lidars; needs carla-canvas. browser: a page with a live view and the settings of the rain, "
            "for machines without a display; needs viser.",
            topic="Service",
        ),
    ] = "alpasim",
    host: Annotated[
        str,
        option(
            "Address to listen at; one that other machines reach needs --token, and has no page for browsers.",
            topic="Service",
        ),
    ] = LOOPBACK,
    port: Annotated[
        int | None,
        option("Port to listen at; 0 is any free one. Default: 50051, and 8080 for browsers.", topic="Service"),
    ] = None,
    token: Annotated[
        str | None,
        option(
            "Calls need the metadata authorization: Bearer TOKEN; a page's address ends with it. Default: the variable "
            f"{TOKEN}; without it, calls need none, and pages have a random one.",
            topic="Service",
        ),
    ] = None,
    sessions: Annotated[
        int, option("Largest number of calls that wait or run, or of browsers, at a time.", topic="Service")
    ] = 16,
    rain: RainOptions | None = None,
    wet: Wet = None,
    orientation: Orientation | None = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    json: JsonFile = None,
) -> int:
    """Serve scenes in rain to a simulator, until Ctrl-C: pictures through its cameras, lidar, cameras and drives.

    AlpaSim's requests name a scene by its name, or * if there is one; for carla-canvas it is that of CARLA's map. A
    picture depends on its request alone. Browsers show one scene, each from a camera of its own.
    """
    from gsrain_engine.rain.calibration import load_calibration
    from gsrain_engine.rain.keyframes import NO_KEYFRAMES
    from gsrain_engine.rain.simulation import RainSimulation
    from gsrain_engine.safe_io.limits import checked_token
    from gsrain_engine.scene.formats.nurec import scene_id
    from gsrain_engine.scene.open import load_sorted_scene

    from .render import rainy_light, rendered_weather

    check_writable(json)
    check_within("--port", port, 0, 65535)
    check_within("--sessions", sessions, 1, 1000)
    token = token if token is not None else os.environ.get(TOKEN) or None
    if token is not None:
        checked_token(token)
    if protocol == "browser":
        _check_for_browsers(scenes, host, port)
        opened = (orientation or Orientation()).of(load_sorted_scene((scenes or ("street",))[0]))
        return _serve_browsers(opened, rain or RainOptions(), wet, backend, port, sessions, token, json)
    if token is None and not _is_loopback(host):
        raise ValueError(f"--host {host}: other machines reach it, so --token (or the variable {TOKEN}) is needed; "
                         f"AlpaSim sends none: forward the port to its machine with ssh -L")  # fmt: skip
    require_package("carla_canvas" if protocol == "carla-canvas" else "grpc", f"--protocol {protocol}")
    # here, as gRPC and OpenCV take a third of a second to load
    from gsrain_engine.simulation.alpasim.service import SensorsimServer
    from gsrain_engine.simulation.alpasim.simulator import Simulator, scene_ids
    from gsrain_engine.simulation.carla.service import CanvasServer

    options = rain or RainOptions()
    opened = [(orientation or Orientation()).of(load_sorted_scene(name)) for name in scenes or ("street",)]
    rainy: list[tuple[Any, RainSimulation]] = []
    for scene in opened:
        settings, weather = options.for_scene(scene), rendered_weather(options, scene)
        load_calibration(settings.calibration)
        lit, settings = rainy_light(scene, settings, wet, (weather or NO_KEYFRAMES).heaviest_mm_h(settings))
        rainy.append((lit, RainSimulation.start(settings, weather=weather)))
    names = scene_ids([scene_id(scene) for scene in opened])

    def open_simulator() -> Simulator:
        simulator = Simulator(backend)
        for name, (scene, rainfall) in zip(names, rainy, strict=True):
            simulator.add(name, scene, rainfall)
        return simulator

    port = ALPASIM_PORT if port is None else port
    address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    kind = CanvasServer if protocol == "carla-canvas" else SensorsimServer
    server = kind(open_simulator, address, sessions=sessions, token=token)
    ended = _asked_to_end()
    logging.getLogger("gsrain").setLevel(logging.INFO)
    numbers = {"scenes": names, "host": host, "port": server.port, "protocol": protocol}
    write_numbers(json, numbers)  # for programs that wait for the port
    print(f"{', '.join(names)}: served at {host}:{server.port} ({protocol}); Ctrl-C ends", flush=True)
    while not ended.wait(1.0) and not program_is_gone():  # without a timeout, Ctrl-C would not end it on Windows
        pass
    print("stopping: running calls have 10 s to end")
    server.stop()
    print(f"{counted(server.answered, 'call')} answered, {server.refused:,} refused")
    write_numbers(json, {**numbers, "answered": server.answered, "refused": server.refused})
    return 0


def _check_for_browsers(scenes: tuple[str, ...], host: str, port: int | None) -> None:
    if len(scenes) > 1:
        raise ValueError(f"--protocol browser shows one scene, not {len(scenes)}")
    if host not in (LOOPBACK, "localhost"):
        forward = f"ssh -L {port or 8080}:localhost:{port or 8080} THIS_MACHINE"
        raise ValueError(f"--host {host}: pages for browsers are not encrypted, so that only this machine gets them; "
                         f"from another: {forward}")  # fmt: skip
    require_package("viser", "--protocol browser")


def _serve_browsers(
    scene: "Scene", options: RainOptions, wet: Any, backend: Backend, port: int | None, browsers: int,
    token: str | None, json: JsonFile,
) -> int:  # fmt: skip
    from gsrain.browser import DEFAULT_PORT, BrowserViewer

    from .render import rainy_light, rendered_weather

    if rendered_weather(options, scene) is not None:
        print(f"{scene.name}: its rain keyframes are left out, as browsers set the rain", file=sys.stderr)
    settings = options.for_scene(scene)
    lit, settings = rainy_light(scene, settings, wet, settings.intensity_mm_h)
    ended = _asked_to_end()
    with BrowserViewer(
        lit, settings, backend=backend, port=DEFAULT_PORT if port is None else port, browsers=browsers, token=token
    ) as page:
        print(f"{scene.name}: open {page.url} in a browser on this machine; Ctrl-C ends")
        while not ended.wait(1.0) and not page.wait(0):
            pass
        pictures = page.pictures
    print(f"{counted(pictures, 'picture')} sent")
    write_numbers(json, {"scenes": [scene.name], "pictures": pictures})
    return 0


def _asked_to_end() -> threading.Event:
    """Event of Ctrl-C and SIGTERM."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: ended.set())
    return ended


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def program_is_gone() -> bool:
    """Return whether the program of CARLA that started this server, as its configuration said, has ended."""
    import psutil

    number = os.environ.get(CANVAS_PROGRAM, "")
    return number.isdigit() and not psutil.pid_exists(int(number))

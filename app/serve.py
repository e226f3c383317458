"""`gsrain serve`: scenes in rain for simulators, as a gRPC service."""

import ipaddress
import logging
import os
import signal
import threading
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from gsrain_engine.backends import Backend
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.keyframes import NO_KEYFRAMES
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.formats.nurec import scene_id
from gsrain_engine.scene.open import load_sorted_scene

from .console import counted, print
from .options import BACKEND, JsonFile, Wet, check_within, option
from .outputs import check_writable, write_numbers
from .render import RainOptions, rainy_light, rendered_weather
from .scene import Orientation

TOKEN = "GSRAIN_TOKEN"


def serve(
    *scenes: Annotated[str, Parameter(help="Scene files or folders; default: the built-in street.")],
    protocol: Annotated[
        Literal["alpasim"], option("alpasim: the sensor simulator of NVIDIA's AlpaSim (SensorsimService).")
    ] = "alpasim",
    host: Annotated[str, option("Address to listen at; one that other machines reach needs --token.")] = "127.0.0.1",
    port: Annotated[int, option("Port to listen at; 0 is any free one.")] = 50051,
    token: Annotated[
        str | None, option(f"Calls need the metadata authorization: Bearer TOKEN; default: the variable {TOKEN}.")
    ] = None,
    sessions: Annotated[int, option("Largest number of calls that wait or run at a time.")] = 16,
    rain: RainOptions | None = None,
    wet: Wet = None,
    orientation: Orientation | None = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    json: JsonFile = None,
) -> int:
    """Serve scenes in rain to a simulator, until Ctrl-C: pictures through its cameras, lidar, cameras and drives.

    Requests name a scene by its name, or * if there is one. A picture depends on its request alone.
    """
    check_writable(json)
    check_within("--port", port, 0, 65535)
    check_within("--sessions", sessions, 1, 1000)
    token = token or os.environ.get(TOKEN) or None
    if token is None and not _is_loopback(host):
        raise ValueError(f"--host {host}: other machines reach it, so --token (or the variable {TOKEN}) is needed")
    # here, as gRPC and OpenCV take a third of a second to load
    from gsrain_engine.simulation.alpasim.service import SensorsimServer
    from gsrain_engine.simulation.alpasim.simulator import Simulator, scene_ids

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

    address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    server = SensorsimServer(open_simulator, address, sessions=sessions, token=token)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: ended.set())
    logging.getLogger("gsrain").setLevel(logging.INFO)
    print(f"{', '.join(names)}: served at {host}:{server.port} ({protocol}); Ctrl-C ends")
    ended.wait()
    print("stopping: running calls have 10 s to end")
    server.stop()
    print(f"{counted(server.answered, 'call')} answered, {server.refused:,} refused")
    write_numbers(json, {"scenes": names, "answered": server.answered, "refused": server.refused})
    return 0


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

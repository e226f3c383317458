"""`gsrain serve`: scenes in rain for simulators, as a gRPC service, and for browsers, as a page."""

import os
import signal
import threading
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gsrain_engine.choices import Backend

from .console import print
from .options import BACKEND, JsonFile, Orientation, Wet, check_within, option, takes_set
from .outputs import check_writable, write_numbers
from .render import RainOptions

if TYPE_CHECKING:
    pass


TOKEN, LOOPBACK = "GSRAIN_TOKEN", "127.0.0.1"


@takes_set
def serve(
    *scenes: Annotated[str, Parameter(help="Scene files or folders; default: the built-in street.")],
    protocol: Annotated[
        str,
        option(
            "Who is served: alpasim, the sensor simulator of NVIDIA's AlpaSim (SensorsimService); carla-canvas, "
            "CARLA's cameras and lidars; browser, a page with a live view and the settings of the rain, for machines "
            "without a display; or the protocol of an installed package. gsrain doctor lists them.",
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
    from gsrain_engine.scene.open import load_sorted_scene
    from gsrain_engine.scene.recorded_drive import scene_id
    from gsrain_engine.simulation.serving.protocols import RainyScene, ServerOptions, find_protocol

    from .render import rainy_light, rendered_weather

    check_writable(json)
    check_within("--port", port, 0, 65535)
    check_within("--sessions", sessions, 1, 1000)
    token = token if token is not None else os.environ.get(TOKEN) or None
    if token is not None:
        checked_token(token)
    server = ServerOptions(host=host, port=port, token=token, sessions=sessions, backend=backend)
    served_by = find_protocol(protocol)
    served_by.check(len(scenes), server)
    options = rain or RainOptions()
    rainy: list[RainyScene] = []
    for name in scenes or ("street",):
        scene = (orientation or Orientation()).of(load_sorted_scene(name))
        settings, weather = options.for_scene(scene), rendered_weather(options, scene)
        load_calibration(settings.calibration)
        lit, settings = rainy_light(scene, settings, wet, (weather or NO_KEYFRAMES).heaviest_mm_h(settings))
        rainy.append(RainyScene(scene_id(scene), lit, RainSimulation.start(settings, weather=weather)))
    running = served_by.start(rainy, server)
    ended = _asked_to_end()
    write_numbers(json, {**running.numbers, "protocol": protocol})  # for programs that wait for the port
    print(f"{', '.join(running.numbers['scenes'])}: {running.greeting} ({protocol}); Ctrl-C ends", flush=True)
    while not ended.wait(1.0) and not running.is_ended:  # without a timeout, Ctrl-C would not end it on Windows
        pass
    print("stopping: running calls have 10 s to end")
    print(running.stop())
    write_numbers(json, {**running.numbers, "protocol": protocol})
    return 0


def _asked_to_end() -> threading.Event:
    """Event of Ctrl-C and SIGTERM."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: ended.set())
    return ended

"""Renderer service of carla-canvas as a gRPC server: one world for each connected program, and limits on sensors."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

from ..alpasim.server import Method, RenderServer
from ..alpasim.simulator import RequestError
from .renderer import CanvasRenderer

SERVICE = "carla_canvas.v1.Renderer"
_CALLS = ("GetInfo", "LoadWorld", "SpawnSensor", "DestroySensor", "EnableForRos", "Render")
_LARGEST_SIDE_PX, _LARGEST_PX = 4096, 8_400_000
_LARGEST_RAYS = 2_000_000  # of one measurement
_LARGEST_CHANNELS = 1024
_LONGEST_STEP_S = 10.0
_LARGEST_SENSORS, _LARGEST_ACTORS = 64, 20_000


class _Context(NamedTuple):
    """Context of a call inside of carla-canvas, whose errors become `RequestError`."""

    client: Any

    def abort(self, code: Any, details: str) -> NoReturn:
        raise RequestError(code.name, " ".join(str(details).split())[:250])


class CanvasServer(RenderServer):
    """A running server of carla-canvas' `Renderer`. Raises what `import carla_canvas` does if it is missing."""

    largest_answer_bytes = 512 * 2**20

    def services(self) -> dict[str, dict[str, tuple[Any, Method]]]:
        messages = import_module("carla_canvas.v1.renderer_pb2")
        self._worlds: OrderedDict[str, Any] = OrderedDict()
        self._adding = threading.Lock()
        return {SERVICE: {name: (getattr(messages, f"{name}Request"), self._method(name)) for name in _CALLS}}

    def _method(self, name: str) -> Method:
        def answer(request: Any, context: Any) -> Any:
            world = self._world(context.peer())
            return self.draw(
                lambda is_active: self._answer(name, world, request, _Context(context), is_active), context
            )

        return answer

    def _answer(self, name: str, world: Any, request: Any, context: _Context, is_active: Callable[[], bool]) -> Any:
        if not is_active():
            raise RequestError("CANCELLED", "the client is gone")
        try:
            if name == "SpawnSensor":
                _check_sensor(world, request.sensor)
            if name != "Render":
                return getattr(world, name)(request, context)
            _check_frame(world, request)
            return world.render(request)
        except RequestError:
            raise
        except (KeyError, ValueError, OverflowError) as error:
            text = str(error.args[0] if error.args else error)
            raise RequestError("INVALID_ARGUMENT", " ".join(text.split())[:250]) from None
        except Exception as error:
            code = getattr(error, "code", None)
            if code is None or not hasattr(code, "name"):
                raise
            raise RequestError(code.name, str(error)[:250]) from None

    def _world(self, client: str) -> Any:
        """World of a connection; at most as many as calls at a time are remembered, the last used ones."""
        with self._adding:
            if client not in self._worlds:
                renderer: Any = CanvasRenderer(self.simulator, self.version)
                self._worlds[client] = import_module("carla_canvas.server.service").RendererService(renderer)
                while len(self._worlds) > self.sessions:
                    self._worlds.popitem(last=False)
            self._worlds.move_to_end(client)
            return self._worlds[client]


def _check_sensor(world: Any, sensor: Any) -> None:
    """Refuse sensors whose measurements are too large, and too many sensors. Raises `ValueError`."""
    if len(world.sensors) >= _LARGEST_SENSORS and sensor.id not in world.sensors:
        raise RequestError(
            "RESOURCE_EXHAUSTED", f"sensor {sensor.id}: a program has at most {_LARGEST_SENSORS} sensors"
        )
    given = {each.id: each.value for each in sensor.attributes}
    if sensor.type_id.startswith("sensor.camera."):
        width, height = (_whole(sensor.id, given, name, default) for name, default in _SIZES)
        if not (min(width, height) > 0 and max(width, height) <= _LARGEST_SIDE_PX and width * height <= _LARGEST_PX):
            told = f"at most {_LARGEST_SIDE_PX} px a side and {_LARGEST_PX:,} px, not {width} x {height}"
            raise ValueError(f"sensor {sensor.id}: image_size_x, image_size_y: {told}")
    else:
        channels = _whole(sensor.id, given, "channels", 32)
        if not 1 <= channels <= _LARGEST_CHANNELS:
            raise ValueError(f"sensor {sensor.id}: channels: must be 1 to {_LARGEST_CHANNELS}, not {channels}")
        for name in ("range", "rotation_frequency", "upper_fov", "lower_fov", "horizontal_fov"):
            _real(sensor.id, given, name, 10.0)


_SIZES = (("image_size_x", 800), ("image_size_y", 600))


def _check_frame(world: Any, request: Any) -> None:
    """Refuse frames with too many actors or lidar rays. Raises `ValueError`."""
    stamp, known = request.snapshot.timestamp, len(world.scene.actors) + len(request.new_actors)
    if max(known, len(request.snapshot.actors)) > _LARGEST_ACTORS:
        raise RequestError("RESOURCE_EXHAUSTED", f"a world has at most {_LARGEST_ACTORS:,} actors")
    if len(request.sensors) > _LARGEST_SENSORS:
        raise ValueError(f"sensors: {len(request.sensors)} in one frame, at most {_LARGEST_SENSORS} are drawn")
    if not 0 <= stamp.delta_seconds <= _LONGEST_STEP_S:
        told = f"must be 0 to {_LONGEST_STEP_S:g}, not {stamp.delta_seconds:g}"
        raise ValueError(f"snapshot.timestamp.delta_seconds: {told}")
    if not 0 <= stamp.elapsed_seconds <= 1e6:
        raise ValueError(f"snapshot.timestamp.elapsed_seconds: must be 0 to 1e6, not {stamp.elapsed_seconds:g}")
    for each in request.sensors:
        sensor = world.sensors.get(each.sensor_id)
        if sensor is not None and sensor.lidar is not None:
            spec = sensor.lidar.spec
            longest_s = max(1 / max(spec.rotation_frequency, 1e-6), stamp.delta_seconds)
            step_s = stamp.delta_seconds if sensor.last is None else stamp.elapsed_seconds - sensor.last.timestamp
            rays = spec.points_per_second * min(max(step_s, 0), longest_s)
            if rays > _LARGEST_RAYS:
                told = f"{rays:,.0f} rays in one measurement, at most {_LARGEST_RAYS:,} are sent"
                raise ValueError(f"sensor {each.sensor_id}: points_per_second: {told}")


def _whole(sensor: int, given: dict[str, str], name: str, default: int) -> int:
    return int(_real(sensor, given, name, default))


def _real(sensor: int, given: dict[str, str], name: str, default: float) -> float:
    try:
        found = float(given.get(name) or default)
    except ValueError:
        found = float("nan")
    if not abs(found) < 1e9:
        raise ValueError(f"sensor {sensor}: {name}: must be a number, not {given.get(name, '')[:40]!r}")
    return found

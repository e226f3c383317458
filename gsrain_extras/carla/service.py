"""Renderer service of carla-canvas as a gRPC server: one world for each connected program, and limits on sensors."""

import re
import threading
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple, NoReturn
from urllib.parse import unquote

import psutil

from gsrain_engine.simulation.serving.grpc_server import Method, RenderServer
from gsrain_engine.simulation.serving.scenes import RequestError, ServedScenes

from .renderer import STEEPEST_DEG, CanvasRenderer

SERVICE = "carla_canvas.v1.Renderer"
_CALLS = ("GetInfo", "LoadWorld", "SpawnSensor", "DestroySensor", "EnableForRos", "Render")
_LARGEST_SIDE_PX, _LARGEST_PX = 4096, 8_400_000
_LARGEST_RAYS = 2_000_000  # of one measurement
_PIXEL_BYTES, _RAY_BYTES = 4, 16  # of measurements
_LONGEST_STEP_S = 10.0
_LARGEST_SENSORS, _LARGEST_ACTORS, _LARGEST_ACTOR_BYTES = 64, 20_000, 4096
_LARGEST_NUMBER = 1e6  # of places and angles
_MAX_ANCESTORS = 16  # an actor is mounted on another, that on a third

Bounds = tuple[float, float, float]
_LIDAR: dict[str, Bounds] = {
    "channels": (32, 1, 1024), "range": (10, 0.1, 10_000), "points_per_second": (56_000, 0, 1e9),
    "rotation_frequency": (10, 1e-3, 1000), "upper_fov": (10, -STEEPEST_DEG, STEEPEST_DEG),
    "lower_fov": (-30, -STEEPEST_DEG, STEEPEST_DEG), "horizontal_fov": (360, 0.1, 360),
    "atmosphere_attenuation_rate": (0.004, 0, 1000), "dropoff_general_rate": (0.45, 0, 1),
    "dropoff_intensity_limit": (0.8, 0, 1), "dropoff_zero_intensity": (0.4, 0, 1), "noise_stddev": (0, 0, 100),
    "noise_seed": (0, 0, 2**63),
}  # fmt: skip
_CAMERA: dict[str, Bounds] = {
    "image_size_x": (800, 1, _LARGEST_SIDE_PX), "image_size_y": (600, 1, _LARGEST_SIDE_PX), "fov": (90, 0.1, 179),
    "shutter_speed": (200, 1e-6, 1e9),
}  # fmt: skip
ATTRIBUTES = {"camera": _CAMERA, "lidar": _LIDAR}
"""Numbers of CARLA's blueprints by kind of sensor: default, smallest and largest value."""


class _Context(NamedTuple):
    """Context of a call inside of carla-canvas, whose errors become `RequestError`."""

    client: Any

    def abort(self, code: Any, details: str) -> NoReturn:
        raise RequestError(code.name, " ".join(str(details).split())[:250])


class CanvasServer(RenderServer[ServedScenes]):
    """A running server of carla-canvas' `Renderer`. Raises what `import carla_canvas` does if it is missing."""

    largest_answer_bytes = 512 * 2**20
    largest_request_bytes = 64 * 2**20
    """A world comes with its map in OpenDRIVE; large ones have tens of megabytes."""

    def services(self) -> dict[str, dict[str, tuple[Any, Method]]]:
        messages = import_module("carla_canvas.v1.renderer_pb2")
        self.worlds: dict[str, Any] = {}
        """Worlds of programs by gRPC's name of their connection."""
        self._adding = threading.Lock()
        return {SERVICE: {name: (getattr(messages, f"{name}Request"), self._method(name)) for name in _CALLS}}

    def _method(self, name: str) -> Method:
        def answer(request: Any, context: Any) -> Any:
            world = self._world(context.peer(), is_new=name == "LoadWorld")
            return self.draw(
                lambda is_active: self._answer(name, world, request, _Context(context), is_active), context
            )

        return answer

    def _answer(self, name: str, world: Any, request: Any, context: _Context, is_active: Callable[[], bool]) -> Any:
        if not is_active():
            raise RequestError("CANCELLED", "the client is gone")
        try:
            if name == "LoadWorld":
                _check_config(request)
            if name == "SpawnSensor":
                self._check_sensor(world, request.sensor)
            if name != "Render":
                return getattr(world, name)(request, context)
            self._check_frame(world, request)
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

    def _world(self, client: str, *, is_new: bool) -> Any:
        """World of a connection, which `LoadWorld` makes; one for this call alone before.

        At most as many as calls at a time are remembered. Raises `RequestError` if all of them are of programs that are
        still connected.
        """
        with self._adding:
            world = self.worlds.get(client)
            if world is None:
                renderer: Any = CanvasRenderer(self.scenes, self.version)
                world = import_module("carla_canvas.server.service").RendererService(renderer)
                if is_new:
                    self._make_room()
                    self.worlds[client] = world
            return world

    def _make_room(self) -> None:
        """Forget the worlds of programs that are gone."""
        if len(self.worlds) < self.sessions:
            return
        connected = _connected()
        for client in [*self.worlds]:
            if _address(client) not in connected:
                del self.worlds[client]
        if len(self.worlds) >= self.sessions:
            told = f"at most {self.sessions} programs have a world at a time (--sessions)"
            raise RequestError("RESOURCE_EXHAUSTED", told)

    def _check_sensor(self, world: Any, sensor: Any) -> None:
        """Refuse sensors whose measurements are too large, and too many sensors. Raises `ValueError`."""
        _check_actor(sensor)
        others = [each for number, each in world.sensors.items() if number != sensor.id]
        if len(others) >= _LARGEST_SENSORS:
            raise RequestError(
                "RESOURCE_EXHAUSTED", f"sensor {sensor.id}: a program has at most {_LARGEST_SENSORS} sensors"
            )
        given = {each.id: each.value for each in sensor.attributes}
        is_camera = sensor.type_id.startswith("sensor.camera.")
        bounds = ATTRIBUTES["camera" if is_camera else "lidar"]
        values = {name: _number(sensor.id, given, name, *row) for name, row in bounds.items()}
        if not is_camera:
            return
        width, height = (round(values[f"image_size_{axis}"]) for axis in "xy")
        if width * height > _LARGEST_PX:
            told = f"at most {_LARGEST_PX:,} px, not {width} x {height}"
            raise ValueError(f"sensor {sensor.id}: image_size_x, image_size_y: {told}")
        pixels = [each.camera.width * each.camera.height for each in others if each.camera is not None]
        total = _PIXEL_BYTES * (sum(pixels) + width * height)
        if total > self.largest_answer_bytes:
            told = (
                f"the pictures of a program's cameras have at most {self.largest_answer_bytes:,} bytes, not {total:,}"
            )
            raise RequestError("RESOURCE_EXHAUSTED", f"sensor {sensor.id}: {told}")

    def _check_frame(self, world: Any, request: Any) -> None:
        """Refuse frames with too many actors, pixels or lidar rays. Raises `ValueError`."""
        stamp, known = request.snapshot.timestamp, len(world.scene.actors) + len(request.new_actors)
        if max(known, len(request.snapshot.actors)) > _LARGEST_ACTORS:
            raise RequestError("RESOURCE_EXHAUSTED", f"a world has at most {_LARGEST_ACTORS:,} actors")
        for each in request.new_actors:
            _check_actor(each)
        if len(request.sensors) > _LARGEST_SENSORS:
            raise ValueError(f"sensors: {len(request.sensors)} in one frame, at most {_LARGEST_SENSORS} are drawn")
        if not 0 <= stamp.delta_seconds <= _LONGEST_STEP_S:
            told = f"must be 0 to {_LONGEST_STEP_S:g}, not {stamp.delta_seconds:g}"
            raise ValueError(f"snapshot.timestamp.delta_seconds: {told}")
        if not 0 <= stamp.elapsed_seconds <= 1e6:
            raise ValueError(f"snapshot.timestamp.elapsed_seconds: must be 0 to 1e6, not {stamp.elapsed_seconds:g}")
        for each in request.snapshot.actors:
            _check_numbers(f"snapshot.actors, actor {each.id}", each.transform.location, each.transform.rotation)
        if len(world.scene.states) > _LARGEST_ACTORS:  # carla-canvas keeps those of actors that are gone
            for number in world.scene.states.keys() - world.scene.actors.keys():
                del world.scene.states[number]
        parents = {number: actor.parent_id for number, actor in world.scene.actors.items()}
        parents |= {each.id: each.parent_id for each in request.new_actors}
        count = 0
        for each in request.sensors:
            sensor = world.sensors.get(each.sensor_id)
            if sensor is None:
                continue
            _check_ancestors(each.sensor_id, parents)
            if sensor.camera is not None:
                count += _PIXEL_BYTES * sensor.camera.width * sensor.camera.height
            else:
                count += _RAY_BYTES * _rays(each.sensor_id, sensor, stamp)
        self.check_answer_bytes(count)


def _rays(number: int, sensor: Any, stamp: Any) -> int:
    """Rays of a lidar's next measurement. Raises `ValueError` for too many."""
    spec = sensor.lidar.spec
    longest_s = max(1 / spec.rotation_frequency, stamp.delta_seconds)
    step_s = stamp.delta_seconds if sensor.last is None else stamp.elapsed_seconds - sensor.last.timestamp
    rays = spec.points_per_second * min(max(step_s, 0), longest_s)
    if rays > _LARGEST_RAYS:
        told = f"{rays:,.0f} rays in one measurement, at most {_LARGEST_RAYS:,} are sent"
        raise ValueError(f"sensor {number}: points_per_second: {told}")
    return int(rays) + spec.channels  # each channel's number is rounded


def _check_config(request: Any) -> None:
    """Refuse options that carla-canvas can't merge. Raises `ValueError`."""
    fields = request.renderer_config.fields
    if "options" in fields and fields["options"].WhichOneof("kind") not in ("struct_value", "null_value"):
        raise ValueError("renderer.options: must be a mapping")


def _check_actor(actor: Any) -> None:
    """Refuse actors of huge sizes, or whose descriptions are too long to be remembered. Raises `ValueError`."""
    if actor.ByteSize() > _LARGEST_ACTOR_BYTES:
        told = f"its attributes have {actor.ByteSize():,} bytes, at most {_LARGEST_ACTOR_BYTES:,} are remembered"
        raise ValueError(f"actor {actor.id}: {told}")
    box = actor.bounding_box
    _check_numbers(f"actor {actor.id}: bounding_box", box.location, box.extent, box.rotation)


def _check_numbers(name: str, *rows: Any) -> None:
    """Refuse numbers that are not finite, or huge. Raises `ValueError`."""
    for row in rows:
        for field, value in row.ListFields():
            if not abs(value) <= _LARGEST_NUMBER:
                raise ValueError(
                    f"{name}: {field.name}: must be -{_LARGEST_NUMBER:g} to {_LARGEST_NUMBER:g}, not {value:g}"
                )


def _check_ancestors(number: int, parents: dict[int, int]) -> None:
    """Refuse sensors on chains of actors that never end. Raises `ValueError`."""
    at = number
    for _ in range(_MAX_ANCESTORS):
        at = parents.get(at, 0)
        if at == 0:
            return
    raise ValueError(f"sensor {number}: parent_id: is mounted on more than {_MAX_ANCESTORS} actors, one on another")


def _number(sensor: int, given: dict[str, str], name: str, default: float, low: float, high: float) -> float:
    try:
        found = float(given.get(name) or default)
    except ValueError:
        found = float("nan")
    if not low <= found <= high:
        raise ValueError(f"sensor {sensor}: {name}: must be {low:g} to {high:g}, not {given.get(name, '')[:40]!r}")
    return found


def _connected() -> set[str]:
    """Addresses of the other ends of this process's connections, as `_address` writes them."""
    found = psutil.Process().net_connections("tcp")
    ends = {each.raddr for each in found if each.raddr and each.status == psutil.CONN_ESTABLISHED}
    return {f"{ip.removeprefix('::ffff:')}:{port}" for ip, port in ends}


def _address(client: str) -> str:
    """Address of one of gRPC's clients, such as ipv4:127.0.0.1:54321 or ipv6:%5B::1%5D:54321."""
    return re.sub(r"[\[\]]", "", unquote(client).partition(":")[2]).removeprefix("::ffff:")

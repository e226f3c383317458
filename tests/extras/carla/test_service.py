"""A client of carla-canvas' renderer service: cameras, lidar, road users, two programs at once, hostile messages."""

import os
import subprocess
from collections.abc import Iterator
from functools import partial
from typing import Any

import grpc
import numpy as np
import pytest

import gsrain as gr
from grpc_clients import scene_with_car, status_of, wait_for
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.serving.scenes import ServedScenes
from gsrain_extras.carla import service as carla_service
from gsrain_extras.carla.protocol import CANVAS_PROGRAM, program_is_gone
from gsrain_extras.carla.service import CanvasServer

encodings: Any = pytest.importorskip("carla_canvas.encodings")
pb: Any = pytest.importorskip("carla_canvas.v1.renderer_pb2")
pb_grpc: Any = pytest.importorskip("carla_canvas.v1.renderer_pb2_grpc")

EGO, CAMERA, DEPTH, LIDAR, CAR = 1, 2, 3, 4, 5
WIDTH, HEIGHT, FOV = 96, 64, 60.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_with_car()


@pytest.fixture(scope="module")
def server(scene: Scene) -> Iterator[CanvasServer]:
    def opened() -> ServedScenes:
        simulator = ServedScenes("cpu")
        simulator.add("dry", scene, RainSimulation.start(RainSettings(intensity_mm_h=0.0)))
        simulator.add("rainy", scene, RainSimulation.start(RainSettings(intensity_mm_h=50.0, seed=3)))
        return simulator

    server = CanvasServer(opened, "127.0.0.1:0", sessions=8)
    yield server
    server.stop(1)


class Program:
    """A program of CARLA with a car, a camera, a depth camera and a lidar on it, and another car."""

    def __init__(self, server: CanvasServer, town: str = "dry", **config: Any) -> None:
        self.channel = self.connected(server)
        self.stub = pb_grpc.RendererStub(self.channel)
        self.frames = 0
        self.load(town, **config)
        self.spawn(CAMERA, "sensor.camera.rgb", image_size_x=WIDTH, image_size_y=HEIGHT, fov=FOV)
        self.spawn(DEPTH, "sensor.camera.depth", image_size_x=WIDTH, image_size_y=HEIGHT, fov=FOV)
        self.spawn(
            LIDAR, "sensor.lidar.ray_cast", channels=16, range=60, points_per_second=40_000, upper_fov=5, lower_fov=-8,
            rotation_frequency=10, dropoff_general_rate=0, dropoff_intensity_limit=0,
        )  # fmt: skip

    @staticmethod
    def connected(server: CanvasServer) -> Any:
        """A connection of its own."""
        options = [("grpc.max_receive_message_length", -1), ("grpc.use_local_subchannel_pool", 1)]
        return grpc.insecure_channel(f"127.0.0.1:{server.port}", options)

    def load(self, town: str, **config: Any) -> None:
        request = pb.LoadWorldRequest(map_name=f"Carla/Maps/{town}", episode_id=7)
        request.renderer_config.update(config)
        self.stub.LoadWorld(request)

    def spawn(self, number: int, kind: str, **attributes: Any) -> None:
        self.stub.SpawnSensor(pb.SpawnSensorRequest(sensor=_actor(number, kind, EGO, **attributes)))

    def frame(self, *sensors: int, place: tuple[float, float] = (12.0, 0.0), speed: float = 0.0, time: float = 1.0,
              car: str = "vehicle.tesla.model3") -> Any:  # fmt: skip
        """Measurements of sensors 1.5 m above the origin of a car at x = 2 m; y of `place` is to the right."""
        return self.stub.Render(self.request(*sensors, place=place, speed=speed, time=time, car=car)).measurements

    def request(self, *sensors: int, place: tuple[float, float] = (12.0, 0.0), speed: float = 0.0, time: float = 1.0,
                car: str = "vehicle.tesla.model3") -> Any:  # fmt: skip
        request, self.frames = pb.RenderRequest(), self.frames + 1  # a frame of the same number is not drawn anew
        stamp = request.snapshot.timestamp
        stamp.frame, stamp.elapsed_seconds, stamp.delta_seconds = self.frames, time, 0.05
        for number, (x, y, z) in {EGO: (2, 0, 0), CAR: (*place, 0), **dict.fromkeys((2, 3, 4), (2, 0, 1.5))}.items():
            row = request.snapshot.actors.add(id=number)
            row.transform.location.x, row.transform.location.y, row.transform.location.z = x, y, z
            row.velocity.x = 0.0 if number == CAR else speed
        request.new_actors.extend([_actor(EGO, "vehicle.hero", 0, base_type="car"), _actor(CAR, car, 0)])
        for number in sensors:
            request.sensors.add(sensor_id=number, deliver=True)
        return request

    def picture(self, **given: Any) -> Any:
        (measured,) = self.frame(CAMERA, **given)
        return pixels(measured.image)[..., 2::-1].astype(int)


def _actor(number: int, kind: str, parent: int, **attributes: Any) -> Any:
    actor = pb.Actor(id=number, type_id=kind, parent_id=parent)
    if not kind.startswith("sensor."):
        extent, middle = actor.bounding_box.extent, actor.bounding_box.location
        extent.x, extent.y, extent.z, middle.z = 2.0, 1.0, 1.0, 1.0
    for name, value in attributes.items():
        actor.attributes.add(id=name, value=str(value))
    return actor


def pixels(image: Any) -> Any:
    return np.frombuffer(image.raw_data, np.uint8).reshape(image.height, image.width, 4)


def red(picture: Any) -> Any:
    return (picture[..., 0] > 150) & (picture[..., 1] < 60)


def test_a_camera_shows_the_scene_with_carlas_cars(server: CanvasServer, scene: Scene) -> None:
    program = Program(server)
    info = program.stub.GetInfo(pb.GetInfoRequest())
    assert info.name == "gsrain" and info.protocol_version == 2
    assert [*info.sensor_types] == ["sensor.camera.rgb", "sensor.camera.depth", "sensor.lidar.ray_cast"]
    focal = WIDTH / 2 / np.tan(np.radians(FOV / 2))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (2, 0, 1.5)
    camera = Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, np.linalg.inv(pose))
    expected = gr.render(scene, gr.Rain(0.0), camera=camera, time=1.0, backend="cpu").rgb
    np.testing.assert_array_equal(program.picture(), expected)  # the scene's own car is at the same place
    columns = np.nonzero(red(program.picture(place=(12.0, 2.0))).any(axis=0))[0]
    assert (columns[0] + columns[-1] + 1) / 2 == pytest.approx(WIDTH / 2 + focal * 2 / 10, abs=1)  # to the right
    assert not red(program.picture(car="walker.pedestrian.0001")).any()  # the scene has no pedestrian


def test_depth_and_lidar_hit_the_car(server: CanvasServer) -> None:
    program = Program(server)
    depth, turn = program.frame(DEPTH, LIDAR)
    assert encodings.decode_depth(pixels(depth.image))[40, 48] == pytest.approx(10, abs=0.8)
    points = np.frombuffer(turn.lidar.raw_data, "<f4").reshape(-1, 4)
    assert sum(turn.lidar.points_per_channel) == len(points)
    second = program.frame(LIDAR, time=1.05)[0]  # half a turn each: from -180 degrees, then from 0
    both = np.concatenate([points, np.frombuffer(second.lidar.raw_data, "<f4").reshape(-1, 4)])
    car = both[(np.abs(both[:, 0] - 10) < 0.5) & (np.abs(both[:, 1]) < 1) & (both[:, 2] > -1.2)]
    assert len(car) > 50 and abs(np.median(car[:, 0]) - 10) < 0.1
    assert 0.1 < np.median(car[:, 3]) <= 0.2  # reflectance of a matt surface, not CARLA's exp(-a d)


def test_rain_falls_and_streaks_follow_the_vehicle(server: CanvasServer) -> None:
    dry, rainy = Program(server).picture(), Program(server, "rainy")
    at_rest = rainy.picture()
    assert np.abs(at_rest - dry).mean() > 0.5
    assert (rainy.picture(speed=20.0) != at_rest).any()
    assert (Program(server, "rainy").picture() == at_rest).all()  # a function of the request's time and seed


def test_two_programs_have_worlds_of_their_own(server: CanvasServer) -> None:
    first, second = Program(server, "rainy"), Program(server, "dry")
    alone = [Program(server, town).frame(CAMERA)[0].image.raw_data for town in ("rainy", "dry")]
    waiting = [each.stub.Render.future(each.request(CAMERA)) for each in (first, second, first)]
    found = [each.result().measurements[0].image.raw_data for each in waiting]
    assert found == [*alone, alone[0]] and alone[0] != alone[1]


def test_the_configuration_places_a_scene_and_names_actors(server: CanvasServer) -> None:
    moved = {"scene": "dry", "transform": {"location": [0, 5, 0], "rotation": [0, 0, 0]}}
    assets = {"maps": {"Town*": moved}, "actors": {"walker.*": "car-7"}}
    program = Program(server, "Town10HD_Opt", assets=assets)
    assert red(program.picture(car="walker.pedestrian.0001")).any()
    assert (program.picture(place=(12.0, 0.0)) != Program(server).picture(place=(12.0, 0.0))).any()


WRONG_WORLDS: list[dict[str, Any]] = [
    {"maps": {"*": {"scene": "none"}}},
    {"maps": {"*": {"scene": "dry", "transform": {"location": ["a", 0, 0]}}}},
    {"maps": {"*": {"scene": "dry", "transform": {"rotation": [0, 0]}}}},
    {"maps": {"*": {"path": "/etc"}}},
    {"actors": {"vehicle.*": "none"}},
    {"actors": 3},
]
WRONG_SENSORS: list[tuple[str, dict[str, Any]]] = [
    ("camera.rgb", {"image_size_x": 5000}),
    ("camera.rgb", {"image_size_x": "x"}),
    ("camera.rgb", {"fov": 180}),
    ("lidar.ray_cast", {"channels": 100_000}),
    ("lidar.ray_cast", {"range": "nan"}),
]
WRONG_FRAMES: list[dict[str, Any]] = [
    {"place": (float("nan"), 0.0)}, {"place": (1e30, 0.0)}, {"time": -1.0}, {"time": 1e300}, {"time": float("nan")},
]  # fmt: skip


def test_what_is_wrong_ends_in_a_status(server: CanvasServer) -> None:
    program = Program(server)
    assert status_of(lambda: program.load("Town01")) == "INVALID_ARGUMENT"  # there are two scenes, of other names
    for options in (5, "fast", [1], True):
        assert status_of(partial(program.load, "dry", options=options)) == "INVALID_ARGUMENT"
    for assets in WRONG_WORLDS:
        assert status_of(partial(program.load, "dry", assets=assets)) == "INVALID_ARGUMENT"
    for kind, attributes in WRONG_SENSORS:
        assert status_of(partial(program.spawn, 9, f"sensor.{kind}", **attributes)) == "INVALID_ARGUMENT"
    assert status_of(partial(program.spawn, 9, "sensor.camera.semantic_segmentation")) == "UNIMPLEMENTED"
    topic = pb.EnableForRosRequest(sensor_id=CAMERA, enabled=True)
    assert status_of(partial(program.stub.EnableForRos, topic)) == "FAILED_PRECONDITION"
    program.load("dry")
    assert status_of(partial(program.frame, CAMERA)) == "NOT_FOUND"  # a new world has no sensors
    program.spawn(9, "sensor.lidar.ray_cast", points_per_second=900_000_000)
    program.spawn(CAMERA, "sensor.camera.rgb")
    assert status_of(partial(program.frame, 9)) == "INVALID_ARGUMENT"
    for given in WRONG_FRAMES:
        assert status_of(partial(program.frame, CAMERA, **given)) == "INVALID_ARGUMENT"
    for name in ("LoadWorld", "SpawnSensor", "Render"):
        raw = program.channel.unary_unary(f"/carla_canvas.v1.Renderer/{name}")
        assert status_of(partial(raw, b"\xff" * 50)) == "INVALID_ARGUMENT"
    fresh = grpc.insecure_channel(f"127.0.0.1:{server.port}", [("grpc.use_local_subchannel_pool", 1)])
    assert status_of(partial(pb_grpc.RendererStub(fresh).Render, pb.RenderRequest())) == "FAILED_PRECONDITION"
    fresh.close()


HOSTILE = ("nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "1e-308", "x", "9" * 400, "1", "20")


@pytest.mark.parametrize("kind", ["camera.rgb", "lidar.ray_cast"])
def test_numbers_of_a_sensor_are_those_that_can_be_drawn(server: CanvasServer, kind: str) -> None:
    program = Program(server, "rainy")
    sound = {
        "image_size_x": 24,
        "image_size_y": 16,
        "points_per_second": 300,
        "channels": 2,
        "dropoff_general_rate": 0,
    }
    drawn = 0
    for name in carla_service.ATTRIBUTES[kind.partition(".")[0]]:
        for value in HOSTILE:
            try:
                program.spawn(9, f"sensor.{kind}", **sound | {name: value})
            except grpc.RpcError as error:
                assert error.code().name == "INVALID_ARGUMENT" and name in error.details(), (name, value)
                continue
            request = program.request()
            request.sensors.add(sensor_id=9, deliver=True)
            request.snapshot.actors.add(id=9)
            drawn += len(program.stub.Render(request).measurements)
    assert drawn > 2
    for name in ("upper_fov", "horizontal_fov") if kind.startswith("lidar") else ("fov", "image_size_x"):
        for value in ("nan", "0" if name != "upper_fov" else "91"):
            assert status_of(partial(program.spawn, 9, f"sensor.{kind}", **{name: value})) == "INVALID_ARGUMENT"


def test_a_program_remembers_no_more_than_it_may(server: CanvasServer) -> None:
    program = Program(server)
    long = {f"a{k}": "x" * 1000 for k in range(5)}
    assert status_of(partial(program.spawn, 9, "sensor.camera.rgb", **long)) == "INVALID_ARGUMENT"
    for number in range(10, 30):
        if number < 25:
            program.spawn(number, "sensor.camera.rgb", image_size_x=4096, image_size_y=2048)
    with pytest.raises(grpc.RpcError) as full:
        program.spawn(25, "sensor.camera.rgb", image_size_x=4096, image_size_y=2048)
    assert full.value.code().name == "RESOURCE_EXHAUSTED"
    program.spawn(24, "sensor.camera.rgb", image_size_x=4096, image_size_y=2048)  # in place of the same one
    first, second = program.request(), program.request()
    for request, start in ((first, 1_000), (second, 21_000)):
        for k in range(15_000):
            request.snapshot.actors.add(id=start + k)
        program.stub.Render(request)
    assert status_of(partial(program.stub.Render, many_parents(program))) == "INVALID_ARGUMENT"
    third = program.request()
    program.stub.Render(third)
    (world,) = [each for each in server.worlds.values() if len(each.sensors) > 15]
    assert len(world.scene.states) < 100


def many_parents(program: Program) -> Any:
    """A frame whose camera is mounted on itself, by way of others."""
    request = program.request(CAMERA)
    request.new_actors.extend(_actor(number, "vehicle.a", number % 30 + 100) for number in range(100, 130))
    request.new_actors.add(id=CAMERA, parent_id=100, type_id="sensor.camera.rgb")
    return request


def test_a_world_stays_with_a_program_that_is_connected(scene: Scene) -> None:
    def opened() -> ServedScenes:
        simulator = ServedScenes("cpu")
        simulator.add("dry", scene, RainSimulation.start(RainSettings(intensity_mm_h=0.0)))
        return simulator

    server = CanvasServer(opened, "127.0.0.1:0", sessions=2)
    try:
        first, second = Program(server), Program(server)
        for _ in range(3):  # what asks without a world of its own has none to take
            stranger = Program.connected(server)
            assert pb_grpc.RendererStub(stranger).GetInfo(pb.GetInfoRequest()).name == "gsrain"
            stranger.close()
        assert status_of(partial(Program, server)) == "RESOURCE_EXHAUSTED"
        assert first.frame(CAMERA) and second.frame(CAMERA)
        second.channel.close()
        wait_for(partial(has_room, server))
        assert first.frame(CAMERA)
    finally:
        server.stop(1)


def has_room(server: CanvasServer) -> bool:
    try:
        return Program(server) is not None
    except grpc.RpcError:
        return False


def test_the_command_ends_with_the_program_that_started_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CANVAS_PROGRAM, str(os.getpid()))
    assert not program_is_gone()
    ended = subprocess.Popen(["true"])
    ended.wait(60)
    monkeypatch.setenv(CANVAS_PROGRAM, str(ended.pid))
    assert program_is_gone()
    monkeypatch.delenv(CANVAS_PROGRAM)
    assert not program_is_gone()  # it was started by hand

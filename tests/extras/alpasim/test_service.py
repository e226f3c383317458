"""A client of gRPC against the server: pictures, two clients at once, hostile messages, killed clients, tokens."""

import io
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import grpc
import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from grpc_clients import scene_with_car, status_of, wait_for
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.serving.grpc_server import MAX_REQUEST_BYTES, RECEIVED_AT_ONCE
from gsrain_engine.simulation.serving.health import HEALTH_SERVICE, health_messages
from gsrain_extras.alpasim import messages
from gsrain_extras.alpasim.messages import SERVICE, calls, message
from gsrain_extras.alpasim.service import SensorsimServer
from gsrain_extras.alpasim.simulator import Simulator

SIZE = 96, 64


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_with_car()


@pytest.fixture(scope="module")
def server(scene: Scene) -> Iterator[SensorsimServer]:
    def opened() -> Simulator:
        simulator = Simulator("cpu")
        simulator.add("dry", scene, RainSimulation.start(RainSettings(intensity_mm_h=0.0)))
        simulator.add("rainy", scene, RainSimulation.start(RainSettings(intensity_mm_h=50.0, seed=3)))
        return simulator

    server = SensorsimServer(opened, "127.0.0.1:0", sessions=8)
    yield server
    server.stop(1)


class Client:
    """Calls of a service over a channel of its own."""

    def __init__(self, port: int, **metadata: str) -> None:
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}", [("grpc.max_receive_message_length", 1 << 26)])
        self.metadata = [*metadata.items()]

    def call(self, name: str, request: Any = None, service: str = SERVICE) -> Any:
        kinds = calls(service)[name]
        data = (kinds.request() if request is None else request).SerializeToString()
        return kinds.answer.FromString(self.raw(name, data, service))

    def raw(self, name: str, data: bytes, service: str = SERVICE) -> bytes:
        return self.channel.unary_unary(f"/{service}/{name}")(data, metadata=self.metadata, timeout=120)

    def picture(self, request: Any) -> np.ndarray:
        return np.asarray(Image.open(io.BytesIO(self.call("render_rgb", request).image_bytes)))


@pytest.fixture
def client(server: SensorsimServer) -> Iterator[Client]:
    client = Client(server.port)
    yield client
    client.channel.close()


def camera_of(client: Client, scene_id: str = "dry") -> Any:
    (camera,) = client.call(
        "get_available_cameras", message("AvailableCamerasRequest")(scene_id=scene_id)
    ).available_cameras
    return camera


def set_pose(target: Any, place: tuple[float, float, float], quaternion: tuple[float, float, float, float]) -> None:
    target.vec.x, target.vec.y, target.vec.z = place
    target.quat.w, target.quat.x, target.quat.y, target.quat.z = quaternion


AHEAD = 0.5, -0.5, 0.5, -0.5


def request_of(client: Client, scene_id: str = "dry", end_m: float = 0.0, **fields: Any) -> Any:
    """A picture from the front camera at 1 s, 2 m along the drive; it moves `end_m` to the left within 40 ms."""
    request = message("RGBRenderRequest")(
        scene_id=scene_id, resolution_w=SIZE[0], resolution_h=SIZE[1], frame_start_us=1_000_000,
        frame_end_us=1_040_000 if end_m else 1_000_000, image_format=1, **fields,
    )  # fmt: skip
    request.camera_intrinsics.CopyFrom(camera_of(client, scene_id).intrinsics)
    set_pose(request.sensor_pose.start_pose, (2, 0, 1.5), AHEAD)
    set_pose(request.sensor_pose.end_pose, (2, end_m, 1.5), AHEAD)
    return request


def with_car(request: Any, place: tuple[float, float, float]) -> Any:
    row = request.dynamic_objects.add(track_id="car-7")
    set_pose(row.pose_pair.start_pose, place, (1, 0, 0, 0))
    return request


# What scenes have


def test_scenes_cameras_and_drives_are_listed(client: Client) -> None:
    assert [*client.call("get_available_scenes").scene_ids] == ["dry", "rainy"]
    assert {row.scene_id for row in client.call("get_loaded_scenes").scenes} == {"dry", "rainy"}
    assert client.call("get_version").version_id.startswith("gsrain")
    assert not client.call("get_available_ego_masks").ego_mask_metadata
    camera = camera_of(client)
    assert (camera.logical_id, camera.intrinsics.resolution_w) == ("FRONT", 960)
    assert camera.rig_to_camera.vec.z == 1.5  # above the rig, which is on the ground
    (found,) = client.call(
        "get_available_trajectories", message("AvailableTrajectoriesRequest")(scene_id="dry")
    ).available_trajectories
    poses = found.trajectory.poses
    assert [pose.timestamp_us for pose in poses] == [k * 1_000_000 for k in range(6)]
    assert (poses[3].pose.vec.x, poses[3].pose.vec.z) == (6, 0)
    asked, answered = health_messages()
    check = client.raw("Check", asked().SerializeToString(), HEALTH_SERVICE)
    assert answered.FromString(check).status == 1


def test_descriptions_are_those_of_the_protos(tmp_path: Path) -> None:
    protoc = pytest.importorskip("grpc_tools.protoc")
    folder = Path(messages.__file__).with_name("protos")
    made = tmp_path / "made.binpb"
    names = ["", f"--proto_path={folder}", "--include_imports", f"--descriptor_set_out={made}"]
    assert protoc.main([*names, "alpasim_grpc/v0/sensorsim.proto"]) == 0
    assert made.read_bytes() == (folder / "descriptors.binpb").read_bytes()


# Pictures


def test_a_pinhole_picture_is_that_of_render(client: Client, scene: Scene) -> None:
    camera = scene.rigs["one"][0].camera(scene.ego_to_world(1.0))
    camera = replace(camera, width=96, height=64, fx=80.0, fy=80.0, cx=48.0, cy=32.0)
    empty = replace(scene, actors=())  # the request lists no car
    expected = gr.render(empty, gr.Rain(0.0), camera=camera, time=1.0, backend="cpu").rgb
    np.testing.assert_array_equal(client.picture(request_of(client)), expected)


def test_road_users_are_where_the_request_says(client: Client) -> None:
    def middle(place: tuple[float, float, float]) -> float:
        picture = client.picture(with_car(request_of(client), place)).astype(float)
        red = (picture[..., 0] > 150) & (picture[..., 1] < 60)
        assert red.any()
        columns = np.nonzero(red.any(axis=0))[0]
        return float(columns[0] + columns[-1] + 1) / 2

    # Poses are of the middle of the box: a car 10 m before the camera, 80 px of focal length.
    assert middle((12, 0, 1)) == pytest.approx(48, abs=0.6)
    assert middle((12, 2, 1)) == pytest.approx(48 - 80 * 2 / 10, abs=0.6)


def test_rows_of_a_rolling_shutter_have_their_own_poses(client: Client) -> None:
    request = with_car(request_of(client, end_m=2.0), (12, 0, 1))
    for shutter, first_is_start in ((1, True), (3, False)):
        request.camera_intrinsics.shutter_type = shutter
        rolled = client.picture(request)
        still = with_car(request_of(client), (12, 0, 1))
        for row, part in ((0, 1 / 64), (63, 63 / 64)):
            part = part if first_is_start else 1 - part
            set_pose(still.sensor_pose.start_pose, (2, 2 * part, 1.5), AHEAD)
            still.sensor_pose.end_pose.CopyFrom(still.sensor_pose.start_pose)
            assert np.abs(client.picture(still)[row].astype(int) - rolled[row]).max() <= 6


def test_lenses_show_the_same_place(client: Client) -> None:
    """A fisheye's middle is a pinhole's: f-theta and tangent differ by 1 in 400 there."""
    request = with_car(request_of(client), (12, 0, 1))
    straight = client.picture(request).astype(float)
    spec = request.camera_intrinsics
    spec.opencv_fisheye_param.focal_length_x = spec.opencv_fisheye_param.focal_length_y = 800
    spec.opencv_fisheye_param.principal_point_x, spec.opencv_fisheye_param.principal_point_y = 480, 320
    bent = client.picture(request).astype(float)
    inside = np.s_[24:40, 36:60]
    assert np.abs(bent[inside] - straight[inside]).mean() < 4
    assert np.abs(bent - straight).mean() > 1


def test_a_rolling_fisheye_is_black_where_it_sees_nothing(client: Client) -> None:
    request = request_of(client, end_m=2.0)
    spec = request.camera_intrinsics
    lens, spec.shutter_type = spec.opencv_fisheye_param, 1
    lens.focal_length_x = lens.focal_length_y = 250
    lens.principal_point_x, lens.principal_point_y, lens.max_angle = 480, 320, 1.1
    picture = client.picture(request)
    assert not picture[:2].any() and not picture[-2:].any()  # 275 of 320 px above and below the middle
    assert picture[8:28, 40:56].any(axis=-1).all()  # the scene has no road


def test_formats_of_pictures(client: Client) -> None:
    request = request_of(client)
    png = client.picture(request)
    request.image_format = 4
    planar = np.frombuffer(client.call("render_rgb", request).image_bytes, np.uint8)
    np.testing.assert_array_equal(planar.reshape(3, SIZE[1], SIZE[0]).transpose(1, 2, 0), png)
    request.image_format, request.image_quality = 2, 95
    assert np.abs(client.picture(request).astype(int) - png).mean() < 4


def test_lidar_hits_the_car(client: Client) -> None:
    request = message("LidarRenderRequest")(scene_id="rainy", frame_start_us=1_000_000, frame_end_us=1_000_000)
    request.lidar_config.lidar_type = 1
    set_pose(request.sensor_pose.end_pose, (2, 0, 1.5), (1, 0, 0, 0))
    row = request.dynamic_objects.add(track_id="car-7")
    set_pose(row.pose_pair.start_pose, (12, 0, 1), (1, 0, 0, 0))
    answer = client.call("render_lidar", request)
    points = np.array(answer.point_xyzs).reshape(-1, 3)
    assert answer.num_points == len(points) == len(answer.point_intensities) > 1000
    np.testing.assert_array_equal(np.frombuffer(answer.point_xyzs_buffer, "<f4"), points.ravel().astype("<f4"))
    car = points[(np.abs(points[:, 0] - 10) < 0.5) & (np.abs(points[:, 1]) < 0.9) & (points[:, 2] > -1.2)]
    assert len(car) > 100
    assert abs(np.median(car[:, 0]) - 10) < 0.15


# Several clients


def test_two_clients_at_once_get_the_same_bytes_as_alone(server: SensorsimServer, client: Client) -> None:
    batch = message("BatchRGBRenderRequest")()
    for end_m in (0.0, 0.3, 0.6):
        batch.items.add(camera_name=f"{end_m}", request=request_of(client, "rainy", end_m))
    alone = client.raw("batch_render_rgb", batch.SerializeToString())
    assert all(item.success for item in calls(SERVICE)["batch_render_rgb"].answer.FromString(alone).items)
    found: list[bytes] = []

    def again() -> None:
        mine = Client(server.port)
        found.append(mine.raw("batch_render_rgb", batch.SerializeToString()))
        mine.channel.close()

    threads = [Thread(target=again) for _ in range(2)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert found == [alone, alone]


_WAITING = """
import sys, grpc
call = grpc.insecure_channel(sys.argv[1]).unary_unary("/" + sys.argv[2])
waiting = [call.future(open(sys.argv[3], "rb").read(), wait_for_ready=True) for _ in range(6)]
waiting[0].result()
"""


def test_killed_clients_leave_nothing(server: SensorsimServer, client: Client, tmp_path: Path) -> None:
    request = message("AggregatedRenderRequest")()
    request.rgb_requests.extend(request_of(client, "rainy", 0.1 * k) for k in range(60))
    (tmp_path / "request").write_bytes(request.SerializeToString())
    before = server.answered, server.refused
    address, method = f"127.0.0.1:{server.port}", f"{SERVICE}/render_aggregated"
    killed = subprocess.Popen([sys.executable, "-c", _WAITING, address, method, str(tmp_path / "request")])
    wait_for(lambda: server.running == 6)
    killed.kill()
    killed.wait(60)
    wait_for(lambda: server.running == 0)
    assert (server.answered, server.refused) == (before[0], before[1] + 6)
    client.picture(request_of(client))  # the next one is served


def test_more_calls_than_sessions_are_turned_away(scene: Scene) -> None:
    def opened() -> Simulator:
        simulator = Simulator("cpu")
        simulator.add("dry", scene, RainSimulation.start(RainSettings(intensity_mm_h=0.0)))
        return simulator

    server = SensorsimServer(opened, "127.0.0.1:0", sessions=1, token="secret")
    try:
        client = Client(server.port, authorization="Bearer secret")
        request = message("AggregatedRenderRequest")()
        request.rgb_requests.extend(request_of(client) for _ in range(8))
        data = request.SerializeToString()
        method = client.channel.unary_unary(f"/{SERVICE}/render_aggregated")
        waiting = [method.future(data, metadata=client.metadata) for _ in range(6)]
        errors = [each.exception() for each in waiting]
        codes = [error.code().name if error else "OK" for error in errors]
        assert "OK" in codes and "RESOURCE_EXHAUSTED" in codes and {*codes} == {"OK", "RESOURCE_EXHAUSTED"}
        assert all("at most 1 calls wait or run at a time (--sessions)" in error.details() for error in errors if error)
        assert server.refused == codes.count("RESOURCE_EXHAUSTED")
        with pytest.raises(OSError, match="in use; choose another port"):
            SensorsimServer(opened, f"127.0.0.1:{server.port}")
        for wrong in (Client(server.port), Client(server.port, authorization="Bearer secre")):
            assert status_of(lambda wrong=wrong: wrong.call("get_version")) == "UNAUTHENTICATED"
            never = wrong.channel.stream_unary(f"/{SERVICE}/render_rgb")  # refused before it sends a message
            unsent = Event()
            silent = never.future(iter(unsent.wait, True), metadata=wrong.metadata, timeout=30)
            assert silent.exception().code().name == "UNAUTHENTICATED"
            unsent.set()
        with pytest.raises(ValueError, match="--token"):
            SensorsimServer(opened, "127.0.0.1:0", token="secr\u00e9t")
    finally:
        server.stop(1)


# Hostile messages


def _broken(name: str, **fields: Any) -> Any:
    def change(request: Any) -> None:
        target = request
        *parents, last = name.split(".")
        for each in parents:
            target = getattr(target, each)
        setattr(target, last, fields["value"])

    return change


BROKEN = [
    (_broken("scene_id", value="none"), "NOT_FOUND"),
    (_broken("scene_id", value="*"), "NOT_FOUND"),  # there are two
    (_broken("resolution_w", value=2**32 - 1), "INVALID_ARGUMENT"),
    (_broken("resolution_h", value=4097), "INVALID_ARGUMENT"),
    (_broken("image_quality", value=101.0), "INVALID_ARGUMENT"),
    (_broken("image_format", value=6), "UNIMPLEMENTED"),
    (_broken("image_format", value=77), "UNIMPLEMENTED"),
    (_broken("image_quality", value=float("nan")), "INVALID_ARGUMENT"),
    (_broken("insert_ego_mask", value=True), "UNIMPLEMENTED"),
    (_broken("frame_start_us", value=2**64 - 1), "INVALID_ARGUMENT"),
    (_broken("frame_end_us", value=0), "INVALID_ARGUMENT"),
    (_broken("sensor_pose.start_pose.vec.x", value=float("inf")), "INVALID_ARGUMENT"),
    (_broken("sensor_pose.start_pose.quat.w", value=1e30), "INVALID_ARGUMENT"),
    (_broken("sensor_pose.start_pose.quat.w", value=2.0), "INVALID_ARGUMENT"),
    (_broken("sensor_pose.end_pose.vec.z", value=-1e9), "INVALID_ARGUMENT"),
    (_broken("camera_intrinsics.opencv_pinhole_param.focal_length_x", value=float("nan")), "INVALID_ARGUMENT"),
    (_broken("camera_intrinsics.opencv_pinhole_param.focal_length_y", value=0.0), "INVALID_ARGUMENT"),
    (_broken("camera_intrinsics.ftheta_param.max_angle", value=float("nan")), "INVALID_ARGUMENT"),
    (lambda request: request.ClearField("sensor_pose"), "INVALID_ARGUMENT"),
    (lambda request: request.ClearField("camera_intrinsics"), "INVALID_ARGUMENT"),
    (lambda request: request.camera_intrinsics.bivariate_windshield_model_param.SetInParent(), "UNIMPLEMENTED"),
    (lambda request: request.dynamic_objects.add(track_id="car-7"), "INVALID_ARGUMENT"),
    (lambda request: with_car(with_car(request, (12, 0, 1)), (9, 0, 1)), "INVALID_ARGUMENT"),
]


@pytest.mark.parametrize("number", range(len(BROKEN)))
def test_a_wrong_field_ends_in_a_status(client: Client, number: int) -> None:
    change, status = BROKEN[number]
    request = request_of(client)
    change(request)
    assert status_of(lambda: client.call("render_rgb", request)) == status


def test_bytes_that_are_no_message_end_in_a_status(client: Client) -> None:
    rng = np.random.default_rng(0)
    sound = bytearray(with_car(request_of(client), (12, 0, 1)).SerializeToString())
    for name in calls(SERVICE):
        if calls(SERVICE)[name].request.DESCRIPTOR.full_name != "common.Empty":
            assert status_of(lambda name=name: client.raw(name, b"\xff" * 50)) == "INVALID_ARGUMENT"
    for _ in range(40):
        data = bytearray(sound)
        for place in rng.integers(0, len(data), rng.integers(1, 6)):
            data[place] = rng.integers(256)
        try:
            client.raw("render_rgb", bytes(data))
        except grpc.RpcError as error:
            assert error.code().name in ("INVALID_ARGUMENT", "NOT_FOUND", "UNIMPLEMENTED"), error.details()
    batch = message("BatchRGBRenderRequest")()
    batch.items.add(camera_name="a")
    batch.items.add(camera_name="b", request=request_of(client))
    answer = client.call("batch_render_rgb", batch)
    assert [item.success for item in answer.items] == [False, True]
    assert answer.items[0].error_message.startswith("NOT_FOUND: scene_id")
    batch.items.extend(batch.items[:1] * 64)
    assert status_of(lambda: client.call("batch_render_rgb", batch)) == "INVALID_ARGUMENT"


def test_messages_that_never_end_give_way(
    server: SensorsimServer, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert status_of(lambda: client.raw("render_rgb", bytes(MAX_REQUEST_BYTES + 1))) == "RESOURCE_EXHAUSTED"
    trimmed = Event()
    monkeypatch.setattr("gsrain_engine.simulation.serving.grpc_server.trim_memory", trimmed.set)
    monkeypatch.setattr("gsrain_engine.simulation.serving.grpc_server._FREED_S", 0.0)
    monkeypatch.setattr("gsrain_engine.simulation.serving.grpc_server._GIVES_WAY_S", 0.0)
    unsent, streams = Event(), client.channel.stream_unary(f"/{SERVICE}/render_rgb")
    silent = [streams.future(iter(unsent.wait, True), timeout=60) for _ in range(2 * RECEIVED_AT_ONCE)]
    for _ in range(3):  # these are received all the same, in place of the silent calls
        assert client.call("get_available_scenes").scene_ids
    wait_for(lambda: sum(each.done() for each in silent) >= RECEIVED_AT_ONCE)
    assert {each.code().name for each in silent if each.done()} == {"CANCELLED"}
    assert trimmed.wait(60)  # what they held is returned to the system
    monkeypatch.setattr("gsrain_engine.simulation.serving.grpc_server.RECEIVE_S", 0.0)
    late = client.channel.stream_unary(f"/{SERVICE}/render_rgb").future(iter(unsent.wait, True), timeout=60)
    assert late.exception().code().name == "CANCELLED"
    unsent.set()


# The command


def test_the_command_serves_until_it_is_asked_to_stop(tmp_path: Path) -> None:
    write_scene(scene_with_car(), tmp_path / "small")
    command = [sys.executable, "-m", "app", "serve", str(tmp_path / "small"), "--port", "0", "--backend", "cpu"]
    command += ["--json", str(tmp_path / "serve.json")]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    line = running.stdout.readline()
    assert line.startswith("small: served at 127.0.0.1:") and "(alpasim)" in line
    port = int(line.split("127.0.0.1:")[1].split()[0])
    assert json.loads((tmp_path / "serve.json").read_text())["port"] == port
    client = Client(port)
    assert client.picture(request_of(client, "small")).shape == (64, 96, 3)
    running.send_signal(signal.SIGTERM)
    rest, log = running.communicate(timeout=60)
    assert running.returncode == 0
    assert re.search(r"^\d\d:\d\d:\d\d ipv4:127.0.0.1:\d+ render_rgb small: \d+ bytes, ", log, re.MULTILINE)
    assert rest.splitlines()[-1] == "2 calls answered, 0 refused"

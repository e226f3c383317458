"""An agent behind HTTP in NeuroNCAP's form, with a small server that keeps to it, and with ones that don't."""

import base64
import contextlib
import io
import json
import socket
import threading
import time
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.street.build import street_rigs
from gsrain_engine.simulation.agents.base import Agent, CameraView, Observation, Rig
from gsrain_engine.simulation.agents.http import ClientError, HttpAgent, HttpCalls
from gsrain_engine.simulation.agents.neuroncap import neuroncap_message
from gsrain_engine.simulation.agents.registry import AgentOptions, open_agent
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.simulation import Simulation, run_drive
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState
from simulation.small_drive import longer_scene, scenario

RIG = Rig(Vehicle(), street_rigs()["nuscenes"], 1.5)


def constant_speed(asked):
    """Six points at the speed of the bus signals, as NeuroNCAP's nodes answer."""
    found = {"objects_in_bev": [[18.0, 0.0, 4.0, 2.0, 0.0]], "object_classes": ["car"], "object_scores": [0.9],
             "object_ids": [7], "future_trajs": None}  # fmt: skip
    return {"trajectory": [[0.5 * k * asked["canbus"][13], 0.0] for k in range(1, 7)], "aux_outputs": found}


class Node(ThreadingHTTPServer):
    """A model node; `answer` is what /infer gives: a function of the request, or raw bytes, or a status."""

    daemon_threads = True

    def __init__(self, answer=constant_speed, busy=0):
        super().__init__(("127.0.0.1", 0), _Request)
        self.answer, self.calls, self.messages, self.busy = answer, [], [], busy
        self.url = f"http://127.0.0.1:{self.server_address[1]}"


class _Request(BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.calls.append(("GET", self.path))
        self.server.busy -= 1
        self.reply(503 if self.server.busy >= 0 else 200, b"true")

    def do_POST(self):
        self.server.calls.append(("POST", self.path))
        body = self.rfile.read(int(self.headers["Content-Length"]))
        assert self.headers["Content-Type"] == "application/json"
        if self.path == "/reset":
            return self.reply(200, b"true")
        self.server.messages.append(json.loads(body))
        answer = self.server.answer
        if isinstance(answer, int):
            return self.reply(answer, b'{"detail": "no images"}')
        return self.reply(200, answer if isinstance(answer, bytes) else json.dumps(answer(json.loads(body))).encode())

    def reply(self, status, body):
        self.send_response(status)
        if status == 302:
            self.send_header("Location", "http://127.0.0.1:1/elsewhere")
        self.send_header("Content-Length", str(len(body)))
        with contextlib.suppress(ConnectionError):  # whoever asked may be gone
            self.end_headers()
            self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def node():
    """Starts nodes; they are closed when the test ends."""
    started = []

    def start(*arguments, **more):
        server = Node(*arguments, **more)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        started.append(server)
        return server

    yield start
    for server in started:
        server.shutdown()
        server.server_close()


def observation():
    image = np.zeros((90, 160, 3), np.uint8)
    image[3, 5] = (10, 20, 30)
    views = {"CAM_FRONT": CameraView(image, Camera(160, 90, 100.0, 100.0, 80.0, 45.0))}
    route = Route(np.array([[0.0, 0.0], [100.0, 0.0]]))
    return Observation(3, 1.5, VehicleState(4.0, 0.5, 0.2, 7.0, 0.1), -1.5, 0.3, 0.4, "right", views, route, ())


def pixels(data):
    """The bytes of a tensor's storage, read without torch."""
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(data))) as archive:
        assert archive.testzip() is None and archive.read("archive/version") == b"3\n"
        return np.frombuffer(archive.read("archive/data/0"), np.uint8)


def test_message_has_neuroncaps_names_frames_and_calibration():
    asked = json.loads(neuroncap_message(observation(), RIG))
    assert set(asked) == {"images", "ego2world", "canbus", "timestamp", "command", "calibration"}
    assert (asked["timestamp"], asked["command"]) == (1_500_000, 0)
    pose, rate = np.array(asked["ego2world"]), 7 * np.tan(0.1) / 2.7
    np.testing.assert_allclose(pose[:, [0, 3]].T[:, :2], [(np.cos(0.2), np.sin(0.2)), (4.0, 0.5)])
    np.testing.assert_allclose(
        asked["canbus"],
        (4.0, 0.5, 0, np.cos(0.1), 0, 0, np.sin(0.1), -1.5, 7 * rate, 9.8, 0, 0, rate, 7.0, 0, 0),
    )
    image = observation().views["CAM_FRONT"].image
    np.testing.assert_array_equal(pixels(asked["images"]["CAM_FRONT"]), image.ravel())
    given = {name: {"CAM_FRONT": value} if name == "lidar2ego" else value
             for name, value in asked["calibration"].items()}  # fmt: skip
    image_of, ego_of, lidar = (
        np.array(given[name]["CAM_FRONT"]) for name in ("camera2image", "camera2ego", "lidar2ego")
    )
    np.testing.assert_allclose(image_of, [[1266.4, 0, 816.3], [0, 1266.4, 491.5], [0, 0, 1]])
    np.testing.assert_allclose(ego_of[:3, 3], (1.70, 0.02, 1.51))
    # nuScenes' own: lidar at (0.94, 0, 1.84) above the road, x to the right, y forward.
    np.testing.assert_allclose(lidar @ (0, 0, 0, 1), (0.94, 0, 1.84, 1), atol=1e-9)
    np.testing.assert_allclose(lidar @ (0, 5, 0, 1), (5.94, 0, 1.84, 1), atol=1e-9)
    torch = pytest.importorskip("torch")
    tensor = torch.load(io.BytesIO(base64.b64decode(asked["images"]["CAM_FRONT"])), weights_only=True)
    np.testing.assert_array_equal(tensor.clone().numpy(), image)


def test_a_node_that_is_loading_is_waited_for_and_drives(node, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.agents.http.PAUSE_S", 0.01)
    server = node(busy=2)
    agent = open_agent("http", AgentOptions(url=server.url))
    assert isinstance(agent, Agent) and agent.name == "http"
    with pytest.raises(ClientError, match="reset"):
        agent.plan(observation())
    with open_renderer("cpu") as renderer:
        test = scenario(picture_width_px=160, duration_s=1.0, step_s=0.5, speed_m_s=8.0)
        rollout = run_drive(Simulation(test, longer_scene(), agent.needs, renderer), agent)
    agent.close()
    assert rollout.end == "time" and rollout.steps[0].notes["object_classes"] == ["car"]
    np.testing.assert_allclose(rollout.steps[0].plan, [(4.0 * k, 0.0) for k in range(1, 7)])
    assert server.calls == [("GET", "/alive")] * 3 + [("POST", "/reset"), ("POST", "/infer"), ("POST", "/infer")]
    assert [asked["timestamp"] for asked in server.messages] == [0, 500_000]
    front = pixels(server.messages[0]["images"]["CAM_FRONT"])
    assert front.size == 160 * 90 * 3 and front.mean() > 20


def test_a_node_that_is_gone_or_silent_is_not_waited_for(node):
    server = node()
    server.server_close()
    with pytest.raises(ClientError, match="/alive"):
        HttpAgent(server.url, alive_wait_s=0.1).reset(0, RIG)
    release = threading.Event()
    agent = HttpAgent(node(lambda asked: release.wait(20) and {}).url, answer_wait_s=0.2)
    agent.reset(0, RIG)
    with pytest.raises(ClientError, match=r"/infer .*0\.2 s"):
        agent.plan(observation())
    release.set()


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        (b"not json", "/infer"),
        (b'{"plan": []}', "`trajectory`"),
        (b'{"trajectory": [[1, 2, 3]]}', "pairs"),
        (b'{"trajectory": ' + b"[" * 5000 + b"]" * 5000 + b"}", "/infer"),
        (422, '422 .*: {"detail": "no images"}'),
        (302, "302"),
        (b" " * (9 << 20), "8 MiB"),
    ],
)
def test_an_answer_that_is_no_plan_is_an_error(node, answer, word):
    agent = HttpAgent(node(answer).url)
    agent.reset(0, RIG)
    with pytest.raises(ClientError, match=word):
        agent.plan(observation())


@pytest.fixture
def raw():
    """Starts servers that take in one request, answer as they like, and hold the connection until the test is over."""
    started, over = [], threading.Event()

    def start(answer):
        server = socket.create_server(("127.0.0.1", 0))

        def serve():
            with contextlib.suppress(OSError):
                connection, _ = server.accept()
                with connection:
                    connection.recv(1 << 16)
                    answer(connection, over)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        started.append((server, thread))
        return HttpCalls(f"http://127.0.0.1:{server.getsockname()[1]}")

    yield start
    over.set()
    for server, thread in started:
        server.close()
        thread.join(5)


def sent(data):
    """Send this and hang up; all of the request is taken in, else the system resets the connection over the rest."""

    def answer(connection, over):
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(1 << 16):
            pass

    return answer


HEAD, CHUNKED = b"HTTP/1.1 200 OK\r\n", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
INFORMATION = b"HTTP/1.1 100 Continue\r\n\r\n"


@pytest.mark.parametrize(("pause_s", "word"), [(0.02, r"/infer .*0\.3 s"), (0.0, "8 MiB|too long|0.3 s")])
def test_neither_a_drip_nor_a_flood_of_headers_is_read_for_ever(raw, pause_s, word):
    def answer(connection, over):
        connection.sendall(HEAD)
        while not over.wait(pause_s):
            connection.sendall(b"X-A: a\r\n")

    started = time.monotonic()
    with pytest.raises(ClientError, match=word):
        raw(answer).call("POST", "/infer", b"{}", 0.3)
    assert time.monotonic() - started < 5


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        (b"", "/infer"),
        (HEAD + b"Content-Length: 100\r\n\r\nabc", "3 bytes, expected 100"),
        (HEAD + b"Content-Length: 9000000000\r\n\r\nabc", "8 MiB"),
        (CHUNKED + b"3\r\nab", "incomplete chunked"),
        (b"HTTP/1.1 101 Switching Protocols\r\n\r\n", "/infer"),
        (b"HTTP/1.1 500 \x1b]0;x\xe2\x80\xae\r\nContent-Length: 5\r\n\r\n\x1b[31m",
         r"500 \\x1b\]0;x[^\x1b]*: \\x1b\[31m$"),
    ],
)  # fmt: skip
def test_an_answer_that_is_not_whole_is_an_error(raw, answer, word):
    with pytest.raises(ClientError, match=word):
        raw(sent(answer)).call("POST", "/infer", b"{}", 20)


@pytest.mark.parametrize(
    "answer",
    [
        HEAD + b"Content-Length: 2\r\n\r\n{}",
        HEAD + b"\r\n{}",
        b"HTTP/1.0 200 OK\r\n\r\n{}",
        INFORMATION * 3 + HEAD + b"content-length: 2\r\n\r\n{}and more",
        CHUNKED + b"1;note=a\r\n{\r\n1\r\n}\r\n0\r\nX-Trailer: a\r\n\r\n",
    ],
)
def test_whole_answers_of_every_form_are_read(raw, answer):
    assert raw(sent(answer)).call("POST", "/infer", b"{}", 20) == b"{}"


@pytest.mark.parametrize(
    "url",
    ["localhost:9000", "ftp://host", "http://", "http://host:99999", "http://host?x=1", "http://ho st", "http://h/\x1b["],
)  # fmt: skip
def test_what_is_no_address(url):
    with pytest.raises(ValueError, match="url"):
        HttpAgent(url)

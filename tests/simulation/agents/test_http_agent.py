"""An agent behind HTTP in NeuroNCAP's form, with a small server that follows it, and with ones that don't."""

import base64
import contextlib
import io
import json
import socket
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rigs import driving_rigs
from gsrain_engine.simulation.agents.base import CameraView, Observation, Rig
from gsrain_engine.simulation.agents.http import ClientError, HttpAgent, HttpCalls, read_plan
from gsrain_engine.simulation.agents.neuroncap import neuroncap_message
from gsrain_engine.simulation.agents.registry import AgentOptions, open_agent
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.simulation import Simulation, run_drive
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState
from simulation.small_drive import longer_scene, scenario

RIG = Rig(Vehicle(), driving_rigs()["nuscenes"], 1.5)


def constant_speed(asked):
    """Six points at the speed of the bus signals, as NeuroNCAP's nodes answer."""
    found = {"objects_in_bev": [[18.0, 0.0, 4.0, 2.0, 0.0]], "object_classes": ["car"], "object_scores": [0.9],
             "object_ids": [7], "future_trajs": None}  # fmt: skip
    return {"trajectory": [[0.5 * k * asked["canbus"][13], 0.0] for k in range(1, 7)], "aux_outputs": found}


class Node(BaseHTTPRequestHandler):
    """Requests to a model node, which answers 503 to the first two questions whether it is alive."""

    def do_GET(self):
        self.server.calls.append(self.path)
        self.reply(503 if len(self.server.calls) < 3 else 200, b"true")

    def do_POST(self):
        self.server.calls.append(self.path)
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        assert self.headers["Content-Type"] == "application/json"
        if self.path == "/infer":
            self.server.messages.append(body)
        self.reply(200, json.dumps(constant_speed(body)).encode() if self.path == "/infer" else b"true")

    def reply(self, status, body):
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


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
    signals = 4.0, 0.5, 0, np.cos(0.1), 0, 0, np.sin(0.1), -1.5, 7 * rate, 9.8, 0, 0, rate, 7.0, 0, 0
    np.testing.assert_allclose(asked["canbus"], signals)
    given = asked["calibration"]
    np.testing.assert_allclose(given["camera2image"]["CAM_FRONT"], [[1266.4, 0, 816.3], [0, 1266.4, 491.5], [0, 0, 1]])
    np.testing.assert_allclose(np.array(given["camera2ego"]["CAM_FRONT"])[:3, 3], (1.70, 0.02, 1.51))
    # nuScenes' own: lidar at (0.94, 0, 1.84) above the road, x to the right, y forward.
    np.testing.assert_allclose(np.array(given["lidar2ego"]) @ (0, 5, 0, 1), (5.94, 0, 1.84, 1), atol=1e-9)
    np.testing.assert_allclose(np.array(given["lidar2ego"]) @ (5, 0, 0, 1), (0.94, -5, 1.84, 1), atol=1e-9)
    image, sent = observation().views["CAM_FRONT"].image, asked["images"]["CAM_FRONT"]
    np.testing.assert_array_equal(pixels(sent), image.ravel())
    torch = pytest.importorskip("torch")
    tensor = torch.load(io.BytesIO(base64.b64decode(sent)), weights_only=True)
    np.testing.assert_array_equal(tensor.clone().numpy(), image)


def test_a_node_that_is_loading_is_waited_for_and_drives(monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.agents.http.PAUSE_S", 0.01)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Node)
    server.daemon_threads, server.calls, server.messages = True, [], []
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
    agent = open_agent("http", AgentOptions(url=f"http://127.0.0.1:{server.server_address[1]}"))
    with pytest.raises(ClientError, match="reset"):
        agent.plan(observation())
    with open_renderer("cpu") as renderer:
        test = scenario(picture_width_px=160, duration_s=1.0, step_s=0.5, speed_m_s=8.0)
        rollout = run_drive(Simulation(test, longer_scene(), agent.needs, renderer), agent)
    agent.close()
    server.shutdown()
    server.server_close()
    assert rollout.end == "time" and rollout.steps[0].notes["object_classes"] == ["car"]
    np.testing.assert_allclose(rollout.steps[0].plan, [(4.0 * k, 0.0) for k in range(1, 7)])
    assert server.calls == [*["/alive"] * 3, "/reset", "/infer", "/infer"]
    assert [asked["timestamp"] for asked in server.messages] == [0, 500_000]
    front = pixels(server.messages[0]["images"]["CAM_FRONT"])
    assert front.size == 160 * 90 * 3 and front.mean() > 20
    with pytest.raises(ClientError, match="/alive"):
        HttpAgent(f"http://127.0.0.1:{server.server_address[1]}", alive_wait_s=0.1).reset(0, RIG)


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


def with_length(data):
    return HEAD + b"Content-Length: %d\r\n\r\n" % len(data) + data


@pytest.mark.parametrize(
    ("answer", "word"),
    [
        (with_length(b"not json"), "/infer"),
        (with_length(b'{"plan": []}'), "`trajectory`"),
        (with_length(b'{"trajectory": [[1, 2, 3]]}'), "pairs"),
        (with_length(b'{"trajectory": ' + b"[" * 5000 + b"]" * 5000 + b"}"), "/infer"),
        (with_length(b" " * (9 << 20)), "8 MiB"),
        (b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/elsewhere\r\n\r\n", "302"),
        (b"", "/infer"),
        (HEAD + b"Content-Length: 100\r\n\r\nabc", "3 bytes, expected 100"),
        (HEAD + b"Content-Length: 9000000000\r\n\r\nabc", "8 MiB"),
        (CHUNKED + b"3\r\nab", "incomplete chunked"),
        (b"HTTP/1.1 101 Switching Protocols\r\n\r\n", "/infer"),
        (b"HTTP/1.1 500 \x1b]0;x\xe2\x80\xae\r\nContent-Length: 5\r\n\r\n\x1b[31m",
         r"500 \\x1b\]0;x[^\x1b]*: \\x1b\[31m$"),
    ],
)  # fmt: skip
def test_an_answer_that_is_no_whole_plan_is_an_error(raw, answer, word):
    calls = raw(sent(answer))
    with pytest.raises(ClientError, match=word):
        read_plan(calls.call("POST", "/infer", b"{}", 20), calls.url)


def test_a_drip_of_headers_is_not_read_for_ever(raw):
    def answer(connection, over):
        connection.sendall(HEAD)
        while not over.wait(0.02):
            connection.sendall(b"X-A: a\r\n")

    with pytest.raises(ClientError, match=r"/infer .*0\.3 s"):
        raw(answer).call("POST", "/infer", b"{}", 0.3)


@pytest.mark.parametrize(
    "answer",
    [
        with_length(b"{}"),
        HEAD + b"\r\n{}",
        b"HTTP/1.0 200 OK\r\n\r\n{}",
        b"HTTP/1.1 100 Continue\r\n\r\n" * 3 + with_length(b"{}") + b"and more",
        CHUNKED + b"1;note=a\r\n{\r\n1\r\n}\r\n0\r\nX-Trailer: a\r\n\r\n",
    ],
)
def test_whole_answers_of_every_form_are_read(raw, answer):
    assert raw(sent(answer)).call("POST", "/infer", b"{}", 20) == b"{}"


def test_other_addresses_are_refused():
    for url in ("localhost:9000", "ftp://host", "http://", "http://host:99999", "http://host?x=1", "http://h/\x1b["):
        with pytest.raises(ValueError, match="url"):
            HttpAgent(url)

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

import msgspec
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
from gsrain_engine.simulation.simulation import Simulation, drive
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState
from simulation.interop.road_with_lead import scenario, scene

RIG = Rig(Vehicle(), street_rigs()["nuscenes"], 1.5)


def keep_speed(asked):
    """Six points at the speed that the bus tells of, as NeuroNCAP's nodes answer."""
    speed = asked["canbus"][13]
    trajectory = [[0.5 * k * speed, 0.0] for k in range(1, 7)]
    seen = {"objects_in_bev": [[18.0, 0.0, 4.0, 2.0, 0.0]], "object_classes": ["car"], "object_scores": [0.9],
            "object_ids": [7], "future_trajs": None}  # fmt: skip
    return {"trajectory": trajectory, "aux_outputs": seen}


class Node(ThreadingHTTPServer):
    """A model node; `answer` is what /infer gives: a function of what was asked, or raw bytes, or a status."""

    daemon_threads = True

    def __init__(self, answer=keep_speed, sleepy=0):
        super().__init__(("127.0.0.1", 0), _Asked)
        self.answer, self.calls, self.asked, self.sleepy = answer, [], [], sleepy

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}"


class _Asked(BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.calls.append(("GET", self.path))
        if self.server.sleepy:
            self.server.sleepy -= 1
            self.reply(503, b"loading the model")
        else:
            self.reply(200 if self.path == "/alive" else 404, b"true")

    def do_POST(self):
        self.server.calls.append(("POST", self.path))
        body = self.rfile.read(int(self.headers["Content-Length"]))
        assert self.headers["Content-Type"] == "application/json"
        if self.path == "/reset":
            return self.reply(200, b"true")
        asked = json.loads(body)
        self.server.asked.append(asked)
        answer = self.server.answer
        if isinstance(answer, int):
            return self.reply(answer, b'{"detail": "no images"}')
        return self.reply(200, answer if isinstance(answer, bytes) else json.dumps(answer(asked)).encode())

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


def seen(**fields):
    image = np.zeros((90, 160, 3), np.uint8)
    image[3, 5] = (10, 20, 30)
    views = {"CAM_FRONT": CameraView(image, Camera(160, 90, 100.0, 100.0, 80.0, 45.0))}
    values = {
        "step": 3, "time_s": 1.5, "state": VehicleState(4.0, 0.5, 0.2, 7.0, 0.1), "acceleration_m_s2": -1.5,
        "steer_rate_rad_s": 0.3, "height_m": 0.4, "command": "right", "views": views,
        "route": Route(np.array([[0.0, 0.0], [100.0, 0.0]])), "road_users": (),
    }  # fmt: skip
    return Observation(**{**values, **fields})


def picture(data):
    """A picture as a node reads it, without torch: the bytes of the tensor's storage."""
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(data))) as archive:
        assert archive.testzip() is None and archive.read("archive/version") == b"3\n"
        return np.frombuffer(archive.read("archive/data/0"), np.uint8)


def test_message_has_neuroncaps_names_and_frames():
    asked = json.loads(neuroncap_message(seen(), RIG))
    assert set(asked) == {"images", "ego2world", "canbus", "timestamp", "command", "calibration"}
    assert (asked["timestamp"], asked["command"]) == (1_500_000, 0)
    np.testing.assert_allclose(np.array(asked["ego2world"]) @ (0, 0, 0, 1), (4.0, 0.5, 0, 1))
    np.testing.assert_allclose(np.array(asked["ego2world"])[:2, 0], (np.cos(0.2), np.sin(0.2)))
    rate = 7 * np.tan(0.1) / 2.7
    np.testing.assert_allclose(
        asked["canbus"],
        (4.0, 0.5, 0, np.cos(0.1), 0, 0, np.sin(0.1), -1.5, 7 * rate, 9.8, 0, 0, rate, 7.0, 0, 0),
    )
    np.testing.assert_array_equal(picture(asked["images"]["CAM_FRONT"]), seen().views["CAM_FRONT"].image.ravel())


def test_calibration_is_nuscenes():
    given = json.loads(neuroncap_message(seen(), RIG))["calibration"]
    assert set(given) == {"camera2image", "camera2ego", "lidar2ego"}
    np.testing.assert_allclose(given["camera2image"]["CAM_FRONT"], [[1266.4, 0, 816.3], [0, 1266.4, 491.5], [0, 0, 1]])
    np.testing.assert_allclose(np.array(given["camera2ego"]["CAM_FRONT"])[:3, 3], (1.70, 0.02, 1.51))
    # nuScenes' own: lidar at (0.94, 0, 1.84) above the road, x to the right, y forward.
    np.testing.assert_allclose(np.array(given["lidar2ego"]) @ (0, 0, 0, 1), (0.94, 0, 1.84, 1), atol=1e-9)
    np.testing.assert_allclose(np.array(given["lidar2ego"]) @ (0, 5, 0, 1), (5.94, 0, 1.84, 1), atol=1e-9)


def test_pictures_are_tensors_to_torch():
    torch = pytest.importorskip("torch")
    asked = json.loads(neuroncap_message(seen(), RIG))
    tensor = torch.load(io.BytesIO(base64.b64decode(asked["images"]["CAM_FRONT"])), weights_only=True)
    assert tuple(tensor.shape) == (90, 160, 3) and tensor.dtype == torch.uint8
    np.testing.assert_array_equal(tensor.clone().numpy(), seen().views["CAM_FRONT"].image)


def test_a_node_drives(node):
    server = node()
    agent = open_agent("http", AgentOptions(url=server.url))
    assert isinstance(agent, Agent) and agent.name == "http"
    with open_renderer("cpu") as renderer:
        asked = msgspec.structs.replace(scenario(), picture_width_px=160, duration_s=1.0, step_s=0.5)
        simulation = Simulation(asked, scene(), agent.needs, renderer)
        for _ in drive(simulation, agent):
            pass
    agent.close()
    rollout = simulation.rollout(agent.name)
    assert rollout.end == "time"
    np.testing.assert_allclose(rollout.steps[0].plan, [(4.0 * k, 0.0) for k in range(1, 7)])
    assert rollout.steps[0].notes["object_classes"] == ["car"]
    assert server.calls == [("GET", "/alive"), ("POST", "/reset"), ("POST", "/infer"), ("POST", "/infer")]
    assert [asked["timestamp"] for asked in server.asked] == [0, 500_000]
    front = picture(server.asked[0]["images"]["CAM_FRONT"])
    assert front.size == 160 * 90 * 3 and front.mean() > 20


def test_a_node_that_is_still_loading_is_waited_for(node, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.agents.http._PAUSE_S", 0.01)
    server = node(sleepy=3)
    HttpAgent(server.url).reset(0, RIG)
    assert server.calls == [("GET", "/alive")] * 4 + [("POST", "/reset")]


def test_nobody_is_there(node):
    server = node()
    url = server.url
    server.shutdown()
    server.server_close()
    with pytest.raises(ClientError, match=r"nobody is there within 0\.1 s: .*/alive can't be reached"):
        HttpAgent(url, alive_wait_s=0.1).reset(0, RIG)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"not json", "answers what is no plan"),
        (b'{"plan": []}', "missing required field `trajectory`"),
        (b'{"trajectory": [[NaN, 1]]}', "answers what is no plan"),
        (b'{"trajectory": [[1, 2, 3]]}', "not of pairs"),
        (b'{"trajectory": []}', r"shape \(0, 2\)"),
        (b'{"trajectory": [[1e7, 0]]}', "farther than 10 km"),
        (b'{"trajectory": ' + b"[" * 5000 + b"]" * 5000 + b"}", "answers what is no plan"),
        (422, 'answers 422 .*: {"detail": "no images"}'),
        (302, "answers 302"),
        (b" " * (9 << 20), "answers more than 8 MiB"),
    ],
)
def test_what_is_no_plan_is_said(node, answer, why):
    agent = HttpAgent(node(answer).url)
    agent.reset(0, RIG)
    with pytest.raises(ClientError, match=why):
        agent.plan(seen())


def test_a_silent_node_is_not_waited_for_for_ever(node):
    release = threading.Event()
    server = node(lambda asked: release.wait(20) and {})
    agent = HttpAgent(server.url, answer_wait_s=0.2)
    agent.reset(0, RIG)
    with pytest.raises(ClientError, match=r"/infer has not answered within 0\.2 s"):
        agent.plan(seen())
    release.set()


class Raw:
    """A server that takes in one request and then does with the connection what it likes, until the test is over."""

    def __init__(self, answer):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        self.over = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(answer,), daemon=True)
        self._thread.start()

    def _serve(self, answer):
        with contextlib.suppress(OSError):
            connection, _ = self._server.accept()
            with connection:
                connection.recv(1 << 16)
                answer(connection, self.over)

    def close(self):
        self.over.set()
        self._server.close()
        self._thread.join(5)


@pytest.fixture
def raw():
    started = []

    def start(answer):
        started.append(Raw(answer))
        return HttpCalls(started[-1].url)

    yield start
    for each in started:
        each.close()


def sent(data):
    """Send this and hang up; all of the request is taken in, else the system resets the connection over the rest."""

    def answer(connection, over):
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(1 << 16):
            pass

    return answer


def dripped(start, piece):
    """Send one piece every 20 ms, whose bytes each come within any time that a single read may take."""

    def answer(connection, over):
        connection.sendall(start)
        while not over.wait(0.02):
            connection.sendall(piece)

    return answer


def flooded(start, piece):
    """Send pieces without a pause, and without an end."""

    def answer(connection, over):
        connection.sendall(start)
        while not over.is_set():
            connection.sendall(piece * 1000)

    return answer


HEAD, CHUNKED = b"HTTP/1.1 200 OK\r\n", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
INFORMATION = b"HTTP/1.1 100 Continue\r\n\r\n"


@pytest.mark.parametrize(
    ("start", "piece"),
    [
        (b"", b""),
        (b"", b"H"),
        (b"HTTP/1.1 200 ", b"O"),
        (HEAD + b"X-A: ", b"a"),
        (HEAD, b"X-A: a\r\n"),
        (b"", INFORMATION),
        (HEAD + b"Content-Length: 1000\r\n\r\n", b"a"),
        (HEAD + b"\r\n", b"a"),
        (CHUNKED, b"1"),
        (CHUNKED, b"1\r\na\r\n"),
        (CHUNKED + b"1;", b"a"),
        (CHUNKED + b"0\r\n", b"X: a\r\n"),
    ],
    ids=(
        "nothing", "status", "reason", "header", "headers", "100 continue", "body", "body without length", "chunk size",
        "chunks", "chunk extension", "trailers",
    ),
)  # fmt: skip
def test_a_drip_is_not_waited_for(raw, start, piece):
    calls = raw(dripped(start, piece))
    started = time.monotonic()
    with pytest.raises(ClientError, match=r"/infer has not answered within 0\.3 s"):
        calls.call("POST", "/infer", b"{}", 0.3)
    assert time.monotonic() - started < 5


@pytest.mark.parametrize(
    ("start", "piece"),
    [
        (HEAD + b"X-A: ", b"a"),
        (HEAD, b"X-A: a\r\n"),
        (b"", INFORMATION),
        (HEAD + b"\r\n", b"a"),
        (CHUNKED, b"a\r\n0123456789\r\n"),
        (CHUNKED + b"1;", b"a"),
        (CHUNKED + b"0\r\n", b"X: a\r\n"),
    ],
    ids=("header", "headers", "100 continue", "body", "chunks", "chunk extension", "trailers"),
)
def test_a_flood_ends_at_the_budget(raw, start, piece, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.agents.http._MAX_BYTES", 1 << 20)
    with pytest.raises(ClientError, match=r"answers (more than 1 MiB|what is no whole HTTP: .*too long)"):
        raw(flooded(start, piece)).call("POST", "/infer", b"{}", 30)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"", "no whole HTTP: it hangs up before it has answered"),
        (b"\x1b[31m\r\n\r\n", "no whole HTTP"),
        (HEAD + b"Content-Length: 100\r\n\r\nabc", r"no whole HTTP: .*received 3 bytes, expected 100"),
        (HEAD + b"Content-Length: -1\r\n\r\nabc", "no whole HTTP"),
        (HEAD + b"Content-Length: 100000000000000000000\r\n\r\nabc", "no whole HTTP|more than 8 MiB"),
        (HEAD + b"Content-Length: 9000000000\r\n\r\nabc", "answers more than 8 MiB"),
        (HEAD + b"Content-Length: 3\r\nContent-Length: 4\r\n\r\nabcd", "no whole HTTP: .*conflicting"),
        (HEAD + b"Content-Length: three\r\n\r\nabc", "no whole HTTP"),
        (CHUNKED + b"3\r\nab", "no whole HTTP: .*incomplete chunked"),
        (CHUNKED + b"-3\r\nabc\r\n0\r\n\r\n", "no whole HTTP"),
        (HEAD + b"Transfer-Encoding: gzip\r\n\r\nabc", "no whole HTTP"),
        (b"HTTP/1.1 101 Switching Protocols\r\n\r\n", "no whole HTTP"),
        (
            b"HTTP/1.1 500 \x1b]0;x\xe2\x80\xae\r\nContent-Length: 5\r\n\r\n\x1b[31m",
            r"answers 500 \\x1b\]0;x[^\x1b]*: \\x1b\[31m$",
        ),
        (b"HTTP/1.1 503 Busy\r\nContent-Length: 5\r\n\r\n\x1b[31m", r"answers 503 Busy: \\x1b\[31m$"),
    ],
)
def test_what_is_no_whole_answer_is_an_error(raw, answer, why):
    with pytest.raises(ClientError, match=why):
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


def test_a_server_that_does_not_read_is_not_waited_for(raw):
    calls = raw(lambda connection, over: over.wait(20))
    with pytest.raises(ClientError, match=r"/infer has not answered within 0\.3 s"):
        calls.call("POST", "/infer", bytes(1 << 25), 0.3)


@pytest.mark.parametrize(
    "url",
    [
        "localhost:9000",
        "ftp://host",
        "http://",
        "http://host:99999",
        "http://host?x=1",
        "http://ho st",
        "http://host/\x1b[31m",
    ],
)
def test_what_is_no_address(url):
    with pytest.raises(ValueError, match="url"):
        HttpAgent(url)


def test_an_address_must_be_given():
    with pytest.raises(ValueError, match="--url http://HOST:PORT"):
        open_agent("http")

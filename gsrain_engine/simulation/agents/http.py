"""HTTP agent in NeuroNCAP's protocol, for its UniAD and VAD model nodes or custom servers."""

import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import h11
import msgspec
import numpy as np
from jaxtyping import Float64

from ...safe_io.limits import ByteBudget, Deadline, ServerConnection, TooLargeError
from ...safe_io.text_files import printable_line
from .base import FARTHEST_M, Observation, Rig, SensorRequirements, Trajectory
from .neuroncap import neuroncap_message

ALIVE_WAIT_S, ANSWER_WAIT_S = 120.0, 60.0
"""Timeouts for the server to start, and for each reply."""

_TRY_S, PAUSE_S = 5.0, 0.5
_MAX_OBJECTS = 100


class _Objects(msgspec.Struct, frozen=True):
    """Detections of the stack, for the record: boxes x, y, length, width, yaw in the ego frame, classes, scores."""

    objects_in_bev: list[list[float]] | None = None
    object_classes: list[str] | None = None
    object_scores: list[float] | None = None


class _Reply(msgspec.Struct, frozen=True):
    trajectory: list[list[float]]
    aux_outputs: _Objects | None = None


class HttpAgent:
    """Queries a server: `GET /alive` until it responds, `POST /reset` for a new drive, `POST /infer` for each plan.

    Trajectories are x forward, y left, in meters, 0.5 s apart, of the rear axle, like `Trajectory`. Model nodes expect
    nuScenes' image size and camera names: use the rig `nuscenes`, 1600 px wide, and steps of 0.5 s.
    """

    name = "http"
    needs = SensorRequirements(("all",))

    def __init__(self, url: str, alive_wait_s: float = ALIVE_WAIT_S, answer_wait_s: float = ANSWER_WAIT_S) -> None:
        """Prepare queries to the server at `url` (http://HOST:PORT). Raises ValueError for an invalid address."""
        self._calls = HttpCalls(url)
        self._alive_wait_s, self._answer_wait_s = alive_wait_s, answer_wait_s
        self._rig: Rig | None = None

    def reset(self, seed: int, rig: Rig) -> None:
        """Start a drive. Raises ClientError if the server does not start or refuses."""
        until = time.monotonic() + self._alive_wait_s
        while True:
            try:
                self._calls.call("GET", "/alive", None, min(_TRY_S, self._alive_wait_s))
                break
            except ClientError as problem:
                if time.monotonic() + PAUSE_S > until:
                    raise ClientError(f"nobody is there within {self._alive_wait_s:g} s: {problem}") from None
            time.sleep(PAUSE_S)
        self._calls.call("POST", "/reset", b"{}", self._answer_wait_s)
        self._rig = rig

    def plan(self, observation: Observation) -> Trajectory:
        """Return the server's plan. Raises ClientError for a missing or invalid reply."""
        if self._rig is None:
            raise ClientError("there is no drive: reset the agent first")
        message = neuroncap_message(observation, self._rig)
        data = self._calls.call("POST", "/infer", message, self._answer_wait_s)
        return read_plan(data, self._calls.url)

    def close(self) -> None:
        """Do nothing: the server waits for the next `/reset`."""


def read_plan(data: bytes, url: str) -> Trajectory:
    """Parse a server's reply to `/infer`. Raises ClientError for an invalid plan."""
    try:
        reply = msgspec.json.decode(data, type=_Reply)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as problem:
        raise ClientError(f"{url}/infer answers what is no plan: {printable_line(problem)}") from None
    found = reply.aux_outputs
    notes = {}
    if found is not None and found.objects_in_bev:
        notes = {name: (value or [])[:_MAX_OBJECTS] for name, value in msgspec.structs.asdict(found).items()}
    return Trajectory(plan_points(reply.trajectory, url), notes)


# HTTP calls: one deadline and one size limit for a whole call

MAX_BYTES = 8 << 20  # maximum size of everything that a server sends, including headers
_PORTS = {"http": 80, "https": 443}
_FAILURE_CHARACTERS = 200


class HttpCalls:
    """HTTP client of one server, with a connection per call; no redirects, no proxies."""

    def __init__(self, url: str) -> None:
        """Parse the address. Raises ValueError if it is invalid."""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as problem:
            raise ValueError(f"url {printable_line(url)}: {problem}") from None
        is_plain = url.isascii() and url.isprintable() and " " not in url
        if parts.scheme not in _PORTS or not host or parts.query or parts.fragment or not is_plain:
            raise ValueError(f"url {printable_line(url)}: expected http://HOST:PORT")
        self.url = url.rstrip("/")
        self._secure, self._path = parts.scheme == "https", parts.path.rstrip("/")
        self._host, self._port = host, port or _PORTS[parts.scheme]
        self._named = parts.netloc.rpartition("@")[2]

    def call(self, method: str, path: str, body: bytes | None, within_s: float) -> bytes:
        """Send a request, a body as JSON; returns the body of a reply with status 200.

        Raises ClientError for a missing, late, too long or truncated reply, or another status.
        """
        where = f"{self.url}{path}"
        try:
            reply, data = self._exchange(method, path, body, Deadline(within_s))
        except TimeoutError:
            raise ClientError(f"{where} has not answered within {within_s:g} s") from None
        except TooLargeError:
            raise ClientError(f"{where} answers more than {MAX_BYTES >> 20} MiB") from None
        except OSError as problem:
            raise ClientError(f"{where} can't be reached: {problem.strerror or problem}") from None
        except h11.RemoteProtocolError as problem:
            raise ClientError(f"{where} answers what is no whole HTTP: {printable_line(problem)}") from None
        if reply.status_code != 200:
            words = printable_line(data.decode(errors="replace"), _FAILURE_CHARACTERS)
            reason = printable_line(reply.reason.decode("latin-1"), _FAILURE_CHARACTERS)
            raise ClientError(f"{where} answers {reply.status_code} {reason}: {words}")
        return data

    def _exchange(self, method: str, path: str, body: bytes | None, deadline: Deadline) -> tuple[h11.Response, bytes]:
        http = h11.Connection(h11.CLIENT)
        headers = [("Host", self._named), ("Accept-Encoding", "identity"), ("Connection", "close")]
        if body is not None:
            headers += [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        asked = [http.send(h11.Request(method=method, target=self._path + path, headers=headers))]
        asked += [http.send(h11.Data(data=body))] if body else []
        asked += [http.send(h11.EndOfMessage())]
        budget = ByteBudget(MAX_BYTES, self.url)
        wire = ServerConnection(self._host, self._port, deadline, budget, is_secure=self._secure)
        try:
            for part in asked:
                wire.send(part or b"")
            reply, data = None, bytearray()
            for event in _events(http, wire, deadline):
                if isinstance(event, h11.Response):
                    reply = event
                    for header, value in reply.headers:
                        if header == b"content-length":
                            ByteBudget(MAX_BYTES, self.url).spend(int(value))
                elif isinstance(event, h11.Data):
                    data += event.data
        finally:
            wire.close()
        assert reply is not None, "a message ends after it has begun"
        return reply, bytes(data)


def _events(http: h11.Connection, wire: ServerConnection, deadline: Deadline) -> Iterator[h11.Event]:
    """Yield events up to the end of the message; each read is under the deadline."""
    while True:
        deadline.check()
        event = http.next_event()
        if event is h11.NEED_DATA:
            data = wire.receive()
            if not data and http.their_state is h11.SEND_RESPONSE:
                raise h11.RemoteProtocolError("it hangs up before it has answered")
            http.receive_data(data)
        elif isinstance(event, h11.EndOfMessage):
            return
        elif isinstance(event, h11.Event):
            yield event
        else:
            raise h11.RemoteProtocolError("it goes over to another protocol")


class ClientError(ValueError):
    """The external agent has ended, does not respond, or returned an invalid plan, so the drive can't continue."""


_MAX_POINTS = 1000


def plan_points(value: Any, who: str) -> Float64[np.ndarray, "n 2"]:
    """Return a plan from a numeric array (N, 2) or a list of pairs, finite and within reach.

    Raises ClientError that describes the invalid data of `who`.
    """
    if isinstance(value, list):
        rows: list[Any] = value
        if not all(_is_pair(row) for row in rows):
            raise ClientError(f"{who} sent a plan that is a list, but not of pairs of numbers")
        value = np.array([[float(each) for each in row] for row in rows], np.float64).reshape(-1, 2)
    if not isinstance(value, np.ndarray):
        raise ClientError(f"{who} sent a {type(value).__name__} for a plan, not an array of points (N, 2)")
    points = np.asarray(value, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= _MAX_POINTS:
        raise ClientError(f"{who} sent a plan of shape {points.shape}, not (N, 2) with N from 1 to {_MAX_POINTS}")
    if not np.isfinite(points).all():
        raise ClientError(f"{who} sent a plan with points that are not finite")
    if np.abs(points).max() > FARTHEST_M:
        raise ClientError(f"{who} sent a plan with points farther than {FARTHEST_M / 1000:g} km")
    return points


def _is_pair(row: Any) -> bool:
    if not isinstance(row, list):
        return isinstance(row, np.ndarray) and row.shape == (2,)
    pair: list[Any] = row
    return len(pair) == 2 and all(isinstance(each, int | float) and abs(each) < 1e300 for each in pair)

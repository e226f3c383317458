"""Doors of the servers: each is opened, gets hostile messages, and has to serve a sound client as before."""

import logging
import multiprocessing
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any
from urllib.parse import urlsplit

import msgspec
import psutil

import gsrain as gr
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.simulation.serving.grpc_server import RenderServer
from gsrain_engine.simulation.serving.scenes import ServedScenes
from small_scene import small_scene

from .mutations import _FLOATS, _INTEGERS, _WORDS, damaged_bytes

REFUSALS = {
    "INVALID_ARGUMENT", "NOT_FOUND", "UNIMPLEMENTED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION", "UNAUTHENTICATED",
    "CANCELLED", "DEADLINE_EXCEEDED",
}  # fmt: skip
"""Statuses that a hostile call may end with; others, such as INTERNAL and UNAVAILABLE, are findings."""
TOKEN = "a-token"
_PATIENCE_S, COMPILING_S = 5.0, 600.0
_CHECKED_EVERY = 100
_HANGING = 20  # connections that a hostile client leaves open at a time


class Attack:
    """A hostile client and a sound one of an open door."""

    def send(self, chance: Random) -> int:
        """Send hostile messages; returns their number. Raises `AssertionError` if one is answered as none should be."""
        raise NotImplementedError

    def check_others(self) -> None:
        """Raise unless the sound client gets what it got at first."""
        raise NotImplementedError

    def close(self) -> None:
        """Close all connections."""


@dataclass(frozen=True)
class Door:
    """A server and its attack; `open` yields the server's address, which may be in another process."""

    name: str
    package: str
    """Module that it needs."""
    open: Callable[[], Any]
    attack: Callable[[str], Attack]
    limit_bytes: int
    """Memory that hostile messages may take beyond what the server needs for sound ones."""


# gRPC


@contextmanager
def open_grpc(kind: type[RenderServer[Any]], scenes_kind: type[ServedScenes]) -> Iterator[str]:
    def opened() -> ServedScenes:
        scenes = scenes_kind("cpu")
        scenes.add("dry", small_scene(), RainSimulation.start(RainSettings(intensity_mm_h=0.0)))
        scenes.add("rainy", small_scene(), RainSimulation.start(RainSettings(intensity_mm_h=20.0)))
        return scenes

    server = kind(opened, "127.0.0.1:0", sessions=8, token=TOKEN)
    try:
        yield f"127.0.0.1:{server.port}"
    finally:
        server.stop(1)


class GrpcAttack(Attack):
    """Calls with damaged messages, whose fields are hostile numbers and words, or whose bytes are anything."""

    hanging_method: str
    """Of calls that are begun and left so."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._channel = self.connected()
        self._sound = self.connected()
        self._expected: bytes | None = None
        self._hanging: list[socket.socket] = []

    def connected(self) -> Any:
        import grpc

        options = [("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", -1)]
        return grpc.insecure_channel(self._address, options)

    def call(
        self, channel: Any, method: str, data: bytes, token: str = TOKEN, patience_s: float = _PATIENCE_S
    ) -> tuple[str, bytes]:
        """Status and answer of a call."""
        import grpc

        metadata = [("authorization", f"Bearer {token}")]
        try:
            return "OK", channel.unary_unary(f"/{method}")(data, metadata=metadata, timeout=patience_s)
        except grpc.RpcError as error:
            assert len(error.details() or "") < 400 and "Traceback" not in (error.details() or ""), error.details()
            return error.code().name, b""

    def hostile(self, chance: Random) -> tuple[str, Any]:
        """Method and message of a hostile call."""
        raise NotImplementedError

    def sound(self, channel: Any) -> bytes:
        """Answer to a sound client."""
        raise NotImplementedError

    def send(self, chance: Random) -> int:
        kind = chance.random()
        if kind < 0.03:
            self._hang(chance)
            return 1
        if kind < 0.06:
            self._channel.close()
            self._channel = self.connected()
        method, sent = self.hostile(chance)
        if chance.random() < 0.7:
            damage_message(sent, chance)
            data = sent.SerializeToString()
        else:
            data = damaged_bytes(sent.SerializeToString(), chance)
        if chance.random() < 0.002:
            data += bytes(70 << 20)
        status, _ = self.call(self._channel, method, data, TOKEN if chance.random() < 0.95 else "another")
        assert status in REFUSALS | {"OK"}, f"{method} ends with {status}: {data[:2000].hex()}"
        return 1

    def _hang(self, chance: Random) -> None:
        """Begin to send something, and leave it so."""
        host, _, port = self._address.rpartition(":")
        plug = socket.create_connection((host, int(port)), _PATIENCE_S)
        plug.setblocking(False)
        with suppress(OSError):
            plug.send(half_sent_call(self.hanging_method, TOKEN))
            if chance.random() < 0.5:
                plug.send(damaged_bytes(bytes(9) * 20, chance))
        self._hanging.append(plug)
        while len(self._hanging) > _HANGING:
            self._hanging.pop(0).close()

    def check_others(self) -> None:
        found = self.sound(self._sound)
        assert found and (self._expected is None or found == self._expected), "another client gets another answer"
        self._expected = found

    def close(self) -> None:
        for each in (*self._hanging, self._channel, self._sound):
            each.close()


def damage_message(sent: Any, chance: Random) -> None:
    """Set a few fields of a message, or of one inside of it, to hostile values."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        _damage_field(sent, chance, 0)


def _damage_field(sent: Any, chance: Random, depth: int) -> None:
    if not sent.DESCRIPTOR.fields:
        return
    field = chance.choice(sent.DESCRIPTOR.fields)
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        return
    repeated = field.is_repeated if hasattr(field, "is_repeated") else field.label == field.LABEL_REPEATED
    if field.message_type is not None:
        rows = getattr(sent, field.name)
        inside = rows
        if repeated:
            inside = chance.choice(rows) if len(rows) and chance.random() < 0.8 else rows.add()
        if depth < 6:
            _damage_field(inside, chance, depth + 1)
        return
    value = _hostile_value(field, chance)
    with suppress(ValueError, TypeError):  # beyond its range
        if repeated:
            getattr(sent, field.name).extend([value] * chance.choice((1, 4, 6, 100)))
        else:
            setattr(sent, field.name, value)


def _hostile_value(field: Any, chance: Random) -> Any:
    if field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT):
        return chance.choice((*_FLOATS, 1e308, 1e30))
    if field.cpp_type == field.CPPTYPE_STRING:
        return chance.choice([word for word in _WORDS if word.isascii()])
    if field.cpp_type == field.CPPTYPE_BOOL:
        return chance.random() < 0.5
    return chance.choice(_INTEGERS)


def half_sent_call(method: str, token: str, length: int = 15 << 20, sent: int = 30_000) -> bytes:
    """Beginning of a call of gRPC (HTTP/2, RFC 9113), of whose message only a part is sent."""
    names = {":method": "POST", ":scheme": "http", ":path": f"/{method}", ":authority": "a", "te": "trailers",
             "content-type": "application/grpc", "authorization": f"Bearer {token}"}  # fmt: skip
    block = b"".join(b"\x00" + bytes([len(a)]) + a.encode() + bytes([len(b)]) + b.encode() for a, b in names.items())
    data = struct.pack(">BI", 0, length) + bytes(sent)
    frames = _frame(4, 0, 0, b"") + _frame(1, 4, 1, block)
    parts = [data[at : at + 16_384] for at in range(0, len(data), 16_384)]
    return b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frames + b"".join(_frame(0, 0, 1, part) for part in parts)


def _frame(kind: int, flags: int, stream: int, body: bytes) -> bytes:
    return struct.pack(">I", len(body))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + body


# The page for browsers


@contextmanager
def _open_page() -> Iterator[str]:
    with gr.BrowserViewer(small_scene(), gr.Rain(3), backend="cpu", port=0, browsers=4, token=TOKEN) as page:
        yield page.url


class _Page(Attack):
    """Messages over WebSocket, each over a connection of its own that knows the token."""

    def __init__(self, url: str) -> None:
        from python_api.test_browser import Browser

        self._url = url
        camera = gr.home_camera(small_scene(), (48, 32))
        self._sound = Browser(url, camera)
        self._cameras, self._shown = [camera, gr.home_camera(small_scene(), (32, 48))], 0
        assert self._sound.shows(gr.render(small_scene(), gr.Rain(3), camera, backend="cpu").rgb.astype(int))

    def send(self, chance: Random) -> int:
        from websockets.exceptions import WebSocketException

        from python_api.test_browser import connected

        count = chance.choice((1, 1, 1, 30))
        with suppress(WebSocketException, OSError, EOFError, TimeoutError), connected(self._url) as connection:
            for _ in range(count):
                connection.send(self._hostile(chance))
            if chance.random() < 0.3:
                connection.recv(0.01)
        return count

    def _hostile(self, chance: Random) -> bytes | str:
        pose = {"wxyz": [1.0, 0, 0, 0], "position": [0.0, 0, 2], "look_at": [1.0, 0, 2], "up_direction": [0.0, 0, 1],
                "fov": 1.0, "near": 0.01, "far": 100.0, "image_height": 32, "image_width": 48}  # fmt: skip
        control = chance.choice([*self._sound.controls.values(), "none"])
        kind = chance.random()
        if kind < 0.05:
            return chance.choice(("{}", "x" * 20_000))
        if kind < 0.35:
            sent: dict[str, Any] = {"type": "ViewerCameraMessage", **pose}
            name = chance.choice([*pose])
            sent[name] = chance.choice(
                (None, "x", [], [1.0] * 3, [1.0] * 5, [[[]]], *_FLOATS, [chance.choice(_FLOATS)] * 3)
            )
        elif kind < 0.65:
            value = chance.choice((None, [], [1.0] * 2, [1.0] * 3, [1] * 3000, True, 5, "x", "9" * 5000, {}, *_FLOATS))
            name = chance.choice(("value", "value", "value", "update_cb", "removed", "uuid", "gui_api"))
            sent = {"type": "GuiUpdateMessage", "uuid": control, "updates": {name: value}}
        else:
            names = [each.__name__ for each in import_module("viser._messages").Message.get_subclasses()]
            sent = {"type": chance.choice((*names, "x")), "uuid": control, "source_component_uuid": control}
            sent |= {"transfer_uuid": "t", "filename": "f", "mime_type": "", "part_count": 0, "size_bytes": 1 << 40}
        data = msgspec.msgpack.encode(sent)
        if chance.random() < 0.3:
            data = damaged_bytes(data, chance)
        return data + bytes(1 << 20) if chance.random() < 0.01 else data

    def check_others(self) -> None:
        """Look through another camera; rain and time are those that any browser has set."""
        self._shown = 1 - self._shown
        self._sound.set("Play", False)
        self._sound.look(self._cameras[self._shown])
        camera = self._cameras[self._shown]
        assert any(found.shape[:2] == (camera.height, camera.width) for found in self._sound.pictures())

    def close(self) -> None:
        self._sound.connection.close()


class _Requests(Attack):
    """Requests of HTTP, and beginnings of some, of strangers to the page."""

    def __init__(self, url: str) -> None:
        self._url = urlsplit(url)
        self._hanging: list[socket.socket] = []

    def send(self, chance: Random) -> int:
        host = f"localhost:{self._url.port}"
        path = chance.choice(
            (self._url.path, "/", "/x", "/..", f"{self._url.path}/../..", f"{self._url.path}/%00", "/" + "a" * 9000)
        )
        method, origin = chance.choice(("GET", "POST", "PUT", "CONNECT")), chance.choice(("null", f"http://{host}"))
        lines = [
            f"{method} {path} HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13", f"Origin: {origin}", "", "",
        ]  # fmt: skip
        sound = "\r\n".join(lines).encode()
        plug = socket.create_connection(("127.0.0.1", self._url.port), _PATIENCE_S)
        plug.settimeout(_PATIENCE_S)
        with suppress(OSError):
            plug.sendall(
                sound[: chance.randrange(len(sound))] if chance.random() < 0.4 else damaged_bytes(sound, chance)
            )
        self._hanging.append(plug)
        while len(self._hanging) > _HANGING:
            self._hanging.pop(0).close()
        return 1

    def check_others(self) -> None:
        connection = HTTPConnection("localhost", self._url.port, timeout=60)
        connection.request("GET", self._url.path)
        answer = connection.getresponse()
        assert answer.status == 200 and b"<html" in answer.read(1000)
        connection.close()

    def close(self) -> None:
        for each in self._hanging:
            each.close()


def _doors() -> Iterator[Door]:
    """Doors of the extras, each in the folder of its tests, and those of pages."""
    for each in sorted(Path(__file__).parents[1].glob("extras/*/door.py")):
        yield import_module(f"tests.extras.{each.parent.name}.door").DOOR
    yield Door("page-messages", "viser", _open_page, _Page, 200 << 20)
    yield Door("page-requests", "viser", _open_page, _Requests, 200 << 20)


DOORS = {door.name: door for door in _doors()}
"""By name."""


# Campaigns


def campaign(name: str, messages: int, seed: int) -> tuple[int, str | None]:
    """Send hostile messages to a door in a process of its own; others have to be served, its memory to be bounded.

    Returns the server's largest growth in bytes, and what was found, if anything.
    """
    door, context = DOORS[name], multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=_serve, args=(name, theirs), daemon=True)
    server.start()
    growth = 0
    try:
        attack = door.attack(ours.recv())
        attack.check_others()
        process = psutil.Process(server.pid)
        before = process.memory_info().rss
        sent = checked = 0
        while sent < messages:
            try:
                sent += attack.send(Random(seed + sent))
                if sent >= checked + _CHECKED_EVERY:
                    attack.check_others()
                    checked = sent
            except Exception as error:
                return growth, f"message {sent}: {type(error).__name__}: {error}"
            if server.exitcode is not None:
                return growth, f"message {sent}: the server has ended, exit code {server.exitcode}"
            growth = max(growth, process.memory_info().rss - before)
            if growth > door.limit_bytes:
                return growth, f"message {sent}: the server has grown by {growth >> 20} MB"
        attack.close()
    finally:
        server.kill()
        server.join()
    return growth, None


def _serve(name: str, address: Any) -> None:
    logging.disable()
    with DOORS[name].open() as found:
        address.send(found)
        address.recv()

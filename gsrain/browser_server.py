"""Server of the page for browsers: viser's, behind checks of the address, of each message, and limits.

Viser opens a public tunnel, takes files and sets any attribute of a control for whoever asks. Here a stranger gets
nothing without the token in the address, other pages of the same browser are refused by their origin, and a browser
sends nothing but its camera and values of controls.
"""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Annotated, Any
from urllib.parse import unquote, urlsplit

import msgspec

from gsrain_engine.safe_io.limits import is_same_token

HOST = "127.0.0.1"
"""Address of the page: other machines are not let in."""
MAX_MESSAGE_BYTES = 16 * 1024
"""Largest message of a browser; a camera has 400 bytes."""

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_HANDSHAKE_S, _CLOSING_S = 10.0, 2.0
_MAX_HANDSHAKES = 64  # connections that have not sent their request; the oldest gives way
_SPARE = 8  # connections beyond the browsers that are shown the page: they learn that it is full
_PER_S, _BURST = 100.0, 200.0  # messages of a browser; viser's page sends at most 50 cameras per second
_LARGEST = 1e9
_LONGEST_WORD = 200

_Vector = tuple[float, float, float]
_Word = Annotated[str, msgspec.Meta(max_length=_LONGEST_WORD)]


class _CameraSent(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage", frozen=True, forbid_unknown_fields=True):
    """Camera of a browser."""

    wxyz: tuple[float, float, float, float]
    position: _Vector
    fov: float
    near: float
    far: float
    image_height: float
    image_width: float
    look_at: _Vector
    up_direction: _Vector


class _NewValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    value: bool | int | float | _Word | tuple[float, ...]


class _ValueSent(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage", frozen=True, forbid_unknown_fields=True):
    """New value of a control."""

    uuid: _Word
    updates: _NewValue


_MESSAGES = msgspec.msgpack.Decoder(_CameraSent | _ValueSent)
_opening = threading.Lock()


def open_page_server(port: int, token: str, browsers: int, control: Callable[[str], Any]) -> Any:
    """Open viser's server at a port of this machine, 0 for any free one, for addresses with a token.

    `control` returns viser's control of a uuid, None without one. A browser that sends anything but a camera and a
    value that fits its control is disconnected; others notice nothing. Raises `ImportError` without viser, and for a
    version whose server can't be guarded.
    """
    viser: Any = import_module("viser")
    sockets: Any = import_module("websockets.asyncio.server")
    guard = _Guard(token, f"viser-v{viser.__version__}", browsers, control, sockets)
    with _opening:  # viser has no argument for it
        serve = sockets.serve
        sockets.serve = partial(guard.serve, serve)
        try:
            server = viser.ViserServer(host=HOST, port=port, label="GSRAIN", verbose=False)
        finally:
            sockets.serve = serve
    if not guard.is_installed:
        server.stop()
        raise ImportError(f"viser {viser.__version__} can't be guarded: pip install 'viser==1.1.1'")
    return server


class _Guard:
    """Checks of all that reaches a server of viser. All but `serve` runs in the server's own thread."""

    def __init__(self, token: str, protocol: str, browsers: int, control: Callable[[str], Any], sockets: Any) -> None:
        self.is_installed = False
        self._token, self._protocol, self._control, self._sockets = token, protocol, control, sockets
        self._limit = browsers + _SPARE
        self._arriving: dict[Any, None] = {}
        self._open: set[Any] = set()

    def serve(self, serve: Callable[..., Any], handler: Any, *place: Any, **options: Any) -> Any:
        """Call `websockets.serve` with the checks, if it is viser that does."""
        if not handler.__module__.startswith("viser."):
            return serve(handler, *place, **options)
        self.is_installed = True
        options |= {
            "process_request": partial(self._answer, options["process_request"]),
            "create_connection": self._connection_class(), "max_size": MAX_MESSAGE_BYTES, "max_queue": 4,
            "open_timeout": _HANDSHAKE_S, "close_timeout": _CLOSING_S,
        }  # fmt: skip
        return serve(handler, *place, **options)

    def _connection_class(self) -> Any:
        guard, plain = self, self._sockets.ServerConnection

        class Connection(plain):
            """Connection of a browser."""

            def connection_made(self, transport: Any) -> None:
                guard.arrive(self)
                super().connection_made(transport)
                self.pace = _Pace()

            def connection_lost(self, exc: Exception | None) -> None:
                guard.leave(self)
                super().connection_lost(exc)

            async def recv(self, decode: bool | None = None) -> bytes:
                """Return the next sound message; one that is not ends the connection."""
                while True:
                    await self.pace.wait()
                    data = await super().recv(decode)
                    try:
                        message = guard.checked(data)
                    except ValueError as error:
                        await self.close(1008, str(error)[:100])
                        raise self.protocol.close_exc from None
                    if message is not None:
                        return message

        return Connection

    def arrive(self, connection: Any) -> None:
        """Take a connection that has not sent its request."""
        while len(self._arriving) >= _MAX_HANDSHAKES:
            oldest = next(iter(self._arriving))
            del self._arriving[oldest]
            oldest.transport.abort()
        self._arriving[connection] = None

    def leave(self, connection: Any) -> None:
        """Forget a connection."""
        self._arriving.pop(connection, None)
        self._open.discard(connection)

    def _answer(self, serve_file: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """Response to a request; None lets a browser connect."""
        self._arriving.pop(connection, None)
        host, origin = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(host) != 1 or not _is_loopback(host[0]):
            return connection.respond(403, "Host: must be an address of this machine\n")
        if origin and origin != [f"http://{host[0]}"]:
            return connection.respond(403, "Origin: must be this page\n")
        token, _, rest = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not is_same_token(unquote(token), self._token):
            return connection.respond(404, "the address needs the token that was printed with it\n")
        if request.headers.get("Upgrade", "").lower() != "websocket":
            response = serve_file(connection, replace(request, path=f"/{rest}"))
            response.headers["Referrer-Policy"] = "no-referrer"  # the address has the token
            response.headers["X-Content-Type-Options"] = "nosniff"
            return response
        if request.headers.get("Sec-WebSocket-Protocol") != self._protocol:
            return connection.respond(400, f"Sec-WebSocket-Protocol: must be {self._protocol}; reload the page\n")
        if len(self._open) >= self._limit:
            return connection.respond(503, f"{self._limit} connections are open already\n")
        self._open.add(connection)
        return None

    def checked(self, data: bytes | str) -> bytes | None:
        """Return a message with nothing in it but what was checked.

        None stands for one to leave out: a control that is gone, or a camera of which a browser has no numbers yet.
        Raises `ValueError` for anything that viser's page does not send.
        """
        if isinstance(data, str):
            raise ValueError("text: messages are binary")
        try:
            message = _MESSAGES.decode(data)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise ValueError(" ".join(str(error).split())) from None
        if isinstance(message, _ValueSent):
            control = self._control(message.uuid)
            if control is None:
                return None
            if not _fits(control, message.updates.value):
                raise ValueError("updates.value: does not fit its control")
        elif not all(abs(each) <= _LARGEST for each in _numbers(message)):
            return None
        return msgspec.msgpack.encode(message)


class _Pace:
    """Slows a sender down to `_PER_S` messages per second; what waits is left to the network."""

    def __init__(self) -> None:
        self._left, self._at_s = _BURST, time.monotonic()

    async def wait(self) -> None:
        now_s = time.monotonic()
        self._left = min(_BURST, self._left + _PER_S * (now_s - self._at_s)) - 1
        self._at_s = now_s
        if self._left < 0:
            await asyncio.sleep(-self._left / _PER_S)


def _numbers(camera: _CameraSent) -> Iterator[float]:
    for value in msgspec.structs.astuple(camera):
        yield from value if isinstance(value, tuple) else (value,)


def _fits(control: Any, value: Any) -> bool:
    """Return whether a value is of a control's kind; its range is left to the settings."""
    now = control.value
    if isinstance(now, bool):
        return isinstance(value, bool)
    if isinstance(now, str):
        return isinstance(value, str) and value in getattr(control, "options", ())
    rows = value if isinstance(now, tuple) else (value,)
    if not isinstance(rows, tuple) or (isinstance(now, tuple) and len(rows) != len(now)):
        return False
    return all(isinstance(each, int | float) and not isinstance(each, bool) and abs(each) <= _LARGEST for each in rows)


def _is_loopback(host: str) -> bool:
    try:
        parts = urlsplit(f"//{host}")
        return parts.hostname in _LOOPBACK and parts.netloc == host and "@" not in host
    except ValueError:
        return False

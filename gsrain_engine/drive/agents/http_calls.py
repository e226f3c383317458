"""Calls to one server: JSON there and back, with one end to how long it may take and how much may come in all."""

from collections.abc import Iterator
from urllib.parse import urlsplit

import h11

from gsrain_engine.untrusted.limits import ByteBudget, Deadline, TooLargeError, Wire
from gsrain_engine.untrusted.printable import printable

from .client_error import ClientError

_MAX_BYTES = 8 << 20
"""Of all that a server sends: its answer, and whatever comes before and around it."""
_PORTS = {"http": 80, "https": 443}
_OK = 200
_FAILURE_CHARACTERS = 200


class HttpCalls:
    """Knows where a server is. A connection a call; no redirects are followed, no proxies asked."""

    def __init__(self, url: str) -> None:
        """Take the address apart. Raises ValueError where it is none."""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as problem:
            raise ValueError(f"url {printable(url)}: {problem}") from None
        is_plain = url.isascii() and url.isprintable() and " " not in url
        if parts.scheme not in _PORTS or not host or parts.query or parts.fragment or not is_plain:
            raise ValueError(f"url {printable(url)}: expected http://HOST:PORT")
        self.url = url.rstrip("/")
        self._secure, self._path = parts.scheme == "https", parts.path.rstrip("/")
        self._host, self._port = host, port or _PORTS[parts.scheme]
        self._named = parts.netloc.rpartition("@")[2]

    def get(self, path: str, within_s: float) -> bytes:
        """Ask for something; returns the body of a reply with status 200."""
        return self._call("GET", path, None, within_s)

    def post(self, path: str, body: bytes, within_s: float) -> bytes:
        """Send JSON; returns the body of a reply with status 200.

        Raises ClientError where nobody answers, too late, too much, less than announced, or with another status.
        """
        return self._call("POST", path, body, within_s)

    def _call(self, method: str, path: str, body: bytes | None, within_s: float) -> bytes:
        where = f"{self.url}{path}"
        try:
            reply, data = self._exchange(method, path, body, Deadline(within_s))
        except TimeoutError:
            raise ClientError(f"{where} has not answered within {within_s:g} s") from None
        except TooLargeError:
            raise ClientError(f"{where} answers more than {_MAX_BYTES >> 20} MiB") from None
        except OSError as problem:
            raise ClientError(f"{where} can't be reached: {problem.strerror or problem}") from None
        except h11.RemoteProtocolError as problem:
            raise ClientError(f"{where} answers what is no whole HTTP: {printable(problem)}") from None
        if reply.status_code != _OK:
            words = printable(data.decode(errors="replace"), _FAILURE_CHARACTERS)
            reason = printable(reply.reason.decode("latin-1"), _FAILURE_CHARACTERS)
            raise ClientError(f"{where} answers {reply.status_code} {reason}: {words}")
        return data

    def _exchange(self, method: str, path: str, body: bytes | None, deadline: Deadline) -> tuple[h11.Response, bytes]:
        """Send a request and take in the whole reply."""
        http = h11.Connection(h11.CLIENT)
        headers = [("Host", self._named), ("Accept-Encoding", "identity"), ("Connection", "close")]
        if body is not None:
            headers += [("Content-Type", "application/json"), ("Content-Length", str(len(body)))]
        asked = [http.send(h11.Request(method=method, target=self._path + path, headers=headers))]
        asked += [http.send(h11.Data(data=body))] if body else []
        asked += [http.send(h11.EndOfMessage())]
        wire = Wire(self._host, self._port, deadline, ByteBudget(_MAX_BYTES, self.url), is_secure=self._secure)
        try:
            for part in asked:
                wire.send(part or b"")
            reply, data = None, bytearray()
            for event in _events(http, wire, deadline):
                if isinstance(event, h11.Response):
                    reply = event
                    _check_length(reply, self.url)
                elif isinstance(event, h11.Data):
                    data += event.data
        finally:
            wire.close()
        assert reply is not None, "a message ends after it has begun"
        return reply, bytes(data)


def _events(http: h11.Connection, wire: Wire, deadline: Deadline) -> Iterator[h11.Event]:
    """Yield what comes, up to the end of the message; each piece, however small, is under the deadline."""
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


def _check_length(reply: h11.Response, name: str) -> None:
    """Refuse at once what is announced as more than may come. Raises `TooLargeError`."""
    for header, value in reply.headers:
        if header == b"content-length":
            ByteBudget(_MAX_BYTES, name).spend(int(value))

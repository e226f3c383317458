"""Calls to one server: JSON there and back, with an end to how long it may take and how much may come."""

import http.client
import time
from urllib.parse import urlsplit

from .client_error import ClientError

_MOST_BYTES = 8 << 20
_CHUNK_BYTES = 1 << 16
_FAILURE_CHARACTERS = 200


class HttpCalls:
    """Knows where a server is. A connection a call; no redirects are followed, no proxies asked."""

    def __init__(self, url: str) -> None:
        """Take the address apart. Raises ValueError where it is none."""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as problem:
            raise ValueError(f"url {url}: {problem}") from None
        if parts.scheme not in ("http", "https") or not host or parts.query or parts.fragment:
            raise ValueError(f"url {url}: expected http://HOST:PORT")
        self.url = url.rstrip("/")
        self._secure, self._host, self._port, self._path = parts.scheme == "https", host, port, parts.path.rstrip("/")

    def get(self, path: str, within_s: float) -> bytes:
        """Ask for something; returns the body of a reply with status 200."""
        return self._call("GET", path, None, within_s)

    def post(self, path: str, body: bytes, within_s: float) -> bytes:
        """Send JSON; returns the body of a reply with status 200.

        Raises ClientError where nobody answers, too late, too much, or with another status.
        """
        return self._call("POST", path, body, within_s)

    def _call(self, method: str, path: str, body: bytes | None, within_s: float) -> bytes:
        until = time.monotonic() + within_s
        kind = http.client.HTTPSConnection if self._secure else http.client.HTTPConnection
        connection = kind(self._host, self._port, timeout=within_s)
        headers = {} if body is None else {"Content-Type": "application/json"}
        try:
            connection.request(method, self._path + path, body, headers)
            reply = connection.getresponse()
            data = bytearray()
            while chunk := reply.read1(_CHUNK_BYTES):
                data += chunk
                if len(data) > _MOST_BYTES:
                    raise ClientError(f"{self.url}{path} answers more than {_MOST_BYTES >> 20} MiB")
                if time.monotonic() > until:
                    raise TimeoutError
        except TimeoutError:
            raise ClientError(f"{self.url}{path} has not answered within {within_s:g} s") from None
        except (OSError, http.client.HTTPException) as problem:
            raise ClientError(f"{self.url}{path} can't be reached: {problem or type(problem).__name__}") from None
        finally:
            connection.close()
        if reply.status != http.client.OK:
            words = " ".join(data.decode(errors="replace").split())[:_FAILURE_CHARACTERS]
            raise ClientError(f"{self.url}{path} answers {reply.status} {reply.reason}: {words}")
        return bytes(data)

"""gRPC server that draws pictures for simulators: limits, tokens, health, and a status for each wrong message."""

import hmac
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotDoneError
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from .messages import HEALTH_SERVICE, calls, decode_error
from .simulator import RequestError, Simulator

logger = logging.getLogger("gsrain")
MAX_MESSAGE_BYTES = 64 * 2**20
"""Largest message that is received, and that is sent unless a service says otherwise: that of AlpaSim's clients."""

_POLL_S = 0.1  # between looks at whether a waiting client is still there


Method = Callable[[Any, Any], Any]
"""Answer of a call from its request and gRPC's context. Raises `RequestError`."""


class RenderServer:
    """A running server. Pictures are drawn one after another, by a thread of their own."""

    largest_answer_bytes = MAX_MESSAGE_BYTES

    def __init__(
        self, open_simulator: Callable[[], Simulator], address: str, *, sessions: int = 8, token: str | None = None
    ) -> None:
        """Open scenes and renderer, and listen at an address ("127.0.0.1:0": any free port).

        At most `sessions` calls wait or run at a time; more get RESOURCE_EXHAUSTED. With a `token`, calls need the
        metadata `authorization: Bearer TOKEN`. Raises `OSError` if the address can't be used.
        """
        grpc: Any = import_module("grpc")
        self._grpc, self._token, self.sessions = grpc, token, sessions
        self.version = own_version()
        self.answered = self.refused = self.running = 0
        """Calls that were answered, that were refused, and that are under way."""
        self._counting = threading.Lock()
        self._drawing = ThreadPoolExecutor(1, "drawing")
        self.simulator = self._drawing.submit(open_simulator).result()
        options = [
            ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
            ("grpc.max_send_message_length", self.largest_answer_bytes),
            ("grpc.so_reuseport", 0),
        ]
        self._server = grpc.server(
            ThreadPoolExecutor(sessions + 2, "calls"), options=options, maximum_concurrent_rpcs=sessions
        )
        offered = self.services()
        check = calls(HEALTH_SERVICE)["Check"]

        def health(request: Any, context: Any) -> Any:
            return check.answer(status=1 if request.service in ("", *offered) else 3)  # SERVING, SERVICE_UNKNOWN

        for service, methods in {**offered, HEALTH_SERVICE: {"Check": (check.request, health)}}.items():
            handlers = {
                name: grpc.unary_unary_rpc_method_handler(self._handler(name, kind, method))
                for name, (kind, method) in methods.items()
            }
            self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, handlers),))
        try:
            self.port: int = self._server.add_insecure_port(address)
        except RuntimeError as error:
            self._close()
            raise OSError(f"{address} can't be listened at: {error}") from None
        if self.port == 0:
            self._close()
            raise OSError(f"{address} can't be listened at")
        self._server.start()

    def services(self) -> dict[str, dict[str, tuple[Any, Method]]]:
        """Offered services by full name: the classes of requests and the functions of their calls."""
        raise NotImplementedError

    def stop(self, grace_s: float = 10.0) -> None:
        """Refuse new calls, wait for running ones, and close the renderer."""
        self._server.stop(grace_s).wait()
        self._close()

    def _close(self) -> None:
        self._drawing.submit(self.simulator.close).result()
        self._drawing.shutdown()

    def _handler(self, name: str, kind: Any, method: Method) -> Callable[[bytes, Any], bytes]:
        """Function of a call, from bytes to bytes: errors become a status."""

        def answer(data: bytes, context: Any) -> bytes:
            started = time.monotonic()
            self._count(running=1)
            try:
                self._check_token(context)
                try:
                    request = kind.FromString(data)
                except decode_error():
                    raise RequestError("INVALID_ARGUMENT", f"not a message {kind.DESCRIPTOR.full_name}") from None
                found = method(request, context).SerializeToString()
                if len(found) > self.largest_answer_bytes:
                    told = f"the answer has {len(found)} bytes, at most {self.largest_answer_bytes} are sent"
                    raise RequestError("INVALID_ARGUMENT", told)
            except RequestError as error:
                self._count(refused=1)
                logger.info("%s: %s, %s", name, error.status, error.text)
                context.abort(self._status(error.status), error.text)
                raise
            except MemoryError:
                self._count(refused=1)
                context.abort(self._grpc.StatusCode.RESOURCE_EXHAUSTED, "the memory is full")
                raise
            except Exception as error:
                self._count(refused=1)
                logger.exception("%s failed", name)
                context.abort(self._grpc.StatusCode.INTERNAL, f"{type(error).__name__}; the server's log has more")
                raise
            finally:
                self._count(running=-1)
            self._count(answered=1)
            logger.info("%s: %d bytes in %.2f s", name, len(found), time.monotonic() - started)
            return found

        return answer

    def _status(self, name: str) -> Any:
        return getattr(self._grpc.StatusCode, name)

    def _count(self, answered: int = 0, refused: int = 0, running: int = 0) -> None:
        with self._counting:
            self.running += running
            self.answered += answered
            self.refused += refused

    def _check_token(self, context: Any) -> None:
        if self._token is None:
            return
        given = dict(context.invocation_metadata()).get("authorization", "")
        text = given if isinstance(given, str) else ""
        if not hmac.compare_digest(text.encode(), f"Bearer {self._token}".encode()):
            raise RequestError("UNAUTHENTICATED", "metadata authorization: Bearer TOKEN is needed")

    def draw(self, work: Callable[[Callable[[], bool]], Any], context: Any) -> Any:
        """Result of work of the drawing thread; given up when the client is gone."""
        future: Future[Any] = self._drawing.submit(work, context.is_active)
        while True:
            try:
                return future.result(_POLL_S)
            except NotDoneError:
                if future.done():
                    raise
                if not context.is_active():
                    future.cancel()
                    raise RequestError("CANCELLED", "the client is gone") from None
            except CancelledError:
                raise RequestError("CANCELLED", "the client is gone") from None


def own_version() -> str:
    """Installed version of this program; 0 if it runs from its sources."""
    try:
        return version("gsrain")
    except PackageNotFoundError:
        return "0"

"""gRPC server that draws pictures for simulators: limits, tokens, health, and a status for each wrong message."""

import errno
import logging
import math
import socket
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotDoneError
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Generic, TypeVar

from ...malloc_tuning import trim_memory
from ...optional_packages import import_package
from ...safe_io.limits import checked_token, is_same_token
from .health import HEALTH_SERVICE, health_messages
from .scenes import RequestError, ServedScenes

logger = logging.getLogger("gsrain")
MAX_ANSWER_BYTES = 64 * 2**20
"""Largest message that is sent unless a service says otherwise: that of AlpaSim's clients."""
MAX_REQUEST_BYTES = 16 * 2**20
"""Largest message that is received unless a service says otherwise; 64 pictures with 500 road users each have 4 MB."""
RECEIVED_AT_ONCE = 8
"""Largest number of messages that are being received, which bounds the memory that half-sent ones hold."""
RECEIVE_S = 10.0
"""Time in which a client sends its message."""

_GIVES_WAY_S = 1.0  # of receiving, after which the longest one ends for the sake of others

_FREED_S = 5.0  # after a call has ended
_POLL_S = 0.1  # between looks at whether a waiting client is still there
_REFUSING = 2  # threads beyond one for each running call, to refuse others at once
_LARGEST_QUEUE = 1000  # calls that may wait to be refused


_Scenes = TypeVar("_Scenes", bound=ServedScenes)
Method = Callable[[Any, Any], Any]
"""Answer of a call from its request and gRPC's context. Raises `RequestError`."""


class RenderServer(Generic[_Scenes]):
    """A running server. Pictures are drawn one after another, by a thread of their own."""

    largest_answer_bytes, largest_request_bytes = MAX_ANSWER_BYTES, MAX_REQUEST_BYTES

    def __init__(
        self, open_scenes: Callable[[], _Scenes], address: str, *, sessions: int = 8, token: str | None = None
    ) -> None:
        """Open scenes and renderer, and listen at an address ("127.0.0.1:0": any free port).

        At most `sessions` calls wait or run at a time; more get RESOURCE_EXHAUSTED. With a `token`, calls need the
        metadata `authorization: Bearer TOKEN`; those without are refused before their message is received. Raises
        `OSError` if the address can't be used, `ValueError` for a token that metadata can't hold.
        """
        grpc: Any = import_package("grpc", "a server of gRPC")
        self._grpc, self._token, self.sessions = grpc, None if token is None else checked_token(token), sessions
        self.version = own_version()
        self.answered = self.refused = self.running = 0
        """Calls that were answered, that were refused, and that are under way."""
        self._counting = threading.Lock()
        self._arrivals = _Arrivals()
        self._cut_off_s = math.inf  # on the clock, from when running calls are ended
        _check_address(address)
        self._drawing = ThreadPoolExecutor(1, "drawing")
        self.scenes = self._drawing.submit(open_scenes).result()
        options = [
            ("grpc.max_receive_message_length", self.largest_request_bytes),
            ("grpc.max_send_message_length", self.largest_answer_bytes),
            ("grpc.so_reuseport", 0),
        ]
        self._server = grpc.server(
            ThreadPoolExecutor(sessions + RECEIVED_AT_ONCE + _REFUSING, "calls"),
            options=options,
            maximum_concurrent_rpcs=sessions + _LARGEST_QUEUE,
        )
        offered = self.services()
        asked, answered = health_messages()

        def health(request: Any, context: Any) -> Any:
            return answered(status=1 if request.service in ("", *offered) else 3)  # SERVING, SERVICE_UNKNOWN

        for service, methods in {**offered, HEALTH_SERVICE: {"Check": (asked, health)}}.items():
            handlers = {
                name: grpc.stream_unary_rpc_method_handler(self._handler(name, kind, method))
                for name, (kind, method) in methods.items()
            }
            self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, handlers),))
        try:
            self.port: int = self._server.add_insecure_port(address)
        except RuntimeError:
            self.port = 0
        if self.port == 0:
            self._close()
            raise OSError(f"{address} can't be listened at")
        self._server.start()

    def subject(self, request: Any) -> str:
        """Words of the log for what a request is about: its scene."""
        return str(getattr(request, "scene_id", ""))[:80]

    def services(self) -> dict[str, dict[str, tuple[Any, Method]]]:
        """Offered services by full name: the classes of requests and the functions of their calls."""
        raise NotImplementedError

    def check_answer_bytes(self, count: int) -> None:
        """Raise `RequestError` if an answer has more bytes than are sent, as early as that is known."""
        if count > self.largest_answer_bytes:
            told = f"the answer has {count:,} bytes, at most {self.largest_answer_bytes:,} are sent"
            raise RequestError("INVALID_ARGUMENT", told)

    def stop(self, grace_s: float = 10.0) -> None:
        """Refuse new calls, wait for running ones, which end after the time given, and close the renderer."""
        self._cut_off_s = time.monotonic() + grace_s
        self._server.stop(grace_s).wait()
        self._close()

    def _close(self) -> None:
        self._drawing.submit(self.scenes.close).result()
        self._drawing.shutdown()

    def _handler(self, name: str, kind: Any, method: Method) -> Callable[[Iterator[bytes], Any], bytes]:
        """Function of a call, from bytes to bytes: errors become a status.

        To gRPC it is one of streams, which differ from single messages only in that they are received on demand.
        """

        def answer(messages: Iterator[bytes], context: Any) -> bytes:
            started, label, has_place = time.monotonic(), name, False
            try:
                self._check_token(context)
                with self._arrivals.one(context.cancel):
                    try:
                        data = next(messages)
                    except (StopIteration, self._grpc.RpcError):  # none came in time, or one that is too large
                        raise RequestError("CANCELLED", "no message was received") from None
                has_place = self._take_place()
                try:
                    request = kind.FromString(data)
                except import_module("google.protobuf.message").DecodeError:
                    raise RequestError("INVALID_ARGUMENT", f"not a message {kind.DESCRIPTOR.full_name}") from None
                label = f"{name} {self.subject(request)}".strip()
                found = method(request, context).SerializeToString()
                self.check_answer_bytes(len(found))
            except RequestError as error:
                self._count(refused=1)
                text = self._end_of(context) if error.status == "CANCELLED" else error.text
                logger.info("%s: %s, %s", _who(context, label), error.status, text)
                context.abort(self._status(error.status), text)
                raise
            except MemoryError:
                self._count(refused=1)
                context.abort(self._grpc.StatusCode.RESOURCE_EXHAUSTED, "the memory is full")
                raise
            except Exception as error:
                self._count(refused=1)
                logger.exception("%s failed", _who(context, label))
                context.abort(self._grpc.StatusCode.INTERNAL, f"{type(error).__name__}; the server's log has more")
                raise
            finally:
                self._count(running=-int(has_place))
            self._count(answered=1)
            taken_s = time.monotonic() - started
            logger.info("%s: %d bytes, %.2f s after the call came", _who(context, label), len(found), taken_s)
            return found

        return answer

    def _status(self, name: str) -> Any:
        return getattr(self._grpc.StatusCode, name)

    def _count(self, answered: int = 0, refused: int = 0, running: int = 0) -> None:
        with self._counting:
            self.running += running
            self.answered += answered
            self.refused += refused

    def _take_place(self) -> bool:
        """Count a call as running. Raises `RequestError` if as many as may are."""
        with self._counting:
            if self.running < self.sessions:
                self.running += 1
                return True
        raise RequestError("RESOURCE_EXHAUSTED", f"at most {self.sessions} calls wait or run at a time (--sessions)")

    def _end_of(self, context: Any) -> str:
        """Reason why nobody waits for the answer of a call."""
        if time.monotonic() >= self._cut_off_s:
            return "the server has stopped"
        return "its deadline has passed" if context.time_remaining() == 0 else "the client is gone"

    def _check_token(self, context: Any) -> None:
        if self._token is None:
            return
        given = dict(context.invocation_metadata()).get("authorization", "")
        if not isinstance(given, str) or not is_same_token(given, f"Bearer {self._token}"):
            raise RequestError("UNAUTHENTICATED", "metadata authorization: Bearer TOKEN is needed")

    def draw(self, work: Callable[[Callable[[], bool]], Any], context: Any) -> Any:
        """Result of work of the drawing thread; given up when the client is gone."""

        def is_waited_for() -> bool:
            return context.is_active() and context.time_remaining() != 0

        future: Future[Any] = self._drawing.submit(work, is_waited_for)
        while True:
            try:
                return future.result(_POLL_S)
            except NotDoneError:
                if future.done():
                    raise
                if not is_waited_for():
                    future.cancel()
                    raise RequestError("CANCELLED", "the client is gone") from None
            except CancelledError:
                raise RequestError("CANCELLED", "the client is gone") from None


class _Arrivals:
    """Messages that are being received: a bounded number, for a bounded time each."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._started_s: dict[object, tuple[float, Callable[[], object]]] = {}  # the oldest first
        self._trimming: threading.Timer | None = None

    @contextmanager
    def one(self, give_up: Callable[[], object]) -> Generator[None]:
        """Receive a message inside; `give_up` is called when that takes too long, or long while others wait."""
        key = object()
        with self._changed:
            while len(self._started_s) >= RECEIVED_AT_ONCE:
                oldest, (started_s, end) = next(iter(self._started_s.items()))
                left_s = started_s + _GIVES_WAY_S - time.monotonic()
                if left_s <= 0:
                    del self._started_s[oldest]
                    end()
                else:
                    self._changed.wait(left_s)
            self._started_s[key] = time.monotonic(), give_up
        late = threading.Timer(RECEIVE_S, give_up)
        late.daemon = True
        late.start()
        try:
            yield
        except RequestError:
            self._trim_later()
            raise
        finally:
            late.cancel()
            with self._changed:
                self._started_s.pop(key, None)
                self._changed.notify()

    def _trim_later(self) -> None:
        """Return to the system what messages held that never became whole, as soon as gRPC has freed it."""
        with self._changed:
            if self._trimming is not None:
                self._trimming.cancel()
            self._trimming = threading.Timer(_FREED_S, trim_memory)
            self._trimming.daemon = True
            self._trimming.start()


def _who(context: Any, label: str) -> str:
    """Beginning of a line of the log: time of day, client and call."""
    return f"{time.strftime('%H:%M:%S')} {context.peer()} {label}"


def _check_address(address: str) -> None:
    """Raise `OSError` if an address can't be listened at, with the reason, which gRPC doesn't give."""
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        socket.create_server((host, int(port)), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (")[0]  # Python adds the address
        advice = "; choose another port, or 0 for any free one" if error.errno == errno.EADDRINUSE else ""
        raise OSError(f"{address} can't be listened at: {reason}{advice}") from None


def own_version() -> str:
    """Installed version of this program; 0 if it runs from its sources."""
    try:
        return version("gsrain")
    except PackageNotFoundError:
        return "0"

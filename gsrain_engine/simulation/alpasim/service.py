"""gRPC server of AlpaSim's sensor simulator: limits, tokens, health, and a status for each message that is wrong."""

import hmac
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotDoneError
from importlib import import_module
from typing import Any

from .messages import API_VERSION, HEALTH_SERVICE, SERVICE, calls, decode_error, message
from .simulator import RequestError, Simulator

logger = logging.getLogger("gsrain")
MAX_MESSAGE_BYTES = 64 * 2**20
"""Largest message that is received or sent, that of AlpaSim's clients."""

_MAX_BATCH = 64  # pictures or lidar turns of one call
_POLL_S = 0.1  # between looks at whether a waiting client is still there


class SensorsimServer:
    """A running server. Pictures are drawn one after another, by a thread of their own."""

    def __init__(
        self, open_simulator: Callable[[], Simulator], address: str, *, sessions: int = 8, token: str | None = None
    ) -> None:
        """Open scenes and renderer, and listen at an address ("127.0.0.1:0": any free port).

        At most `sessions` calls wait or run at a time; more get RESOURCE_EXHAUSTED. With a `token`, calls need the
        metadata `authorization: Bearer TOKEN`. Raises `OSError` if the address can't be used.
        """
        grpc: Any = import_module("grpc")
        self._grpc, self._token = grpc, token
        self.answered = self.refused = self.running = 0
        """Calls that were answered, that were refused, and that are under way."""
        self._counting = threading.Lock()
        self._drawing = ThreadPoolExecutor(1, "drawing")
        self._simulator = self._drawing.submit(open_simulator).result()
        options = [
            ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
            ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
            ("grpc.so_reuseport", 0),
        ]
        self._server = grpc.server(
            ThreadPoolExecutor(sessions + 2, "calls"), options=options, maximum_concurrent_rpcs=sessions
        )
        for service, methods in ((SERVICE, self._methods()), (HEALTH_SERVICE, {"Check": self._check})):
            handlers = {
                name: grpc.unary_unary_rpc_method_handler(self._handler(name, call.request, methods[name]))
                for name, call in calls(service).items()
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

    def stop(self, grace_s: float = 10.0) -> None:
        """Refuse new calls, wait for running ones, and close the renderer."""
        self._server.stop(grace_s).wait()
        self._close()

    def _close(self) -> None:
        self._drawing.submit(self._simulator.close).result()
        self._drawing.shutdown()

    def _handler(self, name: str, kind: Any, method: Callable[[Any, Any], Any]) -> Callable[[bytes, Any], bytes]:
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
                if len(found) > MAX_MESSAGE_BYTES:
                    told = f"the answer has {len(found)} bytes, at most {MAX_MESSAGE_BYTES} are sent"
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

    def _draw(self, work: Callable[[Callable[[], bool]], Any], context: Any) -> Any:
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

    # Calls

    def _methods(self) -> dict[str, Callable[[Any, Any], Any]]:
        simulator = self._simulator

        def rgb(request: Any, context: Any) -> Any:
            data = self._draw(lambda is_active: simulator.picture(request, is_active), context)
            return message("RGBRenderReturn")(image_bytes=data)

        def lidar(request: Any, context: Any) -> Any:
            return self._draw(lambda _: simulator.lidar(request), context)

        def aggregated(request: Any, context: Any) -> Any:
            self._check_batch(len(request.rgb_requests) + len(request.lidar_requests))
            answer = message("AggregatedRenderReturn")()
            answer.rgb_returns.extend(rgb(each, context) for each in request.rgb_requests)
            answer.lidar_returns.extend(lidar(each, context) for each in request.lidar_requests)
            return answer

        def batch(request: Any, context: Any) -> Any:
            self._check_batch(len(request.items))
            answer = message("BatchRGBRenderReturn")()
            for each in request.items:
                item = answer.items.add(camera_name=each.camera_name)
                try:
                    item.result.CopyFrom(rgb(each.request, context))
                    item.success = True
                except RequestError as error:
                    if error.status == "CANCELLED":
                        raise
                    item.error_message = f"{error.status}: {error.text}"
            return answer

        def version(request: Any, context: Any) -> Any:
            from importlib.metadata import PackageNotFoundError
            from importlib.metadata import version as version_of

            try:
                own = version_of("gsrain")
            except PackageNotFoundError:  # run from its sources
                own = "0"
            found = message("common.VersionId")(version_id=f"gsrain {own}", git_hash="")
            api = found.grpc_api_version
            api.major, api.minor, api.patch = API_VERSION
            return found

        def available(request: Any, context: Any) -> Any:
            return message("common.AvailableScenesReturn")(scene_ids=[*simulator.scenes])

        def loaded(request: Any, context: Any) -> Any:
            answer = message("LoadedScenesReturn")(loaded_instance_capacity=len(simulator.scenes))
            for name in simulator.scenes:
                answer.scenes.add(scene_id=name, loaded_instance_count=1, reusable_instance_count=1)
            return answer

        return {
            "render_rgb": rgb,
            "render_lidar": lidar,
            "render_aggregated": aggregated,
            "batch_render_rgb": batch,
            "get_version": version,
            "get_available_scenes": available,
            "get_loaded_scenes": loaded,
            "get_available_cameras": lambda request, context: simulator.cameras(request),
            "get_available_trajectories": lambda request, context: simulator.trajectories(request),
            "get_available_ego_masks": lambda request, context: message("AvailableEgoMasksReturn")(),
        }

    def _check_batch(self, count: int) -> None:
        if count > _MAX_BATCH:
            raise RequestError("INVALID_ARGUMENT", f"{count} pictures in one call, at most {_MAX_BATCH} are made")

    def _check(self, request: Any, context: Any) -> Any:
        known = request.service in ("", SERVICE)
        return calls(HEALTH_SERVICE)["Check"].answer(status=1 if known else 3)  # SERVING, SERVICE_UNKNOWN

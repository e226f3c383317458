"""Protocols of gRPC: what those of AlpaSim and CARLA share as commands."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from .grpc_server import RenderServer
from .protocols import RainyScene, RunningServer, ServerOptions, ServerProtocol
from .scenes import ServedScenes, scene_ids

DEFAULT_PORT = 50051
"""AlpaSim's."""


@dataclass(frozen=True)
class _Running:
    server: RenderServer[Any]
    host: str
    scenes: tuple[str, ...]
    is_gone: Callable[[], bool]

    @property
    def greeting(self) -> str:
        return f"served at {self.host}:{self.server.port}"

    @property
    def numbers(self) -> dict[str, Any]:
        return {
            "scenes": list(self.scenes), "host": self.host, "port": self.server.port,
            "answered": self.server.answered, "refused": self.server.refused,
        }  # fmt: skip

    @property
    def is_ended(self) -> bool:
        return self.is_gone()

    def stop(self) -> str:
        self.server.stop()
        answered, refused = self.server.answered, self.server.refused
        return f"{answered:,} call{'s' * (answered != 1)} answered, {refused:,} refused"


def grpc_protocol(
    summary: str,
    packages: tuple[str, ...],
    open_server: Callable[[], tuple[type[RenderServer[Any]], type[ServedScenes]]],
    is_gone: Callable[[], bool] = lambda: False,
) -> ServerProtocol:
    """Make a protocol of a gRPC server.

    Args:
        summary: For whom it is.
        packages: Modules of `OPTIONAL_PACKAGES` that it needs.
        open_server: Imports and returns the classes of the server and of its scenes.
        is_gone: Whether the program that is served has ended.
    """

    def start(scenes: Sequence[RainyScene], options: ServerOptions) -> RunningServer:
        server_kind, scenes_kind = open_server()
        names = scene_ids([each.name for each in scenes])

        def open_scenes() -> ServedScenes:
            opened = scenes_kind(options.backend)
            for name, each in zip(names, scenes, strict=True):
                opened.add(name, each.scene, each.rainfall)
            return opened

        port = DEFAULT_PORT if options.port is None else options.port
        address = f"[{options.host}]:{port}" if ":" in options.host else f"{options.host}:{port}"
        logging.getLogger("gsrain").setLevel(logging.INFO)  # a line for each call
        server = server_kind(open_scenes, address, sessions=options.sessions, token=options.token)
        return _Running(server, options.host, tuple(names), is_gone)

    return ServerProtocol(summary, packages, _check, start)


def _check(scenes: int, options: ServerOptions) -> None:
    if options.token is None and not options.is_local:
        raise ValueError(
            f"--host {options.host}: other machines reach it, so --token (or the variable GSRAIN_TOKEN) is needed; "
            f"programs that send none are reached by forwarding the port to their machine with ssh -L"
        )

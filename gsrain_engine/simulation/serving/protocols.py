"""Protocols of `gsrain serve`: how programs of others ask for pictures of scenes in rain.

A protocol is an entry point of the group `gsrain.protocols`, those of this program included.
"""

import ipaddress
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from ...choices import Backend
from ...optional_packages import require_package
from ...plugins import PROTOCOLS, find_extension, find_extensions
from ...rain.simulation import RainSimulation
from ...scene.scene import Scene


class RainyScene(NamedTuple):
    """A scene in the light of its rain, by the name that others ask for."""

    name: str
    scene: Scene
    rainfall: RainSimulation


@dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """Address and limits of a server."""

    host: str = "127.0.0.1"
    port: int | None = None
    """None is the protocol's own, 0 any free one."""
    token: str | None = None
    sessions: int = 16
    """Largest number of calls that wait or run, or of viewers, at a time."""
    backend: Backend = "auto"

    @property
    def is_local(self) -> bool:
        """True if only this machine reaches the server."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


class RunningServer(Protocol):
    """A server that runs on threads of its own."""

    @property
    def greeting(self) -> str:
        """Words that tell the user the way to it, such as served at HOST:PORT."""
        ...

    @property
    def numbers(self) -> Mapping[str, Any]:
        """Values for `--json`, with `scenes`, their names; from the start on."""
        ...

    @property
    def is_ended(self) -> bool:
        """True when nobody is left to serve."""
        ...

    def stop(self) -> str:
        """Stop, and return in words what was done."""
        ...


@dataclass(frozen=True)
class ServerProtocol:
    """A protocol of `gsrain serve`."""

    summary: str
    """Those that it serves, in words."""
    packages: tuple[str, ...]
    """Modules of `OPTIONAL_PACKAGES` that it needs."""
    check: Callable[[int, ServerOptions], None]
    """Raises ValueError for a number of scenes or options that it can't have, before any scene is read."""
    start: Callable[[Sequence[RainyScene], ServerOptions], RunningServer]


def protocol_names() -> tuple[str, ...]:
    return tuple(each.name for each in find_extensions(PROTOCOLS))


def find_protocol(name: str) -> ServerProtocol:
    """Return a protocol by its name. Raises ValueError if there is none, or a package that it needs is missing."""
    extension = find_extension(PROTOCOLS, name)
    if extension is None:
        raise ValueError(f"--protocol {name}: there is {', '.join(protocol_names()) or 'none'}")
    found = extension.load(ServerProtocol)
    for package in found.packages:
        require_package(package, f"--protocol {name}")
    return found

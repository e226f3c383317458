"""Messages between `gr.Viewer` and its window: MessagePack, each after its length. Scenes travel as folders."""

import struct
from typing import Any, BinaryIO

import msgspec

from gsrain_engine.rain.settings import RainSettings as RainSettings

_LENGTH = struct.Struct(">I")
_MAX_BYTES = 1 << 24


class SetScene(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Show the scene in a scene folder, which the window only reads."""

    number: int
    folder: str


class SetRain(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Let it rain so."""

    number: int
    rain: RainSettings


class SetCamera(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Look from a camera of the world: the values of a camera file."""

    number: int
    camera: dict[str, Any]


class Screenshot(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Save what the viewport shows, once all that was asked for before is in it."""

    number: int
    path: str


class GetState(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Reply with rain and camera as they are now."""

    number: int


class Close(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """End without a question."""

    number: int


Request = SetScene | SetRain | SetCamera | Screenshot | GetState | Close


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """A request is done, or has failed."""

    number: int
    """Of the request; 0 is about the window itself, which then ends."""
    error: str = ""
    """One sentence; empty where all is well."""
    rain: RainSettings | None = None
    camera: dict[str, Any] | None = None


def send(file: BinaryIO, message: Request | Reply) -> None:
    """Write a message; raises `OSError` where the other side is gone, `ValueError` where the file is closed."""
    data = msgspec.msgpack.encode(message)
    file.write(_LENGTH.pack(len(data)) + data)
    file.flush()


def receive(file: BinaryIO, kind: Any) -> Any:
    """Wait for a message; None where the other side is gone. Raises `ValueError` for anything else than a message."""
    head = file.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack(head)
    if length > _MAX_BYTES:
        raise ValueError(f"a message of {length:,} bytes: at most {_MAX_BYTES:,} are allowed")
    data = file.read(length)
    return msgspec.msgpack.decode(data, type=kind) if len(data) == length else None

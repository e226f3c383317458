"""Messages between `gr.Viewer` and its window: JSON, one a line. Scenes are sent as folders."""

from typing import Any, BinaryIO

import msgspec

from gsrain_engine.rain.settings import RainSettings as RainSettings


class Request(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Message to the window; its reply has the same number."""

    number: int


class SetScene(Request, frozen=True, kw_only=True, tag=True):
    """Show the scene in a scene folder, which the window only reads."""

    folder: str


class SetRain(Request, frozen=True, kw_only=True, tag=True):
    """Set the rain."""

    rain: RainSettings


class SetCamera(Request, frozen=True, kw_only=True, tag=True):
    """Set the camera, in world coordinates: the values of a camera file."""

    camera: dict[str, Any]


class Screenshot(Request, frozen=True, kw_only=True, tag=True):
    """Save the viewport's image, once all earlier requests are visible in it."""

    path: str


class GetState(Request, frozen=True, kw_only=True, tag=True):
    """Request the current rain and camera."""


class ApplyEdit(Request, frozen=True, kw_only=True, tag=True):
    """Make an edit as a step of the window's history."""

    name: str
    arguments: dict[str, Any]
    """Plain values."""


class GoToStep(Request, frozen=True, kw_only=True, tag=True):
    """Undo (-1) or redo (1) a step."""

    by: int


class GetScene(Request, frozen=True, kw_only=True, tag=True):
    """Write the present scene into an empty folder, unless it is the one that was set last."""

    folder: str


class Close(Request, frozen=True, kw_only=True, tag=True):
    """Close without asking."""


REQUESTS = SetScene | SetRain | SetCamera | Screenshot | GetState | ApplyEdit | GoToStep | GetScene | Close


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a request."""

    number: int
    """Number of the request; 0 is about the window itself, which then exits."""
    error: str = ""
    """One sentence; empty on success."""
    rain: RainSettings | None = None
    camera: dict[str, Any] | None = None
    steps: list[str] | None = None
    """Labels of the history up to the present step."""
    folder: str | None = None
    """Written scene; None for the one that was set."""


def send(file: BinaryIO, message: Request | Reply) -> None:
    """Write a message. Raises `OSError` if the receiver has exited, `ValueError` if the file is closed."""
    file.write(msgspec.json.encode(message) + b"\n")
    file.flush()


def receive(file: BinaryIO, kind: Any) -> Any:
    """Wait for a message; None if the sender has exited. Raises `ValueError` for an invalid message."""
    line = file.readline()
    return msgspec.json.decode(line, type=kind) if line.endswith(b"\n") else None

"""Options of agents, and a table of the shipped ones for help texts."""

from pathlib import Path
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct


class AgentOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of agents."""

    detector: Annotated[Path | None, Meta(
        title="Detector", extra={"commands": "drive"},
        description="ONNX file of an object detector, for agents that look at pictures.")] = None  # fmt: skip
    description: Annotated[str | None, Meta(
        title="Its description", extra={"commands": "drive*"},
        description="A shipped detector description such as yolox, or a YAML file.")] = None  # fmt: skip
    url: Annotated[str | None, Meta(
        title="Address", extra={"commands": "drive"},
        description="URL of a driving agent that runs elsewhere, such as http://localhost:9000.")] = None  # fmt: skip


class ShippedAgent(NamedTuple):
    """An agent of this package; the registry opens it."""

    help: str
    """Verb phrase that follows its name in help texts."""
    uses: tuple[str, ...] = ()
    """Fields of `AgentOptions` that it uses."""


SHIPPED_AGENTS = {
    "constant-velocity": ShippedAgent("holds its speed"),
    "oracle-idm": ShippedAgent("uses the true positions of all road users"),
    "camera-idm": ShippedAgent("uses a detector", ("detector", "description")),
    "neuroncap-baseline": ShippedAgent("brakes for what is in a corridor ahead"),
    "http": ShippedAgent("asks a server", ("url",)),
}

HUGSIM = "hugsim"
"""Agent that is none of the table: it needs a client and its pipes, and changes scene and scenario."""

"""Which agents there are: the shipped ones and those of installed packages, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from .agent import Agent
from .constant_velocity import ConstantVelocityAgent

GROUP = "gsrain.agents"
"""Entry points of this group name a callable that takes `AgentOptions` and returns an `Agent`."""


@dataclass(frozen=True, slots=True)
class AgentOptions:
    """What a person may give an agent."""

    detector: Path | None = None
    """ONNX file of a detector."""
    description: str | None = None
    """How the detector is used: a shipped name or a YAML file."""
    url: str | None = None
    """Where an agent listens that runs elsewhere."""


_SHIPPED: dict[str, Callable[[AgentOptions], Agent]] = {
    "constant-velocity": lambda options: ConstantVelocityAgent(),
}


def agent_names() -> list[str]:
    """Names of all agents, the shipped ones first."""
    return [*_SHIPPED, *sorted(each.name for each in entry_points(group=GROUP) if each.name not in _SHIPPED)]


def open_agent(name: str, options: AgentOptions | None = None) -> Agent:
    """Make an agent ready.

    Raises ValueError for an unknown name, and where what it needs is missing.
    """
    options = options or AgentOptions()
    if name in _SHIPPED:
        return _SHIPPED[name](options)
    for each in entry_points(group=GROUP):
        if each.name == name:
            return each.load()(options)
    raise ValueError(f"agent {name}: there is none of that name, only {', '.join(agent_names())}")

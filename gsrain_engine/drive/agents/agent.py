"""What drives: an agent sees an observation and says where it wants to be."""

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from .observation import Observation, Rig

SPACING_S = 0.5
"""Time between the points of a plan, and from now to the first of them."""
FARTHEST_M = 10_000.0
"""A plan that reaches farther is none."""


@dataclass(frozen=True, slots=True)
class Needs:
    """What an agent must be shown: nothing is drawn that nobody looks at."""

    cameras: tuple[str, ...] = ()
    """By name; ("all",) are all of the rig, ("front",) is the one that looks most straight ahead."""
    depth: bool = False
    semantic: bool = False


NOTHING = Needs()


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What an agent answers."""

    points: Float64[np.ndarray, "n 2"]
    """Where its vehicle is to be 0.5 s, 1.0 s, ... from now, in its present frame (x forward, y left, metres)."""
    notes: dict[str, Any] = field(default_factory=dict[str, Any])
    """Plain values that it wants on record: what it saw and why it acts so."""


@runtime_checkable
class Agent(Protocol):
    """A driver under test. The same seed and observations give the same plans."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    @property
    def needs(self) -> Needs:
        """What it must be shown."""
        ...

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive: forget the one before."""
        ...

    def plan(self, observation: Observation) -> Plan | None:
        """Say where to be; None when it can't go on, which ends the drive."""
        ...

    def close(self) -> None:
        """Let go of what it holds; it is not used again."""
        ...

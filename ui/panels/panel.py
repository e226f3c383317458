"""What a panel is: a title, where it docks, and the function of the session that draws it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from gsrain_engine.session.session import Session

DockSide = Literal["left", "left bottom", "right", "right bottom", "bottom"]


@dataclass(frozen=True)
class Panel:
    """A panel beside the viewport."""

    title: str
    side: DockSide
    draw: Callable[[Session], None]

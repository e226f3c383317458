"""What a wet ground mirrors: what there is to know about the world around views."""

from typing import Protocol, runtime_checkable

from ..clear_view import ClearView
from .ground import Ground
from .mirrored import Mirrored


@runtime_checkable
class Surroundings(Protocol):
    """What is known about the world around the views."""

    def ground(self, view: ClearView) -> Ground | None:
        """Find the ground in a view; None where it shows none."""
        ...

    def mirrored(self, view: ClearView, ground: Ground) -> Mirrored:
        """Show what the ground's plane mirrors to the view's eye."""
        ...

"""The controllers that a scenario may name."""

from typing import TYPE_CHECKING

from .controller import Controller
from .pure_pursuit import PurePursuit

if TYPE_CHECKING:
    from ..scenario.scenario import ControllerSettings


def open_controller(settings: "ControllerSettings") -> Controller:
    """Make the controller that settings ask for."""
    return PurePursuit()

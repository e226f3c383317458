"""The controllers that a scenario may name."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from .controller import Controller
from .ilqr import ILQRTracker
from .pure_pursuit import PurePursuit

if TYPE_CHECKING:
    from ..scenario.scenario import ControllerSettings


_CONTROLLERS: dict[str, Callable[["ControllerSettings"], Controller]] = {
    "ilqr": ILQRTracker,
    "pure-pursuit": lambda settings: PurePursuit(),
}


def open_controller(settings: "ControllerSettings") -> Controller:
    """Make the controller that settings ask for."""
    return _CONTROLLERS[settings.kind](settings)

"""The controllers that a scenario may name."""

from collections.abc import Callable

from .controller import Controller
from .controller_settings import ControllerSettings
from .ilqr import ILQRTracker
from .pure_pursuit import PurePursuit

_CONTROLLERS: dict[str, Callable[[ControllerSettings], Controller]] = {
    "ilqr": ILQRTracker,
    "pure-pursuit": lambda settings: PurePursuit(),
}


def open_controller(settings: ControllerSettings) -> Controller:
    return _CONTROLLERS[settings.kind](settings)

"""The rain and the weather that were saved with a scene, as plain values."""

import logging
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from gsrain_engine.scene.scene import Scene
from gsrain_engine.untrusted.explained_errors import converted

from .rain import Rain
from .weather import Weather

logger = logging.getLogger("gsrain")

Saved = TypeVar("Saved", Rain, Weather)


def rain_of(scene: Scene) -> Rain | None:
    """Return the rain that a scene was saved with; None without, or where it can't be used, which is logged."""
    return _read(scene, "rain", scene.rain, Rain)


def weather_of(scene: Scene) -> Weather | None:
    """Return the weather that a scene was saved with; None without, or where it can't be used, which is logged."""
    return _read(scene, "weather", scene.weather, Weather)


def _read(scene: Scene, what: str, values: Mapping[str, Any] | None, kind: type[Saved]) -> Saved | None:
    try:
        return None if values is None else converted(values, kind)
    except msgspec.ValidationError as error:
        logger.error("%s: the scene's %s can't be used: %s", scene.name, what, error)
        return None

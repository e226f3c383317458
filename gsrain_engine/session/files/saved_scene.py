"""A session's document as one value, as it goes into files."""

from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from gsrain_engine.scene.scene import Scene

from .kept_view import kept_view

if TYPE_CHECKING:
    from ..session import Session


def saved_scene(session: "Session") -> Scene:
    """The scene with its rain, its weather, and from where it is looked at."""
    weather = msgspec.to_builtins(session.weather) if session.weather.keys else None
    return replace(session.scene, rain=msgspec.to_builtins(session.rain), weather=weather, view=kept_view(session))

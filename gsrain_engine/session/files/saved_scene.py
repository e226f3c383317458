"""A session's document as one value, as it goes into files."""

from dataclasses import replace

import msgspec

from gsrain_engine.scene.scene import Scene

from ..document.viewed_document import ViewedDocument
from .kept_view import kept_view


def saved_scene(session: ViewedDocument) -> Scene:
    """The scene with its rain, its weather, and from where it is looked at."""
    weather = msgspec.to_builtins(session.weather) if session.weather.keys else None
    return replace(session.scene, rain=msgspec.to_builtins(session.rain), weather=weather, view=kept_view(session))

"""What a person edits: a scene, its rain, and how the rain changes over time."""

from dataclasses import dataclass

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.weather import WITHOUT_CHANGE, Weather
from gsrain_engine.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """What a person edits and what undo steps over."""

    scene: Scene
    rain: Rain
    weather: Weather = WITHOUT_CHANGE
    """How the rain changes over time."""

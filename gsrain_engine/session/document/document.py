"""What a person edits: a scene, its rain, and how the rain changes over time."""

from dataclasses import dataclass, replace

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

    def with_scene(self, scene: Scene) -> "Document":
        """Return the document with another scene."""
        return replace(self, scene=scene)

    def with_rain(self, rain: Rain) -> "Document":
        """Return the document in another rain."""
        return replace(self, rain=rain)

    def with_weather(self, weather: Weather) -> "Document":
        """Return the document with another course of the rain over time."""
        return replace(self, weather=weather)

"""Edits of the rain that a scene is saved with: settings, and keyframes over time."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec

from ...rain.keyframes import NO_KEYFRAMES, RainKeyframes, keyframes_of, rain_of
from ...rain.settings import RainSettings, load_preset
from ...safe_io.errors import convert_checked
from ...scene.scene import Scene


def change_rain(scene: Scene, at_s: float = 0.0, **fields: Any) -> Scene:
    """Change fields of the rain; a field with keyframes also gets a keyframe at a time in seconds."""
    rain, keyframes = saved_rain(scene)
    changed = convert_checked(msgspec.to_builtins(rain) | fields, RainSettings)
    return with_rain(scene, changed, keyed_rain(keyframes, at_s, fields))


def set_rain_keyframes(scene: Scene, keyframes: RainKeyframes) -> Scene:
    """Set all rain keyframes; the settings apply where a field has none."""
    return with_rain(scene, saved_rain(scene)[0], keyframes)


def keyed_rain(keyframes: RainKeyframes, at_s: float, fields: Mapping[str, Any]) -> RainKeyframes:
    """Insert a keyframe of those fields that have keyframes; other fields are constant."""
    keyed = {name: value for name, value in fields.items() if keyframes.is_keyed(name) and value is not None}
    return keyframes.with_key(at_s, **keyed) if keyed else keyframes


def saved_rain(scene: Scene) -> tuple[RainSettings, RainKeyframes]:
    """Rain and keyframes that a scene is saved with; no rain if there are none."""
    return rain_of(scene) or load_preset("clear"), keyframes_of(scene) or NO_KEYFRAMES


def with_rain(scene: Scene, rain: RainSettings, keyframes: RainKeyframes) -> Scene:
    """Return the scene with other saved rain."""
    weather = msgspec.to_builtins(keyframes) if keyframes.keys else None
    return replace(scene, rain=msgspec.to_builtins(rain), weather=weather)

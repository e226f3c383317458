"""Edits of the rain keyframes."""

from typing import Any, Literal

import msgspec

from ...rain.keyframes import KEYED, Keyed, RainKeyframes, shower_keyframes
from ...rain.settings import HEAVIEST_MM_H
from ...scene.easing import KeyEasing


def replace_keyframes(keyframes: RainKeyframes, other: RainKeyframes) -> RainKeyframes:
    """Take other keyframes, such as a measured series, or none."""
    return other


def set_interpolation(keyframes: RainKeyframes, between: Literal["linear", "smooth"]) -> RainKeyframes:
    """Set the interpolation between all rain keyframes."""
    return msgspec.structs.replace(keyframes, between=between)


def add_shower(keyframes: RainKeyframes, start_s: float) -> RainKeyframes:
    """Replace the intensity by a passing shower from a time on; keyframes of wind and exposure stay."""
    shower = shower_keyframes(start_s)
    for key in keyframes.without("intensity_mm_h").keys:
        values = {name: value for name in KEYED if (value := getattr(key, name)) is not None}
        shower = shower.with_key(key.time_s, **values, easing=key.easing)
    return shower


def move_keyframe(keyframes: RainKeyframes, name: Keyed, number: int, to_s: float, **fields: Any) -> RainKeyframes:
    """Move a field's keyframe, given by its number, to another time, optionally with a new value."""
    return keyframes.moved_key(float(keyframes.key_times[name][number]), to_s, name, **fields)


def copy_keyframe(keyframes: RainKeyframes, name: Keyed, number: int, to_s: float) -> RainKeyframes:
    """Copy a field's keyframe, given by its number, with its easing to another time."""
    key = keyframes.key_at(float(keyframes.key_times[name][number]))
    assert key is not None, "a keyframe exists at each of its times"
    return keyframes.with_key(to_s, **{name: getattr(key, name)}, easing=key.easing_of(name))


def set_keyframe_easing(keyframes: RainKeyframes, name: Keyed, number: int, easing: KeyEasing | None) -> RainKeyframes:
    """Set a field's easing from a keyframe, given by its number, to the next one; None follows the interpolation."""
    key = keyframes.key_at(float(keyframes.key_times[name][number]))
    assert key is not None, "a keyframe exists at each of its times"
    others = {each: value for each, value in key.easing.items() if each != name}
    changed = msgspec.structs.replace(key, easing=others if easing is None else others | {name: easing})
    return msgspec.structs.replace(keyframes, keys=tuple(changed if each is key else each for each in keyframes.keys))


def set_keyframe_number(keyframes: RainKeyframes, time_s: float, name: str, value: float) -> RainKeyframes:
    """Change one number of a keyframe, clamped to its bounds.

    `name` is "time" (s), "intensity_mm_h", "wind x" or "wind y" (m/s), or "exposure_s" (with a value in milliseconds).
    """
    if name == "time":
        for each in KEYED:  # fields without a keyframe here are unaffected
            keyframes = keyframes.moved_key(time_s, min(max(value, -1e6), 1e6), each)
        return keyframes
    if name == "intensity_mm_h":
        return keyframes.with_key(time_s, intensity_mm_h=min(max(value, 0.0), HEAVIEST_MM_H))
    if name == "exposure_s":
        return keyframes.with_key(time_s, exposure_s=min(max(value / 1000, 1e-5), 1.0))
    key = keyframes.key_at(time_s)
    x, y = (key.wind_m_s if key is not None else None) or (0.0, 0.0)
    value = min(max(value, -40.0), 40.0)
    return keyframes.with_key(time_s, wind_m_s=(value, y) if name == "wind x" else (x, value))

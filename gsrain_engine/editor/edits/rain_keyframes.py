"""Edits of the rain keyframes."""

from typing import Any, Literal

import msgspec

from ...rain.keyframes import KEYED, Keyed, RainKeyframes, shower_keyframes
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

"""Tracks of the rain on the timeline: keyframes of each field are chosen, dragged, copied, pasted, eased, deleted."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.keyframes import LONGEST_S, Keyed, RainKeyframe, RainKeyframes
from ..rain.wetness import wetness
from ..scene.easing import KeyEasing
from .document import Document
from .edits.rain_keyframes import copy_keyframe, move_keyframe, set_keyframe_easing
from .timeline import Playback

_DRAG = "drag a rain key"  # gesture


class Track(NamedTuple):
    """A field of the rain as a row of the timeline."""

    field: Keyed
    title: str
    help: str
    form: str
    """Format of a value with its unit."""
    scale: float
    """Factor of a value in that format."""
    is_always_visible: bool


TRACKS = (
    Track("intensity_mm_h", "rain", "Rainfall intensity.", "%.4g mm/h", 1.0, True),
    Track("wind_m_s", "wind", "Wind along x and y.", "%.3g m/s", 1.0, False),
    Track("exposure_s", "exposure", "Shutter time of the drops.", "%.3g ms", 1000.0, False),
    Track("wetness", "wetness", "Share of soaked colors.", "%.2f", 1.0, True),
    Track("lamp_gain", "light", "Factor on the light of all lamps.", "x %.3g", 1.0, True),
)
"""Tracks of the timeline, below that of the camera."""


def track_of(field: Keyed) -> Track:
    """Return the track of a field."""
    return next(each for each in TRACKS if each.field == field)


class TrackKey(NamedTuple):
    """A keyframe of a track, by its number there."""

    field: Keyed
    number: int


class TrackDrag(NamedTuple):
    """A dragged keyframe, and its time at the start of the drag."""

    key: TrackKey
    start_s: float
    copies: bool


class CopiedKey(NamedTuple):
    """Value and easing of a keyframe, to paste."""

    field: Keyed
    value: Any
    easing: dict[Keyed, KeyEasing]


class RainTracks:
    """The chosen keyframe of the rain's tracks and what is done with it. Main thread only."""

    def __init__(self, document: Document, playback: Playback) -> None:
        self._document, self._playback = document, playback
        self._chosen: tuple[Keyed, float] | None = None
        self.drag: TrackDrag | None = None
        self.copied: CopiedKey | None = None

    @property
    def active(self) -> TrackKey | None:
        """The chosen keyframe; None if there is none, or if it is gone."""
        if self._chosen is None:
            return None
        field, time_s = self._chosen
        numbers = np.flatnonzero(self.times_s(field) == time_s)
        return TrackKey(field, int(numbers[0])) if len(numbers) else None

    def times_s(self, field: Keyed) -> Float64[np.ndarray, " n"]:
        return self._document.keyframes.key_times[field]

    def value(self, key: TrackKey) -> Any:
        """Value of a keyframe."""
        return getattr(self._keyframe(key), key.field)

    def easing(self, key: TrackKey) -> KeyEasing | None:
        """Easing after a keyframe; None follows the interpolation of all rain keyframes."""
        return self._keyframe(key).easing.get(key.field)

    def choose(self, key: TrackKey | None) -> None:
        """Choose a keyframe; that of the camera is no longer chosen."""
        self._chosen = None if key is None else (key.field, float(self.times_s(key.field)[key.number]))
        if key is not None:
            self._playback.timeline.key = None

    def insert(self, field: Keyed, time_s: float) -> None:
        """Insert a keyframe with the track's value at a time, and choose it."""
        time_s = max(0.0, self._playback.nearest_frame_time(time_s))
        rain = self._document.keyframes.rain_at(self._document.rain, time_s)
        value = rain.wind_vector_m_s if field == "wind_m_s" else getattr(rain, field)
        if value is None:
            value = wetness(rain.intensity_mm_h) if field == "wetness" else None
        if value is not None:
            change: dict[str, Any] = {field: value}
            self._document.edit_keyframes(_label("Insert", field), RainKeyframes.with_key, time_s, **change)
            self._chosen = field, time_s

    def set_value(self, key: TrackKey, value: Any, gesture: str | None = None) -> None:
        """Change the value of a keyframe."""
        time_s = float(self.times_s(key.field)[key.number])
        change: dict[str, Any] = {key.field: value}
        self._document.edit_keyframes(
            _label("Change", key.field), RainKeyframes.with_key, time_s, gesture=gesture, **change
        )

    def set_time(self, key: TrackKey, to_s: float) -> None:
        """Move a keyframe to a time; one that is there is replaced."""
        self._move(key, min(max(to_s, -LONGEST_S), LONGEST_S))

    def _move(self, key: TrackKey, to_s: float, gesture: str | None = None, *, copies: bool = False) -> None:
        change, word = (copy_keyframe, "Copy") if copies else (move_keyframe, "Move")
        self._document.edit_keyframes(_label(word, key.field), change, *key, to_s, gesture=gesture)
        self._chosen = key.field, to_s

    # Dragging

    def begin_drag(self, key: TrackKey, *, copies: bool = False) -> None:
        """Start to drag a keyframe in time, or a copy of it."""
        self._document.end_gesture()
        self.choose(key)
        self.drag = TrackDrag(key, float(self.times_s(key.field)[key.number]), copies)

    def drag_by(self, seconds: float) -> None:
        """Move the dragged keyframe by an offset from its start; one at the same time is replaced."""
        if self.drag is None:
            return
        key, start_s, copies = self.drag
        self._move(key, max(0.0, self._playback.nearest_frame_time(start_s + seconds)), _DRAG, copies=copies)

    def end_drag(self) -> None:
        self.drag = None
        self._document.end_gesture()

    # Clipboard, deletion, easing

    def copy(self) -> None:
        """Copy the chosen keyframe."""
        if (key := self.active) is not None:
            easing = self._keyframe(key).easing_of(key.field)
            self.copied = CopiedKey(key.field, self.value(key), easing)

    def paste(self) -> None:
        """Insert the copied keyframe at the playhead, and choose it."""
        if self.copied is not None:
            field, value, easing = self.copied
            time_s = self._playback.nearest_frame_time(self._playback.clock.time_s)
            change: dict[str, Any] = {field: value, "easing": easing}
            self._document.edit_keyframes(_label("Paste", field), RainKeyframes.with_key, time_s, **change)
            self._chosen = field, time_s

    def delete(self) -> None:
        """Delete the chosen keyframe."""
        if (key := self.active) is not None:
            time_s = float(self.times_s(key.field)[key.number])
            self._document.edit_keyframes(_label("Delete", key.field), RainKeyframes.without_key, time_s, key.field)
            self._chosen = None

    def ease(self, easing: KeyEasing | None) -> None:
        """Set the easing after the chosen keyframe."""
        if (key := self.active) is not None:
            label = f"{_label('Ease', key.field)}: {easing or 'as all'}"
            self._document.edit_keyframes(label, set_keyframe_easing, key.field, key.number, easing)

    def _keyframe(self, key: TrackKey) -> RainKeyframe:
        found = self._document.keyframes.key_at(float(self.times_s(key.field)[key.number]))
        assert found is not None, "a keyframe exists at each of its times"
        return found


def _label(word: str, field: Keyed) -> str:
    return f"{word} {track_of(field).title} keyframe"

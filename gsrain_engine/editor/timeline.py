"""Playback clock, and the timeline panel: ruler, selected keyframe, drags, and rows."""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes
from ..scene.camera_path import CameraPath
from ..scene.camera_path_edit import PathSpeed
from ..scene.scene import PoseTrack, Scene
from .viewport.camera import ORBIT_S

_LONGEST_STALL_S = 0.25
_LITTLE = 1e-6  # tolerance in frames within which a time counts as that of a frame


@dataclass(slots=True)
class PlaybackClock:
    """Clock with pause, seek, speed and an optional span. Runs in real time at any frame rate."""

    time_s: float = 0.0
    playing: bool = True
    speed: float = 1.0
    loop: bool = True
    """Restart at the end of the span, otherwise stop there."""
    span_s: tuple[float, float] | None = None
    """Start and end of playback if set by the user."""

    def toggle(self) -> None:
        self.playing = not self.playing

    def advance(self, real_s: float, span_s: tuple[float, float] | None = None) -> None:
        """Advance by real seconds; loop or stop at the end of the span. Without a span it runs on."""
        if not self.playing:
            return
        before, self.time_s = self.time_s, self.time_s + self.speed * real_s
        if span_s is None or self.time_s < span_s[1]:
            return
        start, end = span_s
        if self.loop:
            beyond = self.time_s - end if before < end else 0.0  # set beyond the end: from the start
            self.time_s = start + (beyond % (end - start) if end > start else 0.0)
        elif before >= end:  # played to the end and started again
            self.time_s = min(start + self.speed * real_s, end)
        else:
            self.time_s, self.playing = end, False

    def seek(self, time_s: float) -> None:
        """Set the time; negative values become 0."""
        self.time_s = max(0.0, float(time_s))

    def step(self, frames: int, fps: float) -> None:
        """Pause and go to a neighboring video frame; between two frames, to the one on that side."""
        self.playing = False
        number = self.time_s * fps
        whole = math.floor(number + _LITTLE) + frames if frames > 0 else math.ceil(number - _LITTLE) + frames
        self.seek(whole / fps)


@dataclass(slots=True)
class FrameClock:
    """Durations between frames, without stalls."""

    _last_s: float = 0.0

    def step(self, real_s: float) -> float:
        """Return the time step for a frame that took `real_s`.

        A stall counts as a quarter of a second, to avoid jumps. If successive frames all take longer, time keeps its
        real speed.
        """
        step_s, self._last_s = min(real_s, max(_LONGEST_STALL_S, self._last_s)), real_s
        return step_s


# Timeline state; not part of the document


class KeyframeDrag(NamedTuple):
    """A dragged keyframe: the result depends only on the present mouse position."""

    path: CameraPath
    """Path at the start of the drag; scene units and axes."""
    key: int
    copies: bool = False
    """Drag a copy and leave the keyframe."""
    in_view: bool = False
    """Dragged in the viewport, not on the timeline."""
    has_moved: bool = False
    """True if the mouse has moved; otherwise it was a click."""

    def begun(self) -> "KeyframeDrag":
        return self._replace(has_moved=True)


# Ruler: conversion between pixels and seconds, and tick marks


@dataclass(slots=True)
class Ruler:
    """Visible time span of a timeline."""

    first_s: float = 0.0
    visible_span_s: float = 10.0
    """Duration of the whole width."""
    width_px: float = 1.0

    def x(self, time_s: float) -> float:
        """Pixels from the left end to a time."""
        return (time_s - self.first_s) / self.visible_span_s * self.width_px

    def time(self, x_px: float) -> float:
        """Time at a number of pixels from the left end."""
        return self.first_s + x_px / self.width_px * self.visible_span_s

    def seconds(self, pixels: float) -> float:
        """Duration of a number of pixels."""
        return pixels / self.width_px * self.visible_span_s

    def zoom(self, steps: float, x_px: float) -> None:
        """Zoom in (positive) or out, by a fifth a step; the time at `x_px` stays there."""
        held = self.time(x_px)
        self.visible_span_s = float(np.clip(self.visible_span_s * 0.8**steps, _SHORTEST_S, _LONGEST_S))
        self._begin_at(held - self.seconds(x_px))

    def pan(self, pixels: float) -> None:
        self._begin_at(self.first_s - self.seconds(pixels))

    def fit(self, first_s: float, last_s: float) -> None:
        length = max(last_s - first_s, _SHORTEST_S)
        self.visible_span_s = length * (1 + 2 * _MARGIN)
        self.first_s = first_s - length * _MARGIN

    def show(self, time_s: float) -> None:
        """Scroll by a page if a time is not visible."""
        if not self.first_s <= time_s <= self.first_s + self.visible_span_s:
            self._begin_at(time_s - _MARGIN * self.visible_span_s)

    def marks(self, apart_px: float) -> list[float]:
        """Times of tick marks, at 1, 2 or 5 times a power of ten seconds, at least a number of pixels apart."""
        step = self.mark_step(apart_px)
        first, last = np.ceil(self.first_s / step - 1e-9), np.floor((self.first_s + self.visible_span_s) / step + 1e-9)
        return (np.arange(first, last + 1) * step).tolist()

    def mark_step(self, apart_px: float) -> float:
        least = max(self.seconds(apart_px), 1e-9)
        ten = 10.0 ** np.floor(np.log10(least))
        return float(next(nice * ten for nice in (*_NICE, 10.0) if nice * ten >= least * (1 - 1e-9)))

    def _begin_at(self, time_s: float) -> None:
        # A margin before 0 stays visible, so that items at 0 can be dragged.
        self.first_s = max(time_s, -_MARGIN * self.visible_span_s)


@dataclass(slots=True)
class Timeline:
    """State of the Timeline panel."""

    key: int | None = None
    """Index of the selected keyframe, which undo may have removed: use `active_keyframe` of `camera_path`."""
    drag: KeyframeDrag | None = None
    fps: float = 30.0
    """Video frame rate: keyframes and steps snap to its frames."""
    show_path: bool = True
    """Draw the path and its keyframes in the viewport."""
    ruler: Ruler = field(default_factory=Ruler)
    is_fitted: bool = False
    """True if the ruler was fitted to the scene's whole time."""
    takes_keys: bool = False
    """True if the panel has the keyboard focus."""
    asks_for_time: bool = False
    """True if the panel is to open the input of a time."""


@lru_cache(maxsize=4)
def speed_of(path: CameraPath) -> PathSpeed:
    """Speed of a path in the world; cached."""
    return PathSpeed.of(path)


# Rows of the timeline


class TimelineRow(NamedTuple):
    """One row of the timeline."""

    title: str
    help: str
    spans_s: list[tuple[float, float]]
    """Time spans with content."""
    keys_s: tuple[float, ...] = ()


def content_span(scene: Scene, weather: RainKeyframes = NO_KEYFRAMES) -> tuple[float, float]:
    """Time span of the content: the user's path; else drive, traffic and weather; else one orbit."""
    if scene.path is not None and scene.path.duration_s > 0:
        return scene.path.start_s, scene.path.end_s
    tracks = [actor.track for actor in scene.actors] + ([scene.ego] if scene.ego is not None else [])
    times = [(float(track.times[0]), float(track.times[-1])) for track in tracks if len(track.times) > 1]
    if len(weather.keys) > 1:
        times.append((weather.keys[0].time_s, weather.keys[-1].time_s))
    if not times:
        return 0.0, ORBIT_S
    return max(0.0, min(first for first, _ in times)), max(last for _, last in times)


def track_rows(scene: Scene) -> list[TimelineRow]:
    """Rows of the ego vehicle and the actors."""
    rows: list[TimelineRow] = []
    if scene.ego is not None:
        rows.append(TimelineRow("ego vehicle", "The vehicle that carries the cameras.", presence(scene.ego)))
    for actor in scene.actors:
        help_text = f"{actor.class_name or 'actor'}, in the scene while the bar lasts."
        rows.append(TimelineRow(actor.name, help_text, presence(actor.track)))
    return rows


def weather_row(weather: RainKeyframes, first_s: float, last_s: float, most: int) -> TimelineRow:
    """Row of the rain's keyframes within a time span, at most `most` of them, to avoid overlaps."""
    times = weather.times_s
    seen = times[(times >= first_s) & (times <= last_s)]
    thinned = seen[:: max(1, -(-len(seen) // most))]
    spans = [(weather.keys[0].time_s, weather.keys[-1].time_s)] if len(weather.keys) > 1 else []
    return TimelineRow(
        "rain",
        "Keyframes of the Rain keyframes panel: intensity, wind and exposure.",
        spans,
        (*thinned.tolist(),),
    )


def presence(track: PoseTrack) -> list[tuple[float, float]]:
    """Time spans in which a track is valid, between its first and last sample."""
    there = track.valid[:-1].astype(np.int8)
    edges = np.diff(np.concatenate([[0], there, [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(float(track.times[a]), float(track.times[b])) for a, b in zip(starts, ends, strict=True)]


def ego_speed_km_h(scene: Scene, time_s: float) -> float | None:
    """Speed of the ego vehicle; None if there is none at that time."""
    track = scene.ego
    if track is None or len(track.times) < 2 or not track.times[0] <= time_s <= track.times[-1]:
        return None
    k = min(int(np.searchsorted(track.times, time_s, side="right")) - 1, len(track.times) - 2)
    if not track.valid[k]:
        return None
    way = float(np.linalg.norm(track.positions[k + 1] - track.positions[k])) * scene.metres_per_unit
    return 3.6 * way / float(track.times[k + 1] - track.times[k])


_NICE = (1.0, 2.0, 5.0)
_SHORTEST_S, _LONGEST_S = 0.1, 86400.0
_MARGIN = 0.04  # share of the width that stays free on each side of a fitted span

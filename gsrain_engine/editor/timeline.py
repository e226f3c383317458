"""Playback, and the timeline panel: ruler, selected keyframe, drags, and rows."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..rain.keyframes import NO_KEYFRAMES, RainKeyframes
from ..scene.camera_path import CameraPath
from ..scene.camera_path_edit import PathSpeed
from ..scene.scene import PoseTrack, Scene
from .clock import PlaybackClock
from .document import Document
from .viewport.camera import ORBIT_S

_MIN_SPAN_S, _MAX_SPAN_S = 0.1, 86400.0
_MARGIN = 0.04  # share of the ruler's width that stays free on each side of a fitted span


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
        self.visible_span_s = float(np.clip(self.visible_span_s * 0.8**steps, _MIN_SPAN_S, _MAX_SPAN_S))
        self._begin_at(held - self.seconds(x_px))

    def pan(self, pixels: float) -> None:
        self._begin_at(self.first_s - self.seconds(pixels))

    def fit(self, first_s: float, last_s: float) -> None:
        length = max(last_s - first_s, _MIN_SPAN_S)
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
        min_step = max(self.seconds(apart_px), 1e-9)
        ten = 10.0 ** np.floor(np.log10(min_step))
        return float(next(nice * ten for nice in (1.0, 2.0, 5.0, 10.0) if nice * ten >= min_step * (1 - 1e-9)))

    def _begin_at(self, time_s: float) -> None:
        # A margin before 0 stays visible, so that items at 0 can be dragged.
        self.first_s = max(time_s, -_MARGIN * self.visible_span_s)


_TOO_LONG = 3.0


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
    history_place: tuple[int, int] = (0, 0)
    """Number of steps of the history and the present one, when the panel was last drawn."""
    takes_keys: bool = False
    """True if the panel has the keyboard focus."""
    asks_for_time: bool = False
    """True if the panel is to open the input of a time."""


class Playback:
    """Time of the scene: its clock, the span that is played, and the state of the timeline."""

    def __init__(self, document: Document, clock: PlaybackClock) -> None:
        self.clock, self.timeline = clock, Timeline()
        self.rollout_span_s: tuple[float, float] | None = None
        """Start and end of the playing roll-out; None if none plays."""
        self._document = document

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of playback: as set by the user, else those of the roll-out or of the scene's content."""
        content = content_span(self._document.scene, self._document.keyframes)
        return self.clock.span_s or self.rollout_span_s or content

    @property
    def whole_s(self) -> tuple[float, float]:
        """Start and end of playback and of all rain keyframes."""
        (start, end), keys = self.span_s, self._document.keyframes.keys
        first, last = (keys[0].time_s, keys[-1].time_s) if keys else (start, end)
        return min(start, first), max(end, last)

    def show_all(self) -> None:
        """Fit the ruler to playback and to all rain keyframes."""
        self.timeline.ruler.fit(*self.whole_s)

    def follow_history(self) -> None:
        """Fit the ruler if a step that was undone or redone leaves it far too long, as that of a shower does."""
        history, timeline = self._document.history, self.timeline
        place = len(history.labels), history.cursor
        is_moved = place[0] == timeline.history_place[0] and place != timeline.history_place
        timeline.history_place = place
        start, end = self.whole_s
        if is_moved and _TOO_LONG * (end - start) < timeline.ruler.visible_span_s:
            self.show_all()

    def advance(self, real_s: float) -> None:
        self.clock.advance(real_s, self.span_s)

    def time_ahead(self, real_s: float) -> float:
        """Time that the clock will show after real seconds."""
        later = replace(self.clock)
        later.advance(real_s, self.span_s)
        return later.time_s

    def nearest_frame_time(self, time_s: float) -> float:
        return round(time_s * self.timeline.fps) / self.timeline.fps

    def set_span(self, is_start: bool, time_s: float) -> None:
        """Set the start or end of playback; they stay at least a frame apart."""
        start, end = self.span_s
        moment, frame = max(0.0, self.nearest_frame_time(time_s)), 1 / self.timeline.fps
        self.clock.span_s = (min(moment, end - frame), end) if is_start else (start, max(moment, start + frame))

    def shift_span(self, seconds: float) -> None:
        """Move start and end of playback together; the start stays at 0 s or later."""
        start, end = self.span_s
        seconds = max(seconds, -start)
        self.clock.span_s = start + seconds, end + seconds

    def reset(self) -> None:
        """Forget the timeline of another scene but for its frame rate, and the span."""
        self.timeline, self.clock.span_s = Timeline(fps=self.timeline.fps), None


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
    rows = [("ego vehicle", "The vehicle that carries the cameras.", scene.ego)] if scene.ego is not None else []
    for actor in scene.actors:
        rows.append((actor.name, f"{actor.class_name or 'actor'}, in the scene while the bar lasts.", actor.track))
    return [TimelineRow(name, help_text, presence(track)) for name, help_text, track in rows]


def presence(track: PoseTrack) -> list[tuple[float, float]]:
    """Time spans in which a track is valid, between its first and last sample."""
    edges = np.diff(np.concatenate([[0], track.valid[:-1].astype(np.int8), [0]]))
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
    distance_m = float(np.linalg.norm(track.positions[k + 1] - track.positions[k])) * scene.metres_per_unit
    return 3.6 * distance_m / float(track.times[k + 1] - track.times[k])

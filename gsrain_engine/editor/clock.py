"""Clocks: time of the scene, with pause, seek and speed, and time steps of frames."""

import math
from dataclasses import dataclass

_MAX_STALL_S = 0.25
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
        step_s, self._last_s = min(real_s, max(_MAX_STALL_S, self._last_s)), real_s
        return step_s

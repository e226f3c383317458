"""Time in the scene: goes on in real seconds while it plays, so rain falls at its own speed at any frame rate."""

import math
from dataclasses import dataclass

_LONGEST_STALL_S = 0.25
_LITTLE = 1e-6
"""Of a frame: a moment as near as this to a frame is that frame's."""


@dataclass(slots=True)
class Clock:
    """A clock that can be stopped, set and run at another speed, within a span or on and on."""

    time_s: float = 0.0
    playing: bool = True
    speed: float = 1.0
    loop: bool = True
    """At the end of the span begin again; else stop there."""
    span_s: tuple[float, float] | None = None
    """First and last moment, where a person has set them."""

    def toggle(self) -> None:
        self.playing = not self.playing

    def advance(self, real_s: float, span_s: tuple[float, float] | None = None) -> None:
        """Let real seconds go by; at the end of the span it begins again or stops. Without a span it goes on and on."""
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
        """Set the time, not before 0."""
        self.time_s = max(0.0, float(time_s))

    def step(self, frames: int, fps: float) -> None:
        """Stop, and go to a neighbouring frame of a film; between two frames, to the one on that side."""
        self.playing = False
        number = self.time_s * fps
        whole = math.floor(number + _LITTLE) + frames if frames > 0 else math.ceil(number - _LITTLE) + frames
        self.seek(whole / fps)


@dataclass(slots=True)
class Pace:
    """The seconds from one frame to the next, without stalls."""

    _last_s: float = 0.0

    def step(self, real_s: float) -> float:
        """Seconds to go on by after a frame that took so long.

        A stall counts as a quarter of a second, so that nothing leaps. Where one frame after the other takes longer
        than that it is no stall: time goes on at its own speed.
        """
        step_s, self._last_s = min(real_s, max(_LONGEST_STALL_S, self._last_s)), real_s
        return step_s

"""Time in the scene: goes on in real seconds while it plays, so rain falls at its own speed at any frame rate."""

from dataclasses import dataclass

_LONGEST_STALL_S = 0.25


@dataclass(slots=True)
class Clock:
    """A clock that can be stopped, set and run at another speed."""

    time_s: float = 0.0
    playing: bool = True
    speed: float = 1.0

    def toggle(self) -> None:
        """Play or pause."""
        self.playing = not self.playing

    def advance(self, real_s: float) -> None:
        """Let real seconds go by."""
        if self.playing:
            self.time_s += self.speed * real_s


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

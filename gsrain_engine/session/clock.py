"""Time in the scene: goes on in real seconds while it plays, so rain falls at its own speed at any frame rate."""

from dataclasses import dataclass


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

"""Where moments stand on a timeline, and which of them get a mark: between pixels and seconds."""

from dataclasses import dataclass

import numpy as np

_NICE = (1.0, 2.0, 5.0)
_SHORTEST_S, _LONGEST_S = 0.1, 86400.0
_MARGIN = 0.04
"""Share of the width that stays free beside what is fitted."""


@dataclass(slots=True)
class Ruler:
    """The stretch of time that a timeline shows."""

    first_s: float = 0.0
    shown_s: float = 10.0
    """Seconds over the whole width."""
    width_px: float = 1.0

    def x(self, time_s: float) -> float:
        """Pixels from the left end to a moment."""
        return (time_s - self.first_s) / self.shown_s * self.width_px

    def time(self, x_px: float) -> float:
        """Moment at so many pixels from the left end."""
        return self.first_s + x_px / self.width_px * self.shown_s

    def seconds(self, pixels: float) -> float:
        """How long so many pixels are."""
        return pixels / self.width_px * self.shown_s

    def zoom(self, steps: float, x_px: float) -> None:
        """Show less (positive) or more time, by a fifth a step; what is at a pixel stays there."""
        held = self.time(x_px)
        self.shown_s = float(np.clip(self.shown_s * 0.8**steps, _SHORTEST_S, _LONGEST_S))
        self._begin_at(held - self.seconds(x_px))

    def pan(self, pixels: float) -> None:
        """Move what is shown along with the hand."""
        self._begin_at(self.first_s - self.seconds(pixels))

    def fit(self, first_s: float, last_s: float) -> None:
        """Show a stretch of time whole."""
        length = max(last_s - first_s, _SHORTEST_S)
        self.shown_s = length * (1 + 2 * _MARGIN)
        self.first_s = first_s - length * _MARGIN

    def show(self, time_s: float) -> None:
        """Go on by a page where a moment has left what is shown."""
        if not self.first_s <= time_s <= self.first_s + self.shown_s:
            self._begin_at(time_s - _MARGIN * self.shown_s)

    def marks(self, apart_px: float) -> list[float]:
        """Moments of the marks, at 1, 2 or 5 times a power of ten seconds, at least so many pixels apart."""
        step = self.mark_step(apart_px)
        first, last = np.ceil(self.first_s / step - 1e-9), np.floor((self.first_s + self.shown_s) / step + 1e-9)
        return (np.arange(first, last + 1) * step).tolist()

    def mark_step(self, apart_px: float) -> float:
        """Seconds from mark to mark."""
        least = max(self.seconds(apart_px), 1e-9)
        ten = 10.0 ** np.floor(np.log10(least))
        return float(next(nice * ten for nice in (*_NICE, 10.0) if nice * ten >= least * (1 - 1e-9)))

    def _begin_at(self, time_s: float) -> None:
        # A little before 0 stays to be seen, so that what stands at 0 can be taken hold of.
        self.first_s = max(time_s, -_MARGIN * self.shown_s)

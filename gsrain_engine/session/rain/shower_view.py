"""What the Shower panel remembers from frame to frame; not part of the document."""

from dataclasses import dataclass
from typing import NamedTuple

from gsrain_engine.rain.weather import Weather

_LEAST_SPAN_S = 10.0
_TOPS_MM_H = (15.0, 30.0, 60.0, 105.0)
"""Upper ends of the axis: it does not run away from a point that is being dragged."""


class TypedNumber(NamedTuple):
    """A number that is being typed; it counts when its field is left."""

    time_s: float
    field: str
    value: float


@dataclass(slots=True)
class ShowerView:
    """The part of the curve that is seen, and what is held."""

    refit: bool = True
    """Show all keys in the next frame."""
    top_mm_h: float = _TOPS_MM_H[0]
    is_held: bool = False
    """Whether a key is being dragged; the axis waits until it is let go."""
    typed: TypedNumber | None = None
    speed_up: float = 1.0
    """Of the series that is about to be taken."""
    start_s: float = 0.0
    """Where that series begins."""

    def follow(self, weather: Weather, heaviest_mm_h: float) -> None:
        """Let the axis fit the heaviest rain, unless a key is held."""
        if not self.is_held:
            self.top_mm_h = next(top for top in _TOPS_MM_H if 1.05 * heaviest_mm_h <= top)

    @staticmethod
    def span_s(weather: Weather, now_s: float) -> tuple[float, float]:
        """From when to when to show: all keys with a margin, or a minute from now without any."""
        times = [key.time_s for key in (*weather.keys[:1], *weather.keys[-1:])] or [now_s, now_s + 60.0]
        first, last = min(times), max(times)
        span = max(last - first, _LEAST_SPAN_S)
        return first - 0.06 * span, first + 1.06 * span

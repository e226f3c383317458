"""A keyed quantity over time: straight between its knots, held before the first and after the last."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Float64

_PIECES = 16
"""A smooth stretch between two keys is drawn with so many straight pieces: 1/300 of its height off at most."""

_MOST_KNOTS = 200_000


@dataclass(frozen=True, eq=False)
class WeatherCurve:
    """A piecewise linear function of time with k components. Integrals of it are exact."""

    times_s: Float64[np.ndarray, " n"]
    """Rising."""
    values: Float64[np.ndarray, "n k"]

    @classmethod
    def through(
        cls, times_s: Float64[np.ndarray, " n"], values: Float64[np.ndarray, "n k"], *, smooth: bool = False
    ) -> "WeatherCurve":
        """Join keys; `smooth` rounds the corners by a cubic that overshoots no key (Fritsch and Carlson, 1980)."""
        pieces = min(_PIECES, _MOST_KNOTS // len(times_s))
        if not smooth or len(times_s) < 2 or pieces < 2:
            return cls(times_s, values)
        # One more key at each end, as high as the end: the curve then comes out of what is held before it.
        reach = times_s[-1] - times_s[0]
        along = np.concatenate([[times_s[0] - reach], times_s, [times_s[-1] + reach]])
        with np.errstate(over="ignore"):  # one over a slope that is next to nothing
            rounded = scipy.interpolate.PchipInterpolator(along, np.concatenate([values[:1], values, values[-1:]]))
        shares = np.arange(pieces) / pieces
        inner = (times_s[:-1, None] + shares * np.diff(times_s)[:, None]).ravel()
        knots = np.append(inner, times_s[-1])
        drawn = rounded(knots)
        drawn[::pieces] = values  # to the bit
        return cls(knots, np.clip(drawn, values.min(axis=0), values.max(axis=0)))

    def at(self, time_s: float) -> Float64[np.ndarray, " k"]:
        before = self.before(time_s)
        if before < 0:
            return self.values[0]
        if before == len(self.times_s) - 1:
            return self.values[-1]
        share = (time_s - self.times_s[before]) / (self.times_s[before + 1] - self.times_s[before])
        return self.values[before] + share * (self.values[before + 1] - self.values[before])

    def integral(self, time_s: float) -> Float64[np.ndarray, " k"]:
        """Integral over time from 0 to a time."""
        return self._from_first(time_s) - self._from_first_to_zero

    def before(self, time_s: float) -> int:
        """Number of the last knot that is not later than a time; -1 before the first."""
        return int(np.searchsorted(self.times_s, time_s, side="right")) - 1

    @cached_property
    def _sums(self) -> Float64[np.ndarray, "n k"]:
        steps = 0.5 * (self.values[1:] + self.values[:-1]) * np.diff(self.times_s)[:, None]
        return np.concatenate([np.zeros((1, self.values.shape[1])), np.cumsum(steps, axis=0)])

    @cached_property
    def _from_first_to_zero(self) -> Float64[np.ndarray, " k"]:
        return self._from_first(0.0)

    def _from_first(self, time_s: float) -> Float64[np.ndarray, " k"]:
        knot = max(self.before(time_s), 0)
        mean = 0.5 * (self.values[knot] + self.at(time_s))
        return self._sums[knot] + mean * (time_s - self.times_s[knot])

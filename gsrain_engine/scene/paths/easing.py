"""How time goes by between the keys of a camera path: evenly, or slower where the camera sets off and arrives."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

Easing = Literal["none", "in and out", "at each key"]
"""none: even; in and out: sets off and arrives gently; at each key: comes to rest at every key."""


class Eased(NamedTuple):
    """A moment of the clock, and where on the path's own time that is."""

    times_s: Float64[np.ndarray, " t"]
    rates: Float64[np.ndarray, " t"]
    """Path seconds that go by in a second of the clock."""


def eased(easing: Easing, knots_s: Float64[np.ndarray, " k"], times_s: Float64[np.ndarray, " t"]) -> Eased:
    """Path time at moments between the first knot and the last.

    Every knot stays at its moment, the order of moments stays, and the rate has no jumps. Between two knots that both
    are rests it is u^2 (3 - 2u) of the share u of the interval; where only the first is, u^2 (2 - u); where only the
    last is, that backwards.
    """
    if easing == "none" or len(knots_s) < 2:
        return Eased(times_s, np.ones_like(times_s))
    k = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, 0, len(knots_s) - 2)
    length = knots_s[k + 1] - knots_s[k]
    u = (times_s - knots_s[k]) / length
    sets_off = (k == 0) | (easing == "at each key")
    arrives = (k == len(knots_s) - 2) | (easing == "at each key")
    cases = [sets_off & arrives, sets_off, arrives]
    shares = np.select(cases, [u * u * (3 - 2 * u), u * u * (2 - u), u + u * u - u**3], u)
    rates = np.select(cases, [6 * u * (1 - u), u * (4 - 3 * u), 1 + 2 * u - 3 * u * u], 1.0)
    return Eased(knots_s[k] + length * shares, rates)

"""Easing: progress between two keyframes, of the camera and of the rain, and over all keyframes of a camera path."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float64

KeyEasing = Literal["linear", "smooth", "ease in", "ease out", "hold"]
"""From a keyframe to the next one. linear: even; smooth: slow at both ends; ease in: slow at the first; ease out: slow
at the next; hold: the first one's values, until the next one.
"""

KEY_EASINGS: tuple[KeyEasing, ...] = get_args(KeyEasing)
MIRRORED: dict[KeyEasing | None, KeyEasing | None] = {
    **{each: each for each in KEY_EASINGS}, None: None, "ease in": "ease out", "ease out": "ease in",
}  # fmt: skip
"""Easing of the same stretch played backward."""


class EasedShare(NamedTuple):
    """Progress between two keyframes, 0..1, and its rate: 1 if even."""

    shares: Float64[np.ndarray, " t"]
    rates: Float64[np.ndarray, " t"]


def eased_share(easing: KeyEasing, u: Float64[np.ndarray, " t"]) -> EasedShare:
    """Progress for a share `u` of the time between two keyframes.

    With polynomials of degree 2 and 3: u^2, 1 - (1 - u)^2 and u^2 (3 - 2 u).
    """
    if easing == "smooth":
        return EasedShare(u * u * (3 - 2 * u), 6 * u * (1 - u))
    if easing == "ease in":
        return EasedShare(u * u, 2 * u)
    if easing == "ease out":
        return EasedShare(u * (2 - u), 2 * (1 - u))
    if easing == "hold":
        return EasedShare(np.where(u < 1, 0.0, 1.0), np.zeros_like(u))
    return EasedShare(u, np.ones_like(u))


# Camera paths

Easing = Literal["none", "in and out", "at each key"]
"""none: even; in and out: starts and ends gently; at each key: stops at every keyframe."""


class Eased(NamedTuple):
    """Path times after easing, and their rates."""

    times_s: Float64[np.ndarray, " t"]
    rates: Float64[np.ndarray, " t"]
    """Path seconds per second of the clock."""


def apply_easing(easing: Easing, knots_s: Float64[np.ndarray, " k"], times_s: Float64[np.ndarray, " t"]) -> Eased:
    """Path times for clock times between the first knot and the last.

    Every knot keeps its time, the order of times is preserved, and the rate is continuous. With u the fraction of an
    interval between two knots, progress is u^2 (3 - 2u) if the camera rests at both, u^2 (2 - u) if only at the first,
    and the mirror image of that if only at the last.
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


def apply_key_easings(
    easings: Sequence[KeyEasing | None],
    knots_s: Float64[np.ndarray, " k"],
    times_s: Float64[np.ndarray, " t"],
    eased: Eased,
) -> Eased:
    """Replace path times and rates where the keyframe before has an easing of its own."""
    if len(knots_s) < 2:
        return eased
    k = np.clip(np.searchsorted(knots_s, times_s, side="right") - 1, 0, len(knots_s) - 2)
    path_times, rates = eased.times_s.copy(), eased.rates.copy()
    for key, easing in enumerate(easings[: len(knots_s) - 1]):
        here = k == key
        if easing is not None and here.any():
            length = knots_s[key + 1] - knots_s[key]
            share = eased_share(easing, (times_s[here] - knots_s[key]) / length)
            path_times[here], rates[here] = knots_s[key] + length * share.shares, share.rates
    return Eased(path_times, rates)

"""Easing: progress between two keyframes, of the camera and of the rain."""

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

"""What lies between the keys of a camera path: curves through places, rotations and fields of view."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy  # which loads its parts where they are used first: most scenes are opened without a flight
from jaxtyping import Float64

Interpolation = Literal["spline", "linear"]
"""spline: smooth through all keys; linear: straight from key to key, at constant speed between two of them."""

_KEYS_AROUND_A_LOOP = 24
"""Keys that are laid out before and after a loop: a spline forgets its ends by a factor of 2 or more a key."""


@dataclass(frozen=True, slots=True, eq=False)
class PathCurves:
    """Curves through two or more keys; to be asked between the first key and the last only, or the seam of a loop."""

    positions: Callable[..., Any]
    """Of path time; a second argument of 1 gives the derivative."""
    rotations: Callable[..., Any]
    """SciPy's Rotation, of path time."""
    fields_of_view: Callable[..., Any]

    @classmethod
    def through(
        cls,
        times_s: Float64[np.ndarray, " k"],
        positions: Float64[np.ndarray, "k 3"],
        quaternions_wxyz: Float64[np.ndarray, "k 4"],
        fields_of_view: Float64[np.ndarray, " k"],
        interpolation: Interpolation = "spline",
        period_s: float | None = None,
    ) -> "PathCurves":
        """Lay curves through keys; with a period the last key leads on to the first, without a kink in a spline.

        Splines: natural cubic for places, cubic in rotation vectors for rotations (scipy's RotationSpline), monotone
        cubic for the field of view, which so never leaves the range of its two keys.
        """
        if period_s is not None:
            n = len(times_s)
            rounds = np.arange(-_KEYS_AROUND_A_LOOP, n + 1 + _KEYS_AROUND_A_LOOP)
            keys = rounds % n
            times_s = times_s[keys] + period_s * (rounds // n)
            positions, quaternions_wxyz, fields_of_view = positions[keys], quaternions_wxyz[keys], fields_of_view[keys]
        splines, turning = scipy.interpolate, scipy.spatial.transform
        rotations = turning.Rotation.from_quat(quaternions_wxyz[:, [1, 2, 3, 0]])
        if interpolation == "linear":
            return cls(
                splines.make_interp_spline(times_s, positions, k=1),
                turning.Slerp(times_s, rotations),
                splines.make_interp_spline(times_s, fields_of_view, k=1),
            )
        return cls(
            splines.CubicSpline(times_s, positions, bc_type="natural"),
            turning.RotationSpline(times_s, rotations),
            splines.PchipInterpolator(times_s, fields_of_view),
        )

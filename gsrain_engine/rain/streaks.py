"""Near drops as streak Gaussians: size, opacity and direction of what a shutter sees of a moving drop."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.scene.camera import Camera

from .rain import Rain

AXIS_RATIO_SLOPE, AXIS_RATIO_OFFSET = -0.07, 1.07
"""tau(D) = k D + b for 1 mm < D < 9 mm (paper, eq. 4)."""


STREAK_REACH = 2.0
"""No streak reaches farther from its drop than so many of its lengths (the outermost copy's last visible fragment)."""


@dataclass(frozen=True, slots=True, eq=False)
class Streaks:
    """Streak Gaussians in the world: everything but their colour."""

    means: Float32[np.ndarray, "n 3"]
    scales: Float32[np.ndarray, "n 3"]
    quaternions: Float32[np.ndarray, "n 4"]
    opacities: Float32[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Shutter:
    """The camera as a streak sees it."""

    camera: Camera
    velocity_m_s: Float64[np.ndarray, "3"]
    exposure_s: float
    focal_px: float
    """Focal length of the *output* image, whatever resolution is being drawn."""


def visible_distance_m(diameter_mm: Float64[np.ndarray, " n"], focal_px: float) -> Float64[np.ndarray, " n"]:
    """Distance d_m = f D at which a drop covers exactly one pixel, in metres (paper, eq. 6)."""
    return focal_px * diameter_mm * 1e-3


def circle_of_confusion_m(depth_m: Float64[np.ndarray, " n"], rain: Rain) -> Float64[np.ndarray, " n"]:
    """Diameter at the drop of what a thin lens spreads a point over: A |1 - d / d_focus|.

    In the image it is c = f A |1/d - 1/d_focus| px, with f in px and A the aperture's diameter in metres.
    """
    return 1e-3 * rain.aperture_mm * np.abs(1 - depth_m / rain.focus_distance_m)

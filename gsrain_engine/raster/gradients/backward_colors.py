"""The derivative of a Gaussian's colour: from what a loss asks of splats' colours to harmonics, means and the eye."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from .forward_projection import CHUNK, TrainedGaussians, TrainedSplats, direction, eye_of
from .harmonics_derivative import harmonics_of, pulled_back


def colors_back(
    gaussians: TrainedGaussians,
    splats: TrainedSplats,
    sums: Float[np.ndarray, "n 3"],
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "n k 3"], Float[np.ndarray, "_ 3"]]:
    """Take the sums of `backward_blending.gather_colors` to harmonics and display colours alone."""
    by_colors, by_display = np.zeros_like(gaussians.colors), np.zeros_like(gaussians.display)
    _colors_back(gaussians.means, *splats[1:], sums, eye_of(world_to_camera), by_colors, by_display)
    return by_colors, by_display


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _colors_back(means, channels, radii, sums, eye, by_colors, by_display):
    coefficients = by_colors.shape[1]
    for chunk in numba.prange((len(means) + CHUNK - 1) // CHUNK):
        basis = np.empty(16, np.float64)
        for i in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
            if radii[i] > 0:
                if len(by_display) > 0:
                    for c in range(3):
                        by_display[i, c] = sums[i, c] if channels[i, c] > 0 else 0
                else:
                    x, y, z, _ = direction(means[i], eye)
                    harmonics_of(x, y, z, coefficients, basis)
                    red, green, blue = _open(channels[i], sums[i])
                    for k in range(coefficients):
                        by_colors[i, k, 0] = basis[k] * red
                        by_colors[i, k, 1] = basis[k] * green
                        by_colors[i, k, 2] = basis[k] * blue


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _open(channels, sums):
    """Gradient by the colour before it was cut at 0: none where it was."""
    red = np.float64(sums[0]) if channels[0] > 0 else 0.0
    green = np.float64(sums[1]) if channels[1] > 0 else 0.0
    blue = np.float64(sums[2]) if channels[2] > 0 else 0.0
    return red, green, blue


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def color_back(mean, sh, channels, sums, eye, basis, by_basis, by_mean, by_sh, pose):
    """Write the gradient by the harmonics; add those by the mean and, in the last three numbers of `pose`, the eye."""
    x, y, z, near = direction(mean, eye)
    coefficients = len(sh)
    harmonics_of(x, y, z, coefficients, basis)
    red, green, blue = _open(channels, sums)
    for k in range(coefficients):
        by_sh[k, 0] = basis[k] * red
        by_sh[k, 1] = basis[k] * green
        by_sh[k, 2] = basis[k] * blue
        by_basis[k] = red * sh[k, 0] + green * sh[k, 1] + blue * sh[k, 2]
    gx, gy, gz = pulled_back(x, y, z, coefficients, by_basis)
    along = gx * x + gy * y + gz * z
    gx, gy, gz = near * (gx - along * x), near * (gy - along * y), near * (gz - along * z)
    by_mean[0] += gx
    by_mean[1] += gy
    by_mean[2] += gz
    pose[12] -= gx
    pose[13] -= gy
    pose[14] -= gz

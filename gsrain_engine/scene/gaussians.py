"""A set of 3D Gaussians: the one thing that every scene, actor and raindrop is drawn as."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int, UInt32

SH_C0 = 0.28209479177387814
"""Spherical harmonic of degree 0, 1/(2 sqrt(pi)): colour = SH_C0 * sh[0] + 0.5 (3DGS, Kerbl et al. 2023)."""

COEFFICIENTS_OF_DEGREE = (1, 4, 9, 16)
"""How many spherical harmonics there are up to degree 0, 1, 2, 3."""


@dataclass(frozen=True, slots=True, eq=False)
class Gaussians:
    """N Gaussians, activated: logs and logits exist only in file formats and optimizers.

    Treat the arrays as values: nobody writes into them once they are in here.
    """

    means: Float32[np.ndarray, "n 3"]
    """Centres, in the units and axes of the layer they belong to."""
    scales: Float32[np.ndarray, "n 3"]
    """Standard deviations along the Gaussian's own axes, >= 0, same unit as `means`."""
    quaternions: Float32[np.ndarray, "n 4"]
    """Own axes to layer axes, (w, x, y, z), unit."""
    opacities: Float32[np.ndarray, " n"]
    """Largest alpha, in [0, 1]."""
    sh: Float32[np.ndarray, "n k 3"]
    """Spherical harmonics of display colour, k = 1, 4, 9 or 16, in the order and sign of 3DGS."""

    def __post_init__(self) -> None:
        n, k = len(self.means), self.sh.shape[1]
        shapes = {"means": (n, 3), "scales": (n, 3), "quaternions": (n, 4), "opacities": (n,), "sh": (n, k, 3)}
        for name, shape in shapes.items():
            found = getattr(self, name).shape
            if found != shape:
                raise ValueError(f"Gaussians.{name} has shape {found}, expected {shape}")
        if k not in COEFFICIENTS_OF_DEGREE:
            raise ValueError(f"Gaussians.sh has {k} coefficients a colour, expected one of {COEFFICIENTS_OF_DEGREE}")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return COEFFICIENTS_OF_DEGREE.index(self.sh.shape[1])

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(a.nbytes for a in (self.means, self.scales, self.quaternions, self.opacities, self.sh))

    def take(self, indices: "Int[np.ndarray, ' m'] | UInt32[np.ndarray, ' m'] | slice") -> "Gaussians":
        """Pick Gaussians by index or slice, in that order."""
        return Gaussians(
            self.means[indices],
            self.scales[indices],
            self.quaternions[indices],
            self.opacities[indices],
            self.sh[indices],
        )

    def with_sh(self, sh: Float32[np.ndarray, "n k 3"]) -> "Gaussians":
        """Return the same Gaussians in other colours."""
        return Gaussians(self.means, self.scales, self.quaternions, self.opacities, sh)

    @staticmethod
    def empty(sh_degree: int = 0) -> "Gaussians":
        """Return a set without members."""
        f = np.float32
        k = COEFFICIENTS_OF_DEGREE[sh_degree]
        return Gaussians(
            np.zeros((0, 3), f), np.zeros((0, 3), f), np.zeros((0, 4), f), np.zeros(0, f), np.zeros((0, k, 3), f)
        )

    @staticmethod
    def concatenate(parts: Sequence["Gaussians"]) -> "Gaussians":
        """Join sets in order; lower SH degrees are padded with zeros to the highest one. One set alone comes back."""
        if len(parts) < 2:
            return parts[0] if parts else Gaussians.empty()
        k = max(part.sh.shape[1] for part in parts)
        missing = [k - part.sh.shape[1] for part in parts]
        padded = [
            np.pad(part.sh, ((0, 0), (0, more), (0, 0))) if more else part.sh
            for part, more in zip(parts, missing, strict=True)
        ]
        return Gaussians(
            np.concatenate([part.means for part in parts]),
            np.concatenate([part.scales for part in parts]),
            np.concatenate([part.quaternions for part in parts]),
            np.concatenate([part.opacities for part in parts]),
            np.concatenate(padded),
        )


def sh_from_color(colors: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 1 3"]:
    """Spherical harmonics of degree 0 that show the same display colour (0..1) from every side."""
    return ((colors - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]

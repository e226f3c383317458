"""Classes and measuring area of the OTT Parsivel (Parsivel2 manual, appendix C: 32 diameters, 32 fall speeds)."""

import numpy as np
from jaxtyping import Float64

CLASSES = 32


def _edges(*runs: tuple[int, float]) -> Float64[np.ndarray, " edges"]:
    """Bounds from 0 on, in runs of so many classes of one width."""
    widths = np.repeat([width for _, width in runs], [classes for classes, _ in runs])
    return np.concatenate([[0.0], np.round(np.cumsum(widths), 6)])


DIAMETER_EDGES_MM = _edges((10, 0.125), (5, 0.25), (5, 0.5), (5, 1.0), (5, 2.0), (2, 3.0))
VELOCITY_EDGES_M_S = _edges((10, 0.1), (5, 0.2), (5, 0.4), (5, 0.8), (5, 1.6), (2, 3.2))


def effective_area_m2(diameters_mm: Float64[np.ndarray, " diameters"]) -> Float64[np.ndarray, " diameters"]:
    """Area in which a drop is seen whole: the laser sheet of 180 x 30 mm less a margin of half a diameter.

    Source: Battaglia et al. (2010), as 180 (30 - D/2) mm^2.
    """
    return 180e-6 * (30 - diameters_mm / 2)


AREA_M2 = effective_area_m2(0.5 * (DIAMETER_EDGES_MM[:-1] + DIAMETER_EDGES_MM[1:]))

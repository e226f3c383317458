"""Classes and measuring area of the Thies laser precipitation monitor (instruction for use: 22 diameters, 20 speeds).

The last diameter class is open, from 8 mm: it is given the width of the one before. The last speed class ends at
20 m/s, beyond which the instrument counts no particle.
"""

import numpy as np

DIAMETER_EDGES_MM = np.concatenate([[0.125, 0.25, 0.375, 0.5], np.arange(0.75, 2, 0.25), np.arange(2, 8.6, 0.5)])
VELOCITY_EDGES_M_S = np.round(
    np.concatenate([0.2 * np.arange(5), 1 + 0.4 * np.arange(6), 3.4 + 0.8 * np.arange(8), [10.0, 20.0]]), 6
)
AREA_M2 = np.full(len(DIAMETER_EDGES_MM) - 1, 0.228 * 0.020)

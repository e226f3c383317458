"""Heights over a grid of the world's x and y, asked for one place at a time or for many."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights at the middles of cells, blended between them; beyond the grid the nearest cell's."""

    corner_m: tuple[float, float]
    """x and y of the middle of the first cell."""
    cell_m: float
    heights_m: Float64[np.ndarray, "rows columns"]
    """Rows along y."""

    @staticmethod
    def level(height_m: float) -> "HeightGrid":
        return HeightGrid((0.0, 0.0), 1.0, np.full((1, 1), float(height_m)))

    def at(self, x_m: float, y_m: float) -> float:
        """Height at a place, without the cost of arrays."""
        rows, columns = self.heights_m.shape
        u = min(max((x_m - self.corner_m[0]) / self.cell_m, 0.0), columns - 1.0)
        v = min(max((y_m - self.corner_m[1]) / self.cell_m, 0.0), rows - 1.0)
        i, j = int(u), int(v)
        right, up = min(i + 1, columns - 1), min(j + 1, rows - 1)
        s, t = u - i, v - j
        near = (1 - s) * self.heights_m[j, i] + s * self.heights_m[j, right]
        far = (1 - s) * self.heights_m[up, i] + s * self.heights_m[up, right]
        return float((1 - t) * near + t * far)

    def at_all(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        rows, columns = self.heights_m.shape
        u, v = np.clip((places - self.corner_m) / self.cell_m, 0.0, (columns - 1.0, rows - 1.0)).T
        i, j = u.astype(np.int64), v.astype(np.int64)
        right, up = np.minimum(i + 1, columns - 1), np.minimum(j + 1, rows - 1)
        s, t = u - i, v - j
        near = (1 - s) * self.heights_m[j, i] + s * self.heights_m[j, right]
        far = (1 - s) * self.heights_m[up, i] + s * self.heights_m[up, right]
        return (1 - t) * near + t * far

"""Ground of a page: its heights and its water around the path, and the drops that splash on it in each rain."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.simulation import RainSimulation
from ..render.passes.splashes import has_splashes, wet_ground
from ..scene.camera import Camera
from ..scene.formats.sog_writer import image_columns, lossless_image
from ..scene.scene import Scene
from ..water.films import WaterFilms
from ..water.impacts import GroundImpacts
from ..water.splashes import splash_rate

HEIGHT_STEP_M = 0.005
_AROUND_PATH_M = 100.0
_WIDEST_PX = 4096  # image that every graphics card can hold


class PageGround(NamedTuple):
    """Map of a scene's ground and of the water that it holds."""

    settings: dict[str, Any]
    """Values of the map, in the names of `mirror.js`."""
    image: bytes
    """Lossless image with the map's cells: height in steps (red and 256 green), shares of film (blue) and of standing
    water (alpha)."""


def page_ground(scene: Scene, cameras: Sequence[Camera]) -> PageGround | None:
    """Ground around a path; None without a map of the water on it."""
    if scene.water is None:
        return None
    ground_m, water = scene.ground_m or 0.0, scene.water
    all_heights = wet_ground(scene, ground_m).heights_m
    if all_heights is None:
        all_heights = np.full(water.cover.shape[:2], ground_m, np.float32)
    places = np.array([camera.position[:2] for camera in cameras])
    corner, size = np.array(water.corner_m), np.array(all_heights.shape[::-1])
    low = (places.min(axis=0) - _AROUND_PATH_M - corner) / water.cell_m
    high = (places.max(axis=0) + _AROUND_PATH_M - corner) / water.cell_m
    first = np.clip(low.astype(np.int64), 0, size - 1)
    last = np.clip(high.astype(np.int64) + 1, first + 1, size)
    own = slice(first[1], last[1]), slice(first[0], last[0])
    heights, cover = all_heights[own], water.cover[own]
    lowest = float(heights.min())
    steps = np.clip(np.rint((heights - lowest) / HEIGHT_STEP_M), 0, 65535).astype(np.int64)
    pixels = np.dstack([steps & 255, steps >> 8, cover]).astype(np.uint8).reshape(-1, 4)
    rows, columns = heights.shape
    values = {
        "corner": (corner + first * water.cell_m).tolist(), "cell": water.cell_m, "rows": rows, "columns": columns,
        "lowest": lowest, "step": HEIGHT_STEP_M,
    }  # fmt: skip
    width = columns if max(rows, columns) <= _WIDEST_PX else image_columns(len(pixels))
    return PageGround(values, lossless_image(pixels, width))


def splash_state(
    simulation: RainSimulation, scene: Scene
) -> tuple[dict[str, float] | None, Float64[np.ndarray, "knots 2"]]:
    """Depths of water and the rate of drops that splash in steady rain, None without any; and their sizes.

    The sizes are those of `ImpactFlux.largest_drops`.
    """
    depth, flux = WaterFilms.of(simulation, scene.water).at(0.0), GroundImpacts(simulation).flux_at(0.0)
    rate, sizes = flux.largest_drops(splash_rate(flux, depth.film_mm))
    if rate <= 0 or not has_splashes(scene, simulation, simulation.wetness_at(0.0)):
        return None, sizes
    return {"rate": rate, "film": depth.film_mm, "dip": depth.dip_mm}, sizes

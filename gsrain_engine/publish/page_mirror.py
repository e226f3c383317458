"""Mirror of a page: the water on its Gaussians, and what films and standing water reflect in each rain.

The page draws the mirror as `water/mirror.py` does, without rings: all of them are roughness there.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from ..rain.frame import SkyLight
from ..rain.simulation import RainSimulation
from ..render.passes.mirror import reflected_item
from ..scene.ground_water import FILM_SLOPE, STANDING_SLOPE, GroundWater
from ..scene.scene import DrawItem, Scene
from ..water.films import WaterFilms, flooded_share
from ..water.impacts import GroundImpacts
from ..water.mirror import SCALES, facet_table, standing_water
from ..water.rings import standing_slope

GROWTH_STEPS = 127
"""Steps of the growth of a reflected Gaussian from 1 to 2."""


def water_codes(item: DrawItem, scene: Scene) -> UInt8[np.ndarray, "n 3"]:
    """Water on each remaining Gaussian of a reflecting item.

    Shares of film and standing water in 1/255; and 0 where mirrors leave it out, else 1 and in `GROWTH_STEPS` how much
    larger it is in them.
    """
    codes = np.zeros((len(item.gaussians), 3), np.uint8)
    if item.film is not None:
        codes[:, :2] = np.rint(255 * item.film)
    reflected = reflected_item(item, scene)
    codes[:, 2] = 1 + min(round(GROWTH_STEPS * (reflected.growth - 1)), 254)
    if reflected.left_out is not None:
        codes[reflected.left_out.flags, 2] = 0
    return codes[~item.left_out.flags] if item.left_out else codes


def floors_below(places: Sequence[DrawItem | None], water: GroundWater | None) -> Float32[np.ndarray, " steps"]:
    """Height of uneven ground below an actor at each of its places; 0 where it is absent or the ground is level."""
    if water is None or water.heights_m is None:
        return np.zeros(len(places), np.float32)
    heights = [0.0 if each is None else float(water.height_at(each.to_world[None, :2, 3])[0]) for each in places]
    return np.array(heights, np.float32)


class PageMirror(NamedTuple):
    """Mirror of a page, but for the water on its Gaussians."""

    settings: dict[str, Any]
    """Values common to all intensities, in the names of `mirror.js`."""
    facets: Float32[np.ndarray, "rows angles 3"]
    """`facet_table` of films, and then of standing water in each state."""


def page_mirror(scene: Scene, states: Sequence[dict[str, Any]]) -> PageMirror | None:
    """Mirror for the states of a rain (`mirror_state` of each); None if none of them has any."""
    mirrors = [state["mirror"] for state in states]
    if scene.water is None or not any(mirrors):
        return None
    slopes = [STANDING_SLOPE if each is None else each["slopes"][1] for each in mirrors]
    facets = np.stack([facet_table(slope) for slope in (FILM_SLOPE, *slopes)])
    settings: dict[str, Any] = {
        "scales": SCALES, "growthSteps": GROWTH_STEPS, "ground": scene.ground_m or 0.0,
        "isUneven": scene.water.heights_m is not None,
    }  # fmt: skip
    return PageMirror(settings, facets)


def mirror_state(simulation: RainSimulation, scene: Scene, light: SkyLight) -> dict[str, Any] | None:
    """Light that films and standing water reflect in steady rain, and their slopes; None without a mirror.

    `weights` are those of the light of a film and of standing water, in what the map's films reflect, and its dips.
    """
    rain, wetness = simulation.rain, simulation.wetness_at(0.0)
    if scene.water is None or not rain.mirror:
        return None
    depth = WaterFilms.of(simulation, scene.water).at(0.0)
    filled, as_wet = standing_water(rain, depth, wetness)
    if wetness <= 0 and min(filled, as_wet) <= 0:
        return None
    flooded, slope = flooded_share(depth.film_mm), STANDING_SLOPE
    film = np.array([wetness * (1 - flooded), wetness * flooded])
    dip = (1 - filled) * film + np.array([0.0, filled * as_wet])
    if rain.splashes:  # with its rings
        power = float(GroundImpacts(simulation).flux_at(0.0).power_w_m2[-1])
        slope = standing_slope(power, 1e-3 * max(depth.dip_mm, depth.film_mm))
        film = np.array([film[0], 0.0]) + flooded * dip
    return {"weights": [*film.tolist(), *dip.tolist()], "slopes": [FILM_SLOPE, slope], "sky": light.drops}

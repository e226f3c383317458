"""Wet colors of Gaussians, each from its own clear color, place and shape, so that none of a scene's detail is lost.

No view is drawn. Sunlight and shadow, plants and level surfaces are found among neighbors in space.
"""

from collections.abc import Generator
from dataclasses import fields
from functools import partial

import numpy as np
from jaxtyping import Float64

from ...scene.gaussians import SH_C0
from ...scene.geometry import linear_to_srgb, srgb_to_linear
from ...scene.progress import Progress, subprogress
from ...scene.scene import Layer, Scene
from .gaussian_surfaces import BLOCK, Colors, GaussianSurfaces, Harmonics, find_surfaces, sunlit_share
from .ground_plane import GroundHeights
from .illumination import IlluminationEstimate, overcast_colors, overcast_sky
from .masks import SurfaceShares
from .materials import BRIGHTENING, MATTE_GROUND, MEAN_REFLECTANCE, lamp_share, wet_surfaces_color
from .settings import WetSettings

_MAX_GAIN = 1.5  # of harmonics above the first, which hold noise where a color is almost black


def wet_gaussian_colors(
    scene: Scene, settings: WetSettings, heights: GroundHeights | None
) -> Generator[Progress, None, dict[str, Harmonics]]:
    """Compute the wet colors of every layer and actor, by key; `heights` are those of the ground, if any is known.

    Each Gaussian's color is relit and wetted by itself; what depends on its surroundings varies smoothly between
    neighbors. On ground that holds water, it is the color without reflections, which the mirror adds.
    """
    surfaces = yield from subprogress(find_surfaces(scene, heights), 0.0, 0.6)
    colors, clouds = dict[str, Harmonics](), partial(_clouds, settings=settings)
    for member in scene.members:
        yield Progress(0.6 + 0.4 * len(colors) / len(scene.members), f"Wetting {member.name}")
        if (own := surfaces.members.get(member.key)) is None:
            colors[member.key] = surfaces.sky.painted(scene, member, clouds, settings.wetness)
            continue
        wet = _wet_colors(own, surfaces.light, settings, has_mirror=scene.water is not None)
        if isinstance(member, Layer):
            cloud, share = surfaces.sky.behind(member.key, own, surfaces.above_m(own), clouds)
            wet = wet + (settings.wetness * share)[:, None] * (cloud - wet)
        colors[member.key] = changed_harmonics(member.gaussians.sh, own.color, wet)
        if isinstance(member, Layer) and scene.water is not None:
            is_ground = own.ground > 0.5
            matte = np.zeros_like(colors[member.key][is_ground])  # without highlights
            matte[:, 0] = (wet[is_ground] - np.float32(0.5)) / np.float32(SH_C0)
            shining = np.float32(1 - settings.wetness) * colors[member.key][is_ground]
            colors[member.key][is_ground] = shining + np.float32(settings.wetness) * matte
    yield Progress(1.0, "Done")
    return colors


def changed_harmonics(sh: Harmonics, clear: Colors, wet: Colors) -> Harmonics:
    """Harmonics that show `wet` from where `sh` shows `clear`, and which change with direction as before.

    A power of the light is a factor of the display color, so that all harmonics change by one factor, nearly.
    """
    gain = np.minimum(wet / np.maximum(clear, np.float32(1 / 255)), np.float32(_MAX_GAIN))
    changed = sh * gain[:, None, :]
    beyond = np.float32(SH_C0) * sh[:, 0] + np.float32(0.5) - clear  # colors below 0 or above 1
    changed[:, 0] = (wet + gain * beyond - np.float32(0.5)) / np.float32(SH_C0)
    return changed.astype(np.float32)


def _wet_colors(
    own: GaussianSurfaces, light: IlluminationEstimate, settings: WetSettings, *, has_mirror: bool
) -> Colors:
    """Display colors of Gaussians on the rainy day."""
    sunlit, wet = sunlit_share(own, light), np.empty_like(own.color)
    linear = srgb_to_linear(own.color).astype(np.float32)
    tails = own.vehicles if settings.tail_lamps else np.zeros_like(own.vehicles)
    lamps = lamp_share(linear, own.broad.mean, tails) * (1 - own.ground)
    for first in range(0, len(wet), BLOCK):
        rows = slice(first, first + BLOCK)
        surfaces, clear = row_of(own, rows), linear[None, rows]
        lit = overcast_colors(clear, sunlit[None, rows], light, settings, surfaces)
        lit = wet_surfaces_color(lit, surfaces, settings)
        gloss = (settings.gloss * MEAN_REFLECTANCE * surfaces.vehicles * surfaces.up_facing)[..., None]
        lit = lit + gloss * (overcast_sky(np.array([[[0.0, 0.6, 0.8]]]), settings) - lit)
        if has_mirror:
            lit = lit * (1 - (1 - MATTE_GROUND) * surfaces.ground * (1 - surfaces.plants))[..., None]
        lit = lit + lamps[None, rows, None] * (np.maximum(BRIGHTENING * clear, lit) - lit)
        wet[rows] = np.clip(linear_to_srgb(clear + settings.wetness * (lit - clear)), 0, 1)[0]
    return wet


def row_of(own: GaussianSurfaces, rows: slice) -> SurfaceShares:
    """Gaussians as an image of one row."""
    names = [each.name for each in fields(SurfaceShares) if each.name != "normals"]
    parts = {name: getattr(own, name)[None, rows] for name in names}
    return SurfaceShares(normals=np.zeros_like(parts["points"]), **parts)


def _clouds(directions: Float64[np.ndarray, "n 3"], settings: WetSettings) -> Colors:
    display = np.empty((len(directions), 3), np.float32)
    for first in range(0, len(directions), BLOCK):
        rows = slice(first, first + BLOCK)
        display[rows] = linear_to_srgb(overcast_sky(directions[None, rows], settings))[0]
    return display
